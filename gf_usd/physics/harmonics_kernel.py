# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""`gf_usd.harmonics.rotate` in a kernel: ten times faster, in single precision."""

import numpy as np
from numpy.typing import NDArray

from gf_usd.harmonics import DIRECTIONS, INVERSES, terms
from gf_usd.model import Floats
from gf_usd.runtime import ensure_taichi, import_taichi

ti = import_taichi()

_terms = ti.func(terms)
F32_2, F32_3 = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (2, 3))

# (10, 15) what each direction gives to each coefficient above degree 0
GIVES = np.ascontiguousarray(np.concatenate(INVERSES, axis=0).T, np.float32)
LOOKS = np.ascontiguousarray(DIRECTIONS, np.float32)


def rotated(harmonics: NDArray[np.float32], rotations: Floats) -> NDArray[np.float32]:
    """Coefficients (N, (d + 1)^2, 3) turned by rotations (N, 3, 3), d from 1 to 3."""
    ensure_taichi()
    out = np.zeros(harmonics.shape, np.float32)
    out[:, 0] = harmonics[:, 0]
    turn = np.ascontiguousarray(rotations, np.float32)
    _turn(np.ascontiguousarray(harmonics, np.float32), turn, LOOKS, GIVES, out,
          round(harmonics.shape[1] ** 0.5) - 1)  # fmt: skip
    return out


@ti.kernel
def _turn(h: F32_3, turn: F32_3, looks: F32_2, gives: F32_2, out: F32_3, degrees: ti.template()):
    """h'_m = sum_j B^+_mj sum_k Y_k(R^T d_j) h_k, degree by degree."""
    for i in range(h.shape[0]):
        for j in range(looks.shape[0]):
            a, b, c = looks[j, 0], looks[j, 1], looks[j, 2]
            x = a * turn[i, 0, 0] + b * turn[i, 1, 0] + c * turn[i, 2, 0]
            y = a * turn[i, 0, 1] + b * turn[i, 1, 1] + c * turn[i, 2, 1]
            z = a * turn[i, 0, 2] + b * turn[i, 1, 2] + c * turn[i, 2, 2]
            Y = _terms(x, y, z)
            for degree in ti.static(range(1, degrees + 1)):
                for colour in ti.static(range(3)):
                    seen = 0.0
                    for k in ti.static(range(degree * degree, (degree + 1) * (degree + 1))):
                        seen += Y[k] * h[i, k, colour]
                    for k in ti.static(range(degree * degree, (degree + 1) * (degree + 1))):
                        out[i, k, colour] += gives[j, k - 1] * seen

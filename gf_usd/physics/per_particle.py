"""What a frame asks of every particle, where they are many: by `frame_kernel`.

A launch and the loading of a kernel cost more than NumPy takes for few.  Both ways agree to
rounding, and which is taken follows from the count alone.

How much particles are stretched: singular values and determinants of F.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.matrices import (
    CHUNK,
    _determinants,
    _newton,
    _signed_svd,
    _singular_values,
    entries,
    jacobi,
    quaternion_from_matrix,
)
from gf_usd.system.taichi_runtime import ensure_running

MANY = 1_500  # particles or more


def serves(count: int) -> bool:
    """Whether so many are many."""
    return count >= MANY


def rotations(F: Floats) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """R of F (N, 3, 3), and (N,) where the iteration found it: not where F is inverted or flat."""
    kernels = _kernels()
    R, done = np.empty(F.shape), np.zeros(len(F), np.int32)
    kernels.rotations(_flat(F), R.reshape(-1), done)
    return R, done > 0


def strains(F: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Singular values (N, 3), ascending, and determinants (N,) of F (N, 3, 3)."""
    kernels = _kernels()
    s, J = np.empty((len(F), 3)), np.empty(len(F))
    kernels.stretches(_flat(F), s.reshape(-1), J)
    return s, J


def carried(
    F: Floats, rest: Floats, R: Floats, turn: Floats, axes: Floats, last: Floats
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Axes (N, 3, 3), quaternions (N, 4) and scales (N, 3) of Gaussians after a frame.

    F, and R its rotations; rest : Q0 diag(s0); turn, axes (N, 3, 3), last (N, 4): of the frame
    before.
    """
    kernels = _kernels()
    axes_now, q, scales = np.empty(F.shape), np.empty((len(F), 4)), np.empty((len(F), 3))
    given = (_flat(a) for a in (F, rest, R, turn, axes, last))
    made = (a.reshape(-1) for a in (axes_now, q, scales))
    kernels.carry(*given, *made, len(F))
    return axes_now, q, scales


def _flat(values: Floats) -> NDArray[np.float64]:
    return np.ascontiguousarray(values, float).reshape(-1)


def _kernels() -> Any:
    ensure_running()
    from gf_usd.physics import per_particle_kernels

    return per_particle_kernels


def carried_by_numpy(
    F: Floats, rest: Floats, R: Floats, turn: Floats, axes: Floats, last: Floats
) -> tuple[Floats, Floats, Floats]:
    """See `many.carried`."""
    start = R @ np.swapaxes(turn, 1, 2) @ axes
    B = np.swapaxes(start, 1, 2) @ (F @ rest)
    S, spin = jacobi(B @ np.swapaxes(B, 1, 2))
    axes = start @ spin
    q = quaternion_from_matrix(axes)
    q *= np.where((q * last).sum(1, keepdims=True) < 0.0, -1.0, 1.0)
    return axes, q, np.sqrt(np.maximum(np.einsum("naa->na", S), 0.0))


def nearest_rotation(F: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) R of the polar decomposition with det R = 1: that of the signed SVD.

    By Newton's iteration Q <- (Q + Q^-T) / 2 (Higham 1986), several times as fast; by the SVD
    itself where F is inverted, or so flat that the iteration would take long.
    """
    F = np.asarray(F, float)
    if serves(len(F)):
        out, done = rotations(F)
        if not done.all():
            out[~done] = _signed_svd(F[~done])
        return out
    out = np.empty(F.shape)
    for k in range(0, len(F), CHUNK):
        some = slice(k, k + CHUNK)
        out[some], done = _newton(F[some])
        if not done.all():
            out[some][~done] = _signed_svd(F[some][~done])
    return out


def strains_by_numpy(F: Floats) -> tuple[Floats, Floats]:
    """Singular values (N, 3), ascending, and determinants (N,) of F (N, 3, 3)."""
    if serves(len(F)):
        return strains(F)
    q = entries(F)
    return _singular_values(q), _determinants(q)


def singular_values(F: Floats) -> Floats:
    """(N, 3) singular values, ascending: square roots of the eigenvalues of F^T F.

    The closed form for symmetric 3x3 matrices (Smith 1961), which is twenty times faster than a
    batched SVD and exact to about 1e-8 of the largest.
    """
    return strains(F)[0] if serves(len(F)) else _singular_values(entries(F))

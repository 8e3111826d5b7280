"""What a frame asks of every particle, where they are many: by `frame_kernel`.

A launch and the loading of a kernel cost more than NumPy takes for few.  Both ways agree to
rounding, and which is taken follows from the count alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats
from gf_usd.runtime import ensure_running

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
    from gf_usd.physics import frame_kernel

    return frame_kernel

"""NumPy arrays as USD's own."""

from __future__ import annotations

import numpy as np
from pxr import Vt

from gf_usd.model import Floats


def f32(values: Floats) -> np.ndarray:
    """Single precision, in one piece of memory as USD wants it."""
    return np.ascontiguousarray(values, np.float32)


def quaternions(wxyz: Floats) -> Vt.QuatfArray:
    """(N, 4) quaternions (w, x, y, z) in single precision."""
    return Vt.QuatfArray.FromNumpy(f32(xyzw(wxyz)))


def xyzw(wxyz: Floats) -> np.ndarray:
    """The order in which USD's FromNumpy reads quaternions."""
    return np.asarray(wxyz)[:, [1, 2, 3, 0]]


def box(low: Floats, high: Floats) -> Vt.Vec3fArray:
    """The extent with these corners (3,)."""
    return Vt.Vec3fArray.FromNumpy(f32(np.stack([low, high])))

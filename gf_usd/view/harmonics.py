"""What Gaussians with spherical harmonics show to a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.colour import srgb_to_linear
from gf_usd.harmonics import DEGREE, basis
from gf_usd.model import Floats
from gf_usd.scene import Harmonics


def seen_from(harmonics: Harmonics, towards: Floats) -> NDArray[np.floating]:
    """Linear colour (N, 3) = 0.5 + sum_k c_k Y_k(d) of splats seen along `towards` (N, 3)."""
    local = towards @ np.asarray(harmonics.frame).T
    local = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    used = min(harmonics.coefficients.shape[1], (DEGREE + 1) ** 2)
    weights = basis(local)[:, :used]
    value = 0.5 + np.einsum("nk,nkc->nc", weights, harmonics.coefficients[:, :used])
    value = np.maximum(value, 0.0)
    return srgb_to_linear(value) if harmonics.srgb else value

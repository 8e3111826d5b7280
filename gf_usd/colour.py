"""The sRGB transfer function (IEC 61966-2-1), both ways."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats


def srgb_to_linear(value: Floats) -> NDArray[np.floating]:
    """Linear light of encoded values, any shape: v / 12.92 below 0.04045, else a 2.4 power."""
    value = np.asarray(value)
    high = ((np.maximum(value, 0.0) + 0.055) / 1.055) ** 2.4
    return np.where(value <= 0.04045, value / 12.92, high)


def linear_to_srgb(value: Floats) -> NDArray[np.floating]:
    """Encoded values of linear light, any shape: the inverse of `srgb_to_linear`."""
    value = np.asarray(value)
    high = 1.055 * np.maximum(value, 0.0) ** (1.0 / 2.4) - 0.055
    return np.where(value <= 0.0031308, 12.92 * value, high)

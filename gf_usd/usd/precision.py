"""Single or half precision, and how far the latter is off.

A half has 11 bits: it is off by 2^-11 of a number at most while that is between 6.1e-5 and 65504.
The particle field of UsdVol has a half twin, with an h behind its name, for every array; ours are
used for all but the positions, which would jump: 0.03 in 100.  UsdGeom's points, velocities,
normals and extents, and the arrays of GaussianFleshParticlesAPI, have no half form in their
schemas.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Usd, Vt

from gf_usd.errors import BakeError
from gf_usd.model import Floats
from gf_usd.usd.values import f32

Types = Sdf.ValueTypeNames
LOWEST, HIGHEST = 6.2e-5, 65504.0
ROOM = 8.0  # how much scales may change in a bake and stay in the range of precise halves


@dataclass(frozen=True)
class Form:
    """The two forms of an attribute: (USD type, maker of the array)."""

    single: tuple[Any, Callable[[Any], Any]]
    half: tuple[Any, Callable[[Any], Any]]


VECTORS = Form(
    (Types.Float3Array, Vt.Vec3fArray.FromNumpy), (Types.Half3Array, Vt.Vec3hArray.FromNumpy)
)
QUATERNIONS = Form(
    (Types.QuatfArray, Vt.QuatfArray.FromNumpy), (Types.QuathArray, Vt.QuathArray.FromNumpy)
)
NUMBERS = Form(
    (Types.FloatArray, Vt.FloatArray.FromNumpy), (Types.HalfArray, Vt.HalfArray.FromNumpy)
)


class Track:
    """One array attribute in the precision that was chosen.

    Parameters
    ----------
    prim, name, form : where, and as what; a half gets an h behind the name.
    half : whether to use it.
    relative : measure the error against each number; else as it is.
    """

    def __init__(
        self, prim: Usd.Prim, name: str, form: Form, half: bool, *, relative: bool = False
    ) -> None:
        self.name, self.half, self.error = name, half, 0.0
        self._relative = relative
        kind, self._make = form.half if half else form.single
        self._attribute = prim.CreateAttribute(f"{name}h" if half else name, kind, False)

    def write(self, values: Floats, time: Usd.TimeCode | float) -> np.ndarray:
        """Author the array; returns it as rounded.

        Raises BakeError for a number that is beyond a half.
        """
        rounded = f32(values)
        if self.half:
            largest = float(np.abs(rounded).max(initial=0.0))
            if largest > HIGHEST:
                raise BakeError(
                    f"{self.name} up to {largest:.4g} do not fit into half precision.",
                    "leave --half out",
                )
            rounded = rounded.astype(np.float16)
            self._measure(np.asarray(values, np.float64), rounded)
        self._attribute.Set(self._make(rounded), time)
        return rounded

    def _measure(self, values: np.ndarray, rounded: np.ndarray) -> None:
        error = np.abs(rounded.astype(np.float64) - values)
        if self._relative:
            size = np.abs(values)
            error = np.divide(error, size, out=np.zeros_like(error), where=size > 0)
        self.error = max(self.error, float(error.max(initial=0.0)))

    @property
    def said(self) -> str:
        """The largest error in words."""
        if self._relative:
            return f"{self.name} by {100.0 * self.error:.2g} %"
        return f"{self.name} by {self.error:.2g}"


def halves_do(values: Floats) -> bool:
    """Whether positive numbers, and ones a few times smaller or larger, are precise as halves."""
    values = np.asarray(values, np.float64)
    low, high = values.min(initial=np.inf), values.max(initial=0.0)
    return bool(low >= LOWEST * ROOM and high <= HIGHEST / ROOM)

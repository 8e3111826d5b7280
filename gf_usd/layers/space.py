"""Transforms from world space, in meters, to a prim's local space, in stage units.

With row vectors and W(t) the inverse of the prim's local-to-world matrix (rows 0-2 linear, row 3
offset), a world point x(t) and its velocity v become

    p = x W,    dp/dt = v W + x dW/dt

which is also valid for animated transforms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats, lengths
from gf_usd.core.errors import InputError
from gf_usd.core.units import code_text
from gf_usd.layers.stage import Clock

Matrix = NDArray[np.float64]

# Below this ratio of singular values, float32 points cannot be transformed back.
SINGULAR = 1e-7
# Frames either side for dW/dt: small, so that its second-order error is (turn per frame)^2 / 2400,
# and large against the 1e-7 of transforms that are authored as floats.
NUDGE = 0.05


class Space:
    """The local space of one prim of the source over the time of a bake.

    Parameters
    ----------
    prim : prim of the source stage.
    clock : the bake's time line.
    meters_per_unit : [m] per stage length.
    """

    def __init__(self, prim: Usd.Prim, clock: Clock, meters_per_unit: float) -> None:
        self._prim = prim
        self._clock = clock
        self._unit = meters_per_unit
        self.animated = _moves(prim)
        self._still = None if self.animated else self._inverse(clock.start)
        self._forward = None if self._still is None else np.linalg.inv(self._still[:3, :3])

    def from_world(self, time_code: float) -> Matrix:
        """W (4, 4) at a time code of the bake, for row vectors in stage units.

        Raises InputError where the prim's transform is singular.
        """
        return self._inverse(time_code) if self._still is None else self._still

    def points(self, x: Floats, time_code: float) -> Matrix:
        """World points (n, 3) [m] in local stage units."""
        w = self.from_world(time_code)
        return (np.asarray(x, np.float64) / self._unit) @ w[:3, :3] + w[3, :3]

    def velocities(self, x: Floats, v: Floats, time_code: float) -> Matrix:
        """Rate of change (n, 3) of the local points of a body at x [m] with velocity v [m/s].

        Stage units per second.
        """
        w = self.from_world(time_code)
        local = (np.asarray(v, np.float64) / self._unit) @ w[:3, :3]
        if not self.animated:
            return local
        nudge = NUDGE * self._clock.step
        before = max(time_code - nudge, min(self._clock.start, time_code))
        after = min(time_code + nudge, max(self._clock.end, time_code))
        if after == before:
            return local
        rate = (self._inverse(after) - self._inverse(before)) * self._clock.rate / (after - before)
        return local + (np.asarray(x, np.float64) / self._unit) @ rate[:3, :3] + rate[3, :3]

    def normals(self, n: Floats, time_code: float) -> Matrix:
        """World unit normals (k, 3) as local unit normals: covectors, n_l ~ n (W^-1)^T."""
        forward = self._forward
        if forward is None:
            forward = np.linalg.inv(self.from_world(time_code)[:3, :3])
        local = np.asarray(n, np.float64) @ forward.T
        length = lengths(local)[:, None]
        if length.all():
            return np.divide(local, length, out=local)
        return np.divide(local, length, out=np.zeros_like(local), where=length > 0)

    def _inverse(self, time_code: float) -> Matrix:
        cache = UsdGeom.XformCache(self._clock.source_time(time_code))
        matrix = np.array(cache.GetLocalToWorldTransform(self._prim))
        stretch = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        if not stretch[-1] > SINGULAR * stretch[0]:
            raise InputError(
                f"<{self._prim.GetPath()}>: the local-to-world transform at time code "
                f"{code_text(time_code)} flattens space (scales {stretch[0]:.3g} to"
                f" {stretch[-1]:.3g})",
                "give the prim and its parents scales other than zero, or exclude it from the bake",
            )
        return np.linalg.inv(matrix)


def _moves(prim: Usd.Prim) -> bool:
    while prim and not prim.IsPseudoRoot():
        xform = UsdGeom.Xformable(prim)
        if xform and xform.TransformMightBeTimeVarying():
            return True
        prim = prim.GetParent()
    return False

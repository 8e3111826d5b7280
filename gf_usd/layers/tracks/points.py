"""The twin of the Gaussians for programs that do not know them: UsdGeomPoints."""

from __future__ import annotations

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats, corners
from gf_usd.core.frames import Particles
from gf_usd.layers.stage import box, f32


class PointsTrack:
    """Streams the particles as balls of their volumes.

    Parameters
    ----------
    cache, path : stage and prim path of the Points.
    p : the particles.
    meters_per_unit : [m] per stage length.
    velocities : whether they are written.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        p: Particles,
        meters_per_unit: float,
        *,
        velocities: bool = True,
    ) -> None:
        points = UsdGeom.Points.Define(cache, path)
        self.prim = points.GetPrim()
        self.low = self.high = np.zeros(3)
        self._points = points.CreatePointsAttr()
        self._velocities = points.CreateVelocitiesAttr() if velocities else None
        self._extent = points.CreateExtentAttr()
        widths = np.cbrt(6.0 * np.asarray(p.V0, np.float64) / np.pi) / meters_per_unit
        self._widths = f32(widths)
        points.CreateWidthsAttr(Vt.FloatArray.FromNumpy(self._widths))
        points.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        points.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.arange(len(p), dtype=np.int64)))
        color = points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        color.Set(Vt.Vec3fArray.FromNumpy(f32(p.color)))

    def write(self, positions: Floats, velocities: Vt.Vec3fArray, time_code: float) -> None:
        """Author positions (N, 3) and velocities in stage units."""
        # in single precision, so that it is bit for bit what USD computes from points and widths
        single = f32(positions)
        self._points.Set(Vt.Vec3fArray.FromNumpy(single), time_code)
        if self._velocities is not None:
            self._velocities.Set(velocities, time_code)
        half = self._widths[:, None] * np.float32(0.5)
        self.low, self.high = corners(single - half)[0], corners(single + half)[1]
        self._extent.Set(box(self.low, self.high), time_code)

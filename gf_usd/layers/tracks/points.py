"""The particles as UsdGeomPoints, for programs that do not support Gaussians."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Ints, corners
from gf_usd.core.frames.particles import Particles
from gf_usd.layers.stage import box, f32


class PointsTrack:
    """Writes the particles as balls of their volumes.

    Parameters
    ----------
    cache, path : stage and prim path of the Points.
    p : the particles.
    meters_per_unit : [m] per stage length.
    velocities : whether they are written.
    some : the number of particles may change between time codes.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        p: Particles,
        meters_per_unit: float,
        *,
        velocities: bool = True,
        some: bool = False,
    ) -> None:
        points = UsdGeom.Points.Define(cache, path)
        self.prim = points.GetPrim()
        self.low = self.high = np.zeros(3)
        self.empty = False
        self._some = some
        self._points = points.CreatePointsAttr()
        self._velocities = points.CreateVelocitiesAttr() if velocities else None
        self._extent = points.CreateExtentAttr()
        widths = np.cbrt(6.0 * np.asarray(p.V0, np.float64) / np.pi) / meters_per_unit
        self._widths = f32(widths)
        self._ids, self._color = np.arange(len(p), dtype=np.int64), f32(p.color)
        self._constant = (
            points.CreateWidthsAttr(),
            points.CreateIdsAttr(),
            points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex),
        )
        points.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        if not some:
            self._write_constant(slice(None), Usd.TimeCode.Default())

    def write(
        self,
        points: Vt.Vec3fArray,
        velocities: Vt.Vec3fArray,
        time_code: float,
        rows: Ints | None = None,
    ) -> None:
        """Author positions and velocities in stage units.

        rows : (n,) the particles of the positions; None: all.
        """
        # in single precision, so that it is bit for bit what USD computes from points and widths
        single = np.asarray(points)
        self._points.Set(points, time_code)
        if self._velocities is not None:
            self._velocities.Set(velocities, time_code)
        widths = self._widths
        if self._some:
            rows = self._ids if rows is None else rows
            widths = widths[rows]
            self._write_constant(rows, time_code)
        self.empty = len(single) == 0
        if not self.empty:
            half = widths[:, None] * np.float32(0.5)
            self.low, self.high = corners(single - half)[0], corners(single + half)[1]
        self._extent.Set(box(self.low, self.high), time_code)

    def _write_constant(self, rows: Any, time: Any) -> None:
        """Author the constant attributes of the particles of `rows`."""
        widths, ids, color = self._constant
        widths.Set(Vt.FloatArray.FromNumpy(self._widths[rows]), time)
        ids.Set(Vt.Int64Array.FromNumpy(self._ids[rows]), time)
        color.Set(Vt.Vec3fArray.FromNumpy(self._color[rows]), time)

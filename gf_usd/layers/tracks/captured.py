"""Captured Gaussians in the cache layer: overs on their own prim, in its own local space.

Positions, orientations, scales and extent have a sample for each frame; the spherical harmonics
too where their degree is above 0, in half precision, as UsdVol allows (a relative error of 5e-4).
Opacities, hints and all other attributes remain those of the source.
"""

from __future__ import annotations

import numpy as np
from pxr import Sdf, Usd, Vt

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import SplatPose, Surface
from gf_usd.core.matrices import gaussian_axes
from gf_usd.layers.space import Space
from gf_usd.layers.stage import Clock
from gf_usd.layers.tracks.meshes import check

Types = Sdf.ValueTypeNames
HARMONICS = "radiance:sphericalHarmonicsCoefficients"
HALVES = ("positionsh", "orientationsh", "scalesh")
SUPPORT = 3.0  # [standard deviations] cutoff of a kernel (UsdVol)


class SplatTrack:
    """Writes one set of captured Gaussians.

    Parameters
    ----------
    cache : stage whose root layer is the cache.
    prim : their prim in the source.
    surface : their surface, with `splats`.
    clock, meters_per_unit : of the bake.
    """

    rest = None  # of `Group`: positions and shapes of a capture are written from the first frame on

    def __init__(
        self, cache: Usd.Stage, prim: Usd.Prim, surface: Surface, clock: Clock, unit: float
    ) -> None:
        assert surface.splats is not None
        self.path = Sdf.Path(surface.path)
        self.space = Space(prim, clock, unit)
        self.low = self.high = np.zeros(3)
        self.notes: list[str] = []
        self._splats = surface.splats
        over = cache.OverridePrim(self.path)
        self._positions = over.CreateAttribute("positions", Types.Point3fArray, False)
        self._orientations = over.CreateAttribute("orientations", Types.QuatfArray, False)
        self._scales = over.CreateAttribute("scales", Types.Float3Array, False)
        self._extent = over.CreateAttribute("extent", Types.Float3Array, False)
        for name in HALVES:
            self._block(over, prim, name)
        self._harmonics = None
        if self._splats.degree > 0:
            self._harmonics = over.CreateAttribute(f"{HARMONICS}h", Types.Half3Array, False)
            # float is preferred where both exist
            self._block(over, prim, HARMONICS)

    def write(self, pose: SplatPose, time_code: float) -> None:
        """Author the pose at a time code.

        Raises BakeError where an array has another length than the Gaussians or is not finite.
        """
        count = len(self._splats)
        for name, width in (("positions", 3), ("orientations", 4), ("scales", 3)):
            check(getattr(pose, name), (count, width), f"{name} of <{self.path}>", time_code)
        at = self.space.points(pose.positions, time_code)
        self._positions.Set(Vt.Vec3fArray.FromNumpy(_f32(at)), time_code)
        turns = np.asarray(pose.orientations)[:, [1, 2, 3, 0]]  # FromNumpy reads (x, y, z, w)
        self._orientations.Set(Vt.QuatfArray.FromNumpy(_f32(turns)), time_code)
        self._scales.Set(Vt.Vec3fArray.FromNumpy(_f32(pose.scales)), time_code)
        axes = gaussian_axes(pose.orientations, pose.scales)
        reach = SUPPORT * np.sqrt((axes**2).sum(axis=2))
        self.low, self.high = (at - reach).min(axis=0), (at + reach).max(axis=0)
        extent = np.stack([self.low, self.high])
        self._extent.Set(Vt.Vec3fArray.FromNumpy(_f32(extent)), time_code)
        if self._harmonics is not None and pose.harmonics is not None:
            shape = np.shape(self._splats.harmonics)
            check(pose.harmonics, shape, f"harmonics of <{self.path}>", time_code)
            flat = np.ascontiguousarray(pose.harmonics.reshape(-1, 3), np.float16)
            self._harmonics.Set(Vt.Vec3hArray.FromNumpy(flat), time_code)

    def to_world(self, time_code: float) -> Floats:
        """Local-to-world matrix (4, 4) for row vectors, stage units."""
        return np.linalg.inv(self.space.from_world(time_code))

    @staticmethod
    def _block(over: Usd.Prim, prim: Usd.Prim, name: str) -> None:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.HasAuthoredValue():
            over.CreateAttribute(name, attribute.GetTypeName(), False).Block()


def _f32(values: Floats) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)

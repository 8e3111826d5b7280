"""The deformed Gaussians: a ParticleField3DGaussianSplat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Sdf, Usd, UsdVol, Vt

from gf_usd.model import Floats, GaussianPose, Particles, Settings
from gf_usd.rows import corners
from gf_usd.units import StageUnits
from gf_usd.usd.meshes import check
from gf_usd.usd.precision import NUMBERS, QUATERNIONS, VECTORS, Track, halves_do
from gf_usd.usd.values import box, f32, xyzw

Types = Sdf.ValueTypeNames
UNIFORM = Sdf.VariabilityUniform
# Y_00, the value of the first spherical harmonic
SH_0 = 0.28209479177387814
# A kernel's support ends at three standard deviations (UsdVol)
SUPPORT = 3.0


class SplatTrack:
    """Streams the Gaussians.

    Parameters
    ----------
    cache, path : stage and prim path of the field.
    p : the particles.
    settings : of the bake: whether deformation gradients and stress are written.
    units : of the stage.
    half : half precision where it is safe.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        p: Particles,
        settings: Settings,
        units: StageUnits,
        half: bool = False,
    ) -> None:
        self._path, self._count, self._units = path, len(p), units
        splats = UsdVol.ParticleField3DGaussianSplat.Define(cache, path)
        self.prim = prim = splats.GetPrim()
        self.low = self.high = np.zeros(3)
        self._positions = self._varying("positions", Types.Point3fArray)
        rest = np.asarray(p.scale, np.float64) / units.length
        fits = halves_do(rest)
        self._range = "" if fits or not half else f"{rest.min():.3g} to {rest.max():.3g}"
        self._orientations = Track(prim, "orientations", QUATERNIONS, half)
        self._scales = Track(prim, "scales", VECTORS, half and fits, relative=True)
        self._velocities = self._varying("gaussianFlesh:velocities", Types.Vector3fArray)
        self._extent = splats.CreateExtentAttr()
        opacities = Track(prim, "opacities", NUMBERS, half)
        opacities.write(p.opacity, Usd.TimeCode.Default())
        degree = prim.CreateAttribute(
            "radiance:sphericalHarmonicsDegree", Types.Int, False, UNIFORM
        )
        degree.Set(0)
        flat = (np.asarray(p.colour, np.float64) - 0.5) / SH_0
        colours = Track(prim, "radiance:sphericalHarmonicsCoefficients", VECTORS, half)
        colours.write(flat, Usd.TimeCode.Default())
        self._halves = [
            track for track in (self._orientations, self._scales, opacities, colours) if track.half
        ]
        for name, value in (("projectionModeHint", "perspective"), ("sortingModeHint", "zDepth")):
            prim.CreateAttribute(name, Types.Token, False, UNIFORM).Set(value)
        if settings.deformation_gradients:
            name = "gaussianFlesh:deformationGradients"
            self._gradients = self._varying(name, Types.Matrix3dArray)
        if settings.stress:
            self._stress = self._varying("gaussianFlesh:vonMisesStress", Types.FloatArray)

    def write(
        self, pose: GaussianPose, positions: Floats, velocities: Vt.Vec3fArray, time_code: float
    ) -> None:
        """Author a pose; positions (N, 3) and velocities are its own in stage units.

        Raises BakeError where an array has another length than the particles or is not finite.
        """
        for name, width in (("orientations", 4), ("scales", 3)):
            check(getattr(pose, name), (self._count, width), self._named(name), time_code)
        scales = np.asarray(pose.scales, np.float64) / self._units.length
        self._positions.Set(Vt.Vec3fArray.FromNumpy(f32(positions)), time_code)
        self._orientations.write(xyzw(pose.orientations), time_code)
        scales = self._scales.write(scales, time_code).astype(np.float64)
        self._velocities.Set(velocities, time_code)
        if pose.F is not None:
            check(pose.F, (self._count, 3, 3), self._named("deformation gradients"), time_code)
            gradients = np.ascontiguousarray(pose.F, dtype=np.float64)
            self._gradients.Set(Vt.Matrix3dArray.FromNumpy(gradients), time_code)
        if pose.stress is not None:
            check(pose.stress, (self._count,), self._named("stress"), time_code)
            stress = np.asarray(pose.stress) / self._units.pressure
            self._stress.Set(Vt.FloatArray.FromNumpy(f32(stress)), time_code)
        reach = SUPPORT * np.sqrt(_variances(pose.orientations, scales))
        self.low = corners(positions - reach)[0]
        self.high = corners(positions + reach)[1]
        self._extent.Set(box(self.low, self.high), time_code)

    @property
    def errors(self) -> list[float]:
        """Largest error so far of each array in half precision."""
        return [track.error for track in self._halves]

    @errors.setter
    def errors(self, known: Sequence[float]) -> None:
        for track, error in zip(self._halves, known):
            track.error = error

    @property
    def notes(self) -> tuple[str, ...]:
        """What half precision costs, in words."""
        if not self._halves:
            return ()
        off = ", ".join(track.said for track in self._halves)
        notes = (f"<{self._path}>: in half precision, off by at most: {off}",)
        if self._range:
            why = f"half precision is too coarse for {self._range}"
            notes += (f"<{self._path}>: its scales stay in single precision: {why}",)
        return notes

    def _varying(self, name: str, kind: Sdf.ValueTypeName) -> Usd.Attribute:
        return self.prim.CreateAttribute(name, kind, False)

    def _named(self, what: str) -> str:
        return f"{what} of <{self._path}>"


def _variances(wxyz: Floats, scales: Floats) -> np.ndarray:
    """Diagonal (N, 3) of R diag(s^2) R' for quaternions (w, x, y, z)."""
    w, x, y, z = np.asarray(wxyz, np.float64).T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.einsum("ikn,nk->ni", rotation**2, scales**2)

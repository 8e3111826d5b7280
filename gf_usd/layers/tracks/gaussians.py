"""The deformed Gaussians: a ParticleField3DGaussianSplat.

Arrays are in single or in half precision.  A half has 11 bits: its relative error is 2^-11 at most
for numbers between 6.1e-5 and 65504.  UsdVol defines a second attribute in half precision, with an
h after its name, for every array of a particle field.  They are used for all arrays except the
positions, which would move in visible steps: 0.03 at 100.  The schemas of UsdGeom's points,
velocities, normals and extents, and of GaussianFleshParticlesAPI, have no half precision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdVol, Vt

from gf_usd.core.arrays import Floats, columns, corners
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.frame import GaussianPose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.laws import law_internals
from gf_usd.core.matrices import rotation_rows
from gf_usd.core.units import StageUnits, code_text, percent_text
from gf_usd.layers.stage import box, f32, xyzw
from gf_usd.layers.tracks.accuracy import HALF_SHAPE, shape_errors
from gf_usd.layers.tracks.meshes import check
from gf_usd.layers.tracks.sparse import Saved

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
    shape : (N,) [stage units] tolerance of the shape of each (see `accuracy`): orientations
        and scales have half precision where that is within it.  None: as `half` says.
    velocities : whether they are written.
    laws : of the materials; their internal variables are written where the settings request them.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        p: Particles,
        settings: Settings,
        units: StageUnits,
        half: bool = False,
        laws: Sequence[str] = (),
        *,
        shape: Floats | None = None,
        velocities: bool = True,
    ) -> None:
        self._path, self._count, self._units = path, len(p), units
        splats = UsdVol.ParticleField3DGaussianSplat.Define(cache, path)
        self.prim = prim = splats.GetPrim()
        self.low = self.high = np.zeros(3)
        self._positions = self._varying("positions", Types.Point3fArray)
        rest = np.asarray(p.scale, np.float64) / units.length
        fits = half_is_precise(rest)
        self._range = "" if fits or not half else f"{rest.min():.3g} to {rest.max():.3g}"
        self._shape, self.shape_error = shape, 0.0
        bound = HALF_SHAPE * GROWTH * rest.max(axis=1)
        self.rounded = shape is not None and fits and bool((bound <= shape).all())
        self._too_coarse = 0.0 if shape is None or self.rounded else float(bound.max())
        low = half or self.rounded
        self._orientations = Track(prim, "orientations", QUATERNIONS, low)
        self._scales = Track(prim, "scales", VECTORS, low and fits, relative=True)
        self._velocities = None
        if velocities:
            self._velocities = self._varying("gaussianFlesh:velocities", Types.Vector3fArray)
        self._extent = splats.CreateExtentAttr()
        opacities = Track(prim, "opacities", NUMBERS, half)
        opacities.write(p.opacity, Usd.TimeCode.Default())
        degree = prim.CreateAttribute(
            "radiance:sphericalHarmonicsDegree", Types.Int, False, UNIFORM
        )
        degree.Set(0)
        flat = (np.asarray(p.color, np.float64) - 0.5) / SH_0
        colors = Track(prim, "radiance:sphericalHarmonicsCoefficients", VECTORS, half)
        colors.write(flat, Usd.TimeCode.Default())
        self._halves = [
            track for track in (self._orientations, self._scales, opacities, colors) if track.half
        ]
        for name, value in (("projectionModeHint", "perspective"), ("sortingModeHint", "zDepth")):
            prim.CreateAttribute(name, Types.Token, False, UNIFORM).Set(value)
        if settings.deformation_gradients:
            name = "gaussianFlesh:deformationGradients"
            self._gradients = self._varying(name, Types.Matrix3dArray)
        if settings.stress:
            self._stress = self._varying("gaussianFlesh:vonMisesStress", Types.FloatArray)
        self._internal = {
            one.name: (one.rest, self._varying(f"gaussianFlesh:{one.attribute}", Types.FloatArray))
            for one in (law_internals(laws) if settings.internal else ())
        }

    def write(
        self,
        pose: GaussianPose,
        positions: Floats,
        points: Vt.Vec3fArray,
        velocities: Vt.Vec3fArray,
        time_code: float,
    ) -> None:
        """Author a pose; positions (N, 3), in single precision too, and velocities are its own in
        stage units.

        Raises BakeError where an array has another length than the particles or is not finite.
        """
        for name, width in (("orientations", 4), ("scales", 3)):
            check(getattr(pose, name), (self._count, width), self._named(name), time_code)
        scales = np.asarray(pose.scales, np.float64) / self._units.length
        self._positions.Set(points, time_code)
        true = xyzw(pose.orientations), scales
        turns = self._orientations.write(true[0], time_code)
        rounded = self._scales.write(scales, time_code)
        scales = rounded.astype(np.float64)
        if self.rounded:
            self._require_shape(shape_errors((turns, rounded), true), time_code)
        if self._velocities is not None:
            self._velocities.Set(velocities, time_code)
        if pose.F is not None:
            check(pose.F, (self._count, 3, 3), self._named("deformation gradients"), time_code)
            gradients = np.ascontiguousarray(pose.F, dtype=np.float64)
            self._gradients.Set(Vt.Matrix3dArray.FromNumpy(gradients), time_code)
        if pose.stress is not None:
            check(pose.stress, (self._count,), self._named("stress"), time_code)
            stress = np.asarray(pose.stress) / self._units.pressure
            self._stress.Set(Vt.FloatArray.FromNumpy(f32(stress)), time_code)
        for name, (rest, attribute) in self._internal.items():
            values = np.nan_to_num(
                pose.internal[name], nan=rest
            )  # for laws without the variable: its rest value
            check(values, (self._count,), self._named(name), time_code)
            attribute.Set(Vt.FloatArray.FromNumpy(f32(values)), time_code)
        reach = SUPPORT * np.sqrt(_variances(pose.orientations, scales))
        self.low = corners(positions - reach)[0]
        self.high = corners(positions + reach)[1]
        self._extent.Set(box(self.low, self.high), time_code)

    def _require_shape(self, errors: Floats, time_code: float) -> None:
        """Record the errors of shapes; raises BakeError where one exceeds its tolerance."""
        assert self._shape is not None
        self.shape_error = max(self.shape_error, float(errors.max(initial=0.0)))
        worst = int((errors / self._shape).argmax())
        if errors[worst] > self._shape[worst]:
            raise BakeError(
                f"<{self._path}> at time code {code_text(time_code)}: in half precision, Gaussian"
                f" {worst} has an error of {errors[worst]:.3g} stage units, but"
                f" {self._shape[worst]:.3g} is allowed: it grew more than {GROWTH:g} times",
                "give a --precision so fine that single precision is kept, or leave it out",
            )

    def state(self) -> dict[str, Any]:
        """The state from which another track of the same bake continues."""
        halves = [[one.error, asdict(one.singles), asdict(one.stored)] for one in self._halves]
        return {"halves": halves, "shape": self.shape_error}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state of the track that wrote the existing samples."""
        for track, (error, singles, stored) in zip(self._halves, state["halves"]):
            track.error = error
            track.singles, track.stored = Saved(**singles), Saved(**stored)
        self.shape_error = state["shape"]

    @property
    def saved(self) -> int:
        """[bytes] that half precision saves."""
        return sum(track.singles.bytes - track.stored.bytes for track in self._halves)

    @property
    def notes(self) -> tuple[str, ...]:
        """Text on the error of half precision."""
        if self._too_coarse:
            return (
                f"<{self._path}>: its orientations and scales stay in single precision: in half "
                f"precision, their error may be {self._too_coarse:.2g} stage units, which is "
                f"more than --precision allows",
            )
        if not self._halves:
            return ()
        off = ", ".join(track.text for track in self._halves)
        notes = (f"<{self._path}>: largest errors in half precision: {off}",)
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
    rows = rotation_rows(columns(np.asarray(wxyz, np.float64)))
    a, b, c = columns(scales**2)
    return np.stack([p * p * a + r * r * c + q * q * b for p, q, r in rows], -1)


LOWEST, HIGHEST = 6.2e-5, 65504.0
SCALE_RANGE = 8.0  # how much scales may change in a bake and stay in the range of precise halves
GROWTH = 4.0  # how much the largest may grow; bakes of rubber stretch it by 1.8


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
    """One array attribute in the selected precision.

    Parameters
    ----------
    prim, name, form : the attribute; a half attribute has the suffix h.
    half : whether to use it.
    relative : measure the relative error; else the absolute one.
    """

    def __init__(
        self, prim: Usd.Prim, name: str, form: Form, half: bool, *, relative: bool = False
    ) -> None:
        self.name, self.half, self.error = name, half, 0.0
        self.singles, self.stored = (
            Saved(),
            Saved(),
        )  # of half attributes: original and stored values
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
                    f"{self.name} up to {largest:.4g} do not fit in half precision",
                    "leave --half out",
                )
            self.singles.count(rounded, rounded.nbytes)
            rounded = rounded.astype(np.float16)
            self._measure(np.asarray(values, np.float64), rounded)
            self.stored.count(rounded, rounded.nbytes)
        self._attribute.Set(self._make(rounded), time)
        return rounded

    def _measure(self, values: np.ndarray, rounded: np.ndarray) -> None:
        error = np.abs(rounded.astype(np.float64) - values)
        if self._relative:
            size = np.abs(values)
            error = np.divide(error, size, out=np.zeros_like(error), where=size > 0)
        self.error = max(self.error, float(error.max(initial=0.0)))

    @property
    def text(self) -> str:
        """A note on the largest error."""
        if self._relative:
            return f"{self.name} by {percent_text(self.error)}"
        return f"{self.name} by {self.error:.2g}"


def half_is_precise(values: Floats) -> bool:
    """Whether positive numbers, also multiplied by a small factor, are in the precise range of
    halves.
    """
    values = np.asarray(values, np.float64)
    low, high = values.min(initial=np.inf), values.max(initial=0.0)
    return bool(low >= LOWEST * SCALE_RANGE and high <= HIGHEST / SCALE_RANGE)

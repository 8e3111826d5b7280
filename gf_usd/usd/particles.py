"""The particle prims of the cache: a Gaussian splat field and its twin of points.

Both stand in the world frame of the source: where the root prim above them has a transform of its
own, theirs is its inverse, so that they follow the asset wherever a shot puts it.
"""

from __future__ import annotations

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt

from gf_usd.model import Asset, BakeInfo, Floats, GaussianPose, Particles
from gf_usd.usd import schema  # noqa: F401  (registers the schema before its APIs are applied)
from gf_usd.usd.materials import bind, write_materials
from gf_usd.usd.meshes import check
from gf_usd.usd.space import Space
from gf_usd.usd.stage import Clock, Home

Types = Sdf.ValueTypeNames
UNIFORM = Sdf.VariabilityUniform
# Y_00, the value of the first spherical harmonic
SH_0 = 0.28209479177387814
# A kernel's support ends at three standard deviations (UsdVol)
SUPPORT = 3.0


class ParticleTrack:
    """Streams the Gaussians of a bake.

    Parameters
    ----------
    cache : stage whose root layer is the cache.
    root : the home's root prim in the source.
    home, asset, particles, info, clock : of the bake.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        root: Usd.Prim,
        home: Home,
        asset: Asset,
        particles: Particles,
        info: BakeInfo,
        clock: Clock,
    ) -> None:
        self._count = len(particles)
        self._unit = asset.facts.units.length
        self._pressure = asset.facts.units.pressure
        self._path = home.scope
        UsdGeom.Scope.Define(cache, home.scope)
        splats = UsdVol.ParticleField3DGaussianSplat.Define(
            cache, home.scope.AppendChild("Gaussians")
        )
        points = UsdGeom.Points.Define(cache, home.scope.AppendChild("Points"))
        prims = (splats.GetPrim(), points.GetPrim())
        materials = write_materials(
            cache,
            home.scope.AppendChild("Materials"),
            info.materials,
            info.look,
            asset.facts.units,
        )
        self._define_splats(splats, particles)
        if info.settings.deformation_gradients:
            self._gradients = splats.GetPrim().CreateAttribute(
                "gaussianFlesh:deformationGradients", Types.Matrix3dArray, False
            )
        if info.settings.stress:
            self._stress = splats.GetPrim().CreateAttribute(
                "gaussianFlesh:vonMisesStress", Types.FloatArray, False
            )
        self._define_points(points, particles)
        meshes = [Sdf.Path(s.path) for s in asset.surfaces]
        for prim in prims:
            _describe(prim, asset, particles, info)
            prim.CreateRelationship("gaussianFlesh:materials", False).SetTargets(materials)
            # a payload may not point outside its root prim: the root layer adds the rest
            inside = [p for p in meshes if p.HasPrefix(home.scope.GetPrefixes()[0])]
            prim.CreateRelationship("gaussianFlesh:sourceMeshes", False).SetTargets(inside)
            if len(materials) == 1:
                bind(prim, materials[0])
        self._space = Space(root, clock, self._unit) if home.inside else None
        self._transforms = self._place(prims, clock.start)

    def write(self, pose: GaussianPose, time_code: float) -> None:
        """Author the pose at a time code.

        Raises BakeError where an array has another length than the particles or is not finite.
        """
        for name, width in (("positions", 3), ("velocities", 3), ("orientations", 4)):
            check(getattr(pose, name), (self._count, width), self._named(name), time_code)
        check(pose.scales, (self._count, 3), self._named("scales"), time_code)
        positions = np.asarray(pose.positions, np.float64) / self._unit
        scales = np.asarray(pose.scales, np.float64) / self._unit
        single = _f32(positions)
        vectors = Vt.Vec3fArray.FromNumpy(single)
        velocities = Vt.Vec3fArray.FromNumpy(_f32(np.asarray(pose.velocities) / self._unit))
        self._positions.Set(vectors, time_code)
        self._orientations.Set(_quaternions(pose.orientations), time_code)
        self._scales.Set(Vt.Vec3fArray.FromNumpy(_f32(scales)), time_code)
        self._velocities.Set(velocities, time_code)
        if pose.F is not None:
            check(pose.F, (self._count, 3, 3), self._named("deformation gradients"), time_code)
            gradients = np.ascontiguousarray(pose.F, dtype=np.float64)
            self._gradients.Set(Vt.Matrix3dArray.FromNumpy(gradients), time_code)
        if pose.stress is not None:
            check(pose.stress, (self._count,), self._named("stress"), time_code)
            stress = np.asarray(pose.stress) / self._pressure
            self._stress.Set(Vt.FloatArray.FromNumpy(_f32(stress)), time_code)
        reach = SUPPORT * np.sqrt(_variances(pose.orientations, scales))
        self._splat_extent.Set(_box(positions - reach, positions + reach), time_code)
        self._twin_points.Set(vectors, time_code)
        self._twin_velocities.Set(velocities, time_code)
        # in single precision, so that it is bit for bit what USD computes from points and widths
        half = self._widths[:, None] * np.float32(0.5)
        self._twin_extent.Set(_box(single - half, single + half), time_code)
        if self._space is not None and self._space.animated:
            matrix = Gf.Matrix4d(self._space.from_world(time_code))
            for transform in self._transforms:
                transform.Set(matrix, time_code)

    def _define_splats(self, splats: UsdVol.ParticleField3DGaussianSplat, p: Particles) -> None:
        prim = splats.GetPrim()
        self._positions = prim.CreateAttribute("positions", Types.Point3fArray, False)
        self._orientations = prim.CreateAttribute("orientations", Types.QuatfArray, False)
        self._scales = prim.CreateAttribute("scales", Types.Float3Array, False)
        self._velocities = prim.CreateAttribute(
            "gaussianFlesh:velocities", Types.Vector3fArray, False
        )
        self._splat_extent = splats.CreateExtentAttr()
        opacities = Vt.FloatArray.FromNumpy(_f32(p.opacity))
        prim.CreateAttribute("opacities", Types.FloatArray, False).Set(opacities)
        degree = prim.CreateAttribute(
            "radiance:sphericalHarmonicsDegree", Types.Int, False, UNIFORM
        )
        degree.Set(0)
        flat = (np.asarray(p.colour, np.float64) - 0.5) / SH_0
        prim.CreateAttribute(
            "radiance:sphericalHarmonicsCoefficients", Types.Float3Array, False
        ).Set(Vt.Vec3fArray.FromNumpy(_f32(flat)))
        for name, value in (("projectionModeHint", "perspective"), ("sortingModeHint", "zDepth")):
            prim.CreateAttribute(name, Types.Token, False, UNIFORM).Set(value)

    def _define_points(self, points: UsdGeom.Points, p: Particles) -> None:
        self._twin_points = points.CreatePointsAttr()
        self._twin_velocities = points.CreateVelocitiesAttr()
        self._twin_extent = points.CreateExtentAttr()
        # balls of the particles' volumes
        widths = np.cbrt(6.0 * np.asarray(p.V0, np.float64) / np.pi) / self._unit
        self._widths = _f32(widths)
        points.CreateWidthsAttr(Vt.FloatArray.FromNumpy(self._widths))
        points.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        points.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.arange(self._count, dtype=np.int64)))
        colour = points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        colour.Set(Vt.Vec3fArray.FromNumpy(_f32(p.colour)))

    def _place(self, prims: tuple[Usd.Prim, ...], start: float) -> list[UsdGeom.XformOp]:
        if self._space is None:
            return []
        if not self._space.animated and np.array_equal(self._space.from_world(start), np.eye(4)):
            return []
        ops = [UsdGeom.Xformable(prim).AddTransformOp() for prim in prims]
        if not self._space.animated:
            for op in ops:
                op.Set(Gf.Matrix4d(self._space.from_world(start)))
        return ops

    def _named(self, what: str) -> str:
        return f"{what} of <{self._path}/Gaussians>"


def _describe(prim: Usd.Prim, asset: Asset, particles: Particles, info: BakeInfo) -> None:
    """GaussianFleshParticlesAPI's rest state, in stage units."""
    prim.ApplyAPI("GaussianFleshParticlesAPI")
    units = asset.facts.units
    density = np.array([m.density for m in info.materials])[np.asarray(particles.material)]
    volume = np.asarray(particles.V0, np.float64)
    indices = np.ascontiguousarray(particles.material, np.int32)
    rest = np.asarray(particles.X, np.float64) / units.length
    scales = np.asarray(particles.scale, np.float64) / units.length
    for name, kind, value in (
        ("restPositions", Types.Point3fArray, Vt.Vec3fArray.FromNumpy(_f32(rest))),
        ("restOrientations", Types.QuatfArray, _quaternions(particles.orientation)),
        ("restScales", Types.Float3Array, Vt.Vec3fArray.FromNumpy(_f32(scales))),
        ("restVolumes", Types.FloatArray, Vt.FloatArray.FromNumpy(_f32(volume / units.volume))),
        ("masses", Types.FloatArray, Vt.FloatArray.FromNumpy(_f32(density * volume / units.mass))),
        ("materialIndices", Types.IntArray, Vt.IntArray.FromNumpy(indices)),
    ):
        prim.CreateAttribute(f"gaussianFlesh:{name}", kind, False, UNIFORM).Set(value)


def _variances(quaternions: Floats, scales: Floats) -> np.ndarray:
    """Diagonal (N, 3) of R diag(s^2) R' for quaternions (w, x, y, z)."""
    w, x, y, z = np.asarray(quaternions, np.float64).T
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.einsum("ikn,nk->ni", rotation**2, scales**2)


def _quaternions(wxyz: Floats) -> Vt.QuatfArray:
    # FromNumpy reads (x, y, z, w)
    return Vt.QuatfArray.FromNumpy(_f32(np.asarray(wxyz)[:, [1, 2, 3, 0]]))


def _box(low: Floats, high: Floats) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(_f32(np.stack([low.min(axis=0), high.max(axis=0)])))


def _f32(values: Floats) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)

"""The particle prims of the cache: a Gaussian splat field and the same particles as points.

The values of both are in the world frame of the source.  If the root prim above them has a
transform, theirs is its inverse, so that they follow the asset when a shot moves it.  Far from the
world's origin, where single precision is coarse, their transform, which is in double precision,
moves their origin near the asset.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import BakeInfo, GaussianPose, MeshPose, SurfacePose
from gf_usd.core.frames.particles import Particles, TetAttachment, TetLattice
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.materials.per_particle import moved_as_flow, spread
from gf_usd.layers.materials import bind, bind_points, write_materials
from gf_usd.layers.space import Space
from gf_usd.layers.stage import Clock, Home, f32, quaternions, show, vectors, visibility
from gf_usd.layers.tracks.flows import FlowTrack, flow_name, flow_shading
from gf_usd.layers.tracks.gaussians import SplatTrack
from gf_usd.layers.tracks.meshes import check
from gf_usd.layers.tracks.points import PointsTrack
from gf_usd.layers.tracks.sparse import Saved
from gf_usd.layers.tracks.tets.attachments import Attachments, not_in_source
from gf_usd.layers.tracks.tets.mesh import TetTrack
from gf_usd.system import usd_schema  # noqa: F401  (registers the schema before its APIs are applied)

Types = Sdf.ValueTypeNames
UNIFORM = Sdf.VariabilityUniform
# Rounding of positions, in spacings, from which on the particles have an origin of their own: far
# below what is seen, and far above what an asset near the origin has.
COARSE = 1e-3
FLOW = "Flow"  # the prim of flowing particles, which is shown together with meshes


class ParticleTrack:
    """Writes the particles of a bake as the selected prims.

    Parameters
    ----------
    cache : stage whose root layer is the cache.
    root : the home's root prim in the source.
    home, asset, particles, info, clock, choices, tets : of the bake.
    shape : (N,) [stage units] tolerance of each shape for rounding; None: no rounding.
    attachments : of points of the tets.
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
        choices: Choices,
        tets: Sequence[TetLattice] = (),
        shape: Floats | None = None,
        attachments: Sequence[TetAttachment] = (),
    ) -> None:
        self._count = len(particles)
        self._unit = asset.facts.units.length
        self.path = home.scope
        self.low = self.high = np.zeros(3)
        self._origin = particle_origin(particles) / self._unit
        UsdGeom.Scope.Define(cache, home.scope)
        both = {"gaussians", "points"} & set(choices.shapes)
        self._rates, self._saved = choices.velocities or not both, Saved()
        self._splats, self._twin = _shape_tracks(
            cache, home.scope, asset, particles, info, choices, shape
        )
        self._grains = particles_shown_with_meshes(particles, info, choices)
        self._body, self._waiting = particles.body_of, {body for _, body in choices.converting}
        self._flow = None
        if self._grains is not None:
            grains = subset(particles, self._grains)
            self._flow = _grain_track(cache, home.scope, grains, self._unit, choices)
        self._flows = _flow_tracks(cache, home.scope, asset, choices, self._origin)
        materials = write_materials(
            cache,
            home.scope.AppendChild("Materials"),
            info.materials,
            info.look,
            asset.facts.units,
        )
        self._tets = _tet_tracks(
            cache, home.scope, asset, particles, info, choices, tets, self._origin, materials
        )
        self._attachments = None
        if new := not_in_source(root.GetStage(), attachments):
            self._attachments = Attachments(
                cache, home.scope.AppendChild("Attachments"), root.GetStage(), new,
                {one.body: (one, self._tets[one.key].path) for one in tets},
                asset, info.settings, clock, self._origin,
            )  # fmt: skip
        prims = [track.prim for track in (self._splats, self._twin) if track]
        for prim in prims:
            _describe(prim, asset, particles, info, self._origin)
            _relate(prim, home.scope, asset, particles, info, choices, materials)
        self.space = Space(root, clock, self._unit) if home.inside else None
        prims += [self._flow.prim] if self._flow else []
        prims += [track.prim for track in (*self._tets.values(), *self._flows.values())]
        if self._waiting:
            for track in (self._flow, *self._flows.values()):
                if track:
                    visibility(track.prim)
        prims += [self._attachments.prim] if self._attachments else []
        self._transforms = self._place(prims, clock.start)

    def write(
        self,
        pose: GaussianPose,
        time_code: float,
        tets: Mapping[str, MeshPose] | None = None,
        flows: Mapping[int, SurfacePose] | None = None,
        converted: Collection[int] = (),
    ) -> None:
        """Author the pose at a time code, that of the tetrahedra by `TetLattice.key`, and the
        surfaces of what flows by body.

        converted : of the bodies that are converted, those that particles replace now.

        Raises BakeError where an array has another length than the particles or is not finite.
        """
        for name in ("positions", "velocities"):
            what = f"{name} of <{self.path}>"
            check(getattr(pose, name), (self._count, 3), what, time_code)
        positions = np.asarray(pose.positions, np.float64) / self._unit - self._origin
        points = Vt.Vec3fArray.FromNumpy(f32(positions))
        velocities = Vt.Vec3fArray.FromNumpy(f32(np.asarray(pose.velocities) / self._unit))
        if not self._rates:
            single = np.asarray(velocities)
            self._saved.count(single, single.nbytes)
        if self._splats:
            self._splats.write(pose, positions, points, velocities, time_code)
        if self._twin:
            self._twin.write(points, velocities, time_code)
        if self._flow:
            waiting = list(self._waiting.difference(converted))
            shown = np.flatnonzero(~np.isin(self._body[self._grains], waiting))
            rows = self._grains[shown]
            some, rates = (
                Vt.Vec3fArray.FromNumpy(np.asarray(one)[rows]) for one in (points, velocities)
            )
            self._flow.write(some, rates, time_code, shown)
            self._show(self._flow.prim, not self._flow.empty, time_code)
        for key, track in self._tets.items():
            track.write((tets or {})[key], time_code)
        if self._attachments:
            self._attachments.write(tets or {}, time_code)
        for body, track in self._flows.items():
            track.write((flows or {})[body], time_code)
            self._show(track.prim, not track.empty, time_code)
        full = [track for track in (self._flow, *self._flows.values()) if track and not track.empty]
        every = [self._splats, self._twin, *self._tets.values(), *full]
        boxes = [(track.low, track.high) for track in every if track]
        if boxes:  # none where particles replace meshes later
            self.low = np.min([low for low, _ in boxes], axis=0)
            self.high = np.max([high for _, high in boxes], axis=0)
        if self.space is not None and self.space.animated:
            matrix = Gf.Matrix4d(self.to_world(time_code) @ self.space.from_world(time_code))
            for transform in self._transforms:
                transform.Set(matrix, time_code)

    def _show(self, prim: Usd.Prim, shown: bool, time_code: float) -> None:
        """Author the visibility of a prim that is empty at the start."""
        if self._waiting:
            show(prim, shown, time_code)

    def state(self) -> dict[str, Any]:
        """The state from which another track of the same bake continues."""
        tets = {key: asdict(track.saved) for key, track in self._tets.items()}
        splats = self._splats.state() if self._splats else {}
        flows = {str(body): track.state() for body, track in self._flows.items()}
        return {"splats": splats, "tets": tets, "saved": asdict(self._saved), "flows": flows}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the state of the track that wrote the existing samples."""
        if self._splats:
            self._splats.restore(state["splats"])
        self._saved = Saved(**state["saved"])
        for key, saved in state["tets"].items():
            self._tets[key].saved = Saved(**saved)
        for body, track in self._flows.items():
            track.restore(state["flows"][str(body)])

    @property
    def saved(self) -> tuple[int, int]:
        """[bytes] saved by half precision and by omitted velocities."""
        others = (*self._tets.values(), *self._flows.values())
        without = self._saved.bytes + sum(track.saved.bytes for track in others)
        return self._splats.saved if self._splats else 0, without

    @property
    def shape_error(self) -> float:
        """[stage units] the largest error of a shape by rounding."""
        return self._splats.shape_error if self._splats else 0.0

    @property
    def rounded(self) -> bool:
        """Whether shapes are in half precision, within the tolerance."""
        return self._splats is not None and self._splats.rounded

    @property
    def groups(self) -> list[tuple[list[Sdf.Path], int | None, Ints | None]]:
        """Prims that move as one: those of the particles, those of some of them with their rows,
        and each TetMesh with its body.

        Those whose number of points changes are not among them.
        """
        ours = [track.prim.GetPath() for track in (self._splats, self._twin) if track]
        found: list[tuple[list[Sdf.Path], int | None, Ints | None]] = []
        if ours:
            found.append((ours, None, None))
        if self._flow and not self._waiting:
            found.append(([self._flow.prim.GetPath()], None, self._grains))
        return [*found, *(([track.path], track.body, None) for track in self._tets.values())]

    @property
    def notes(self) -> tuple[str, ...]:
        """Text on the rounded arrays."""
        return self._splats.notes if self._splats else ()

    def to_world(self, time_code: float) -> Floats:
        """(4, 4) from where ``low`` and ``high`` are to the world, whatever the time."""
        del time_code
        matrix = np.eye(4)
        matrix[3, :3] = self._origin
        return matrix

    def _place(self, prims: Sequence[Usd.Prim], start: float) -> list[UsdGeom.XformOp]:
        animated = self.space is not None and self.space.animated
        matrix = self.to_world(start)
        if self.space is not None:
            matrix = matrix @ self.space.from_world(start)
        if not animated and np.array_equal(matrix, np.eye(4)):
            return []
        ops = [UsdGeom.Xformable(prim).AddTransformOp() for prim in prims]
        if not animated:
            for op in ops:
                op.Set(Gf.Matrix4d(matrix))
        return ops


def particles_shown_with_meshes(
    particles: Particles, info: BakeInfo, choices: Choices
) -> Ints | None:
    """(k,) the particles displayed together with meshes; None: there are none, or their surface is
    displayed.
    """
    if choices.flows or not (choices.mesh and choices.replaced):
        return None
    return np.flatnonzero(moved_as_flow(particles, info.materials))


def subset(particles: Particles, rows: Ints) -> Particles:
    """A subset of the particles, for a `PointsTrack`."""
    return replace(
        particles,
        **{name: np.asarray(getattr(particles, name))[rows] for name in ("X", "V0", "color")},
    )


def particle_origin(particles: Particles) -> Floats:
    """(3,) [m] origin of positions: 0, or the body's center where that is too far from 0."""
    X = np.asarray(particles.X, np.float64)
    rounding = np.finfo(np.float32).eps * np.abs(X).max(initial=0.0)
    return X.mean(axis=0) if rounding > COARSE * particles.spacing else np.zeros(3)


def _shape_tracks(
    cache: Usd.Stage, scope: Sdf.Path, asset: Asset, particles: Particles, info: BakeInfo,
    choices: Choices, shape: Floats | None,
) -> tuple[SplatTrack | None, PointsTrack | None]:  # fmt: skip
    """The particles as Gaussians and as points, of which `choices` are written."""
    splats, points, units = None, None, asset.facts.units
    if "gaussians" in choices.shapes:
        splats = SplatTrack(
            cache, scope.AppendChild("Gaussians"), particles, info.settings, units, choices.half,
            [material.law for material in info.materials],
            shape=shape, velocities=choices.velocities,
        )  # fmt: skip
    if "points" in choices.shapes:
        points = PointsTrack(
            cache, scope.AppendChild("Points"), particles, units.length,
            velocities=choices.velocities,
        )  # fmt: skip
    return splats, points


def _grain_track(
    cache: Usd.Stage, scope: Sdf.Path, grains: Particles, unit: float, choices: Choices
) -> PointsTrack:
    """Flowing particles, which replace meshes; unit : [m]."""
    track = PointsTrack(
        cache, scope.AppendChild(FLOW), grains, unit,
        velocities=choices.velocities, some=bool(choices.converting),
    )  # fmt: skip
    replaced = _inside(scope, map(Sdf.Path, choices.replaced))
    track.prim.CreateRelationship("gaussianFlesh:sourceMeshes", False).SetTargets(replaced)
    return track


def _flow_tracks(
    cache: Usd.Stage, scope: Sdf.Path, asset: Asset, choices: Choices, origin: Floats
) -> dict[int, FlowTrack]:
    """The surfaces of flowing bodies; origin : (3,) [stage units]."""
    return {
        body: FlowTrack(
            cache, scope.AppendChild(flow_name(body)), asset.facts.units.length, origin,
            shading=flow_shading(asset, choices.replaced, scope.GetPrefixes()[0]),
            velocities=choices.velocities,
        )
        for body in choices.flows
    }  # fmt: skip


def _tet_tracks(
    cache: Usd.Stage, scope: Sdf.Path, asset: Asset, particles: Particles, info: BakeInfo,
    choices: Choices, tets: Sequence[TetLattice], origin: Floats, materials: Sequence[Sdf.Path],
) -> dict[str, TetTrack]:  # fmt: skip
    """The tetrahedra, by `TetLattice.key`."""
    return {
        one.key: TetTrack(
            cache, scope.AppendChild(f"Tets{one.body}" if one.body else "Tets"), one,
            particles, info, asset.facts.units, origin, materials,
            still=not choices.clip_frames, velocities=choices.velocities,
        )
        for one in tets
    }  # fmt: skip


def _inside(scope: Sdf.Path, paths: Iterable[Sdf.Path]) -> list[Sdf.Path]:
    """Those below the root prim of a scope: a payload may not point outside of it."""
    root = scope.GetPrefixes()[0]
    return [path for path in paths if path.HasPrefix(root)]


def _relate(
    prim: Usd.Prim, scope: Sdf.Path, asset: Asset, particles: Particles, info: BakeInfo,
    choices: Choices, materials: Sequence[Sdf.Path],
) -> None:  # fmt: skip
    """Relate particles to their materials and meshes; the root layer adds those that are not in the
    same payload.
    """
    prim.CreateRelationship("gaussianFlesh:materials", False).SetTargets(materials)
    meshes = _inside(scope, (Sdf.Path(s.path) for s in asset.surfaces))
    prim.CreateRelationship("gaussianFlesh:sourceMeshes", False).SetTargets(meshes)
    if len(materials) == 1:
        bind(prim, materials[0])
    elif prim.IsA(UsdGeom.Points):
        first = info.settings.time_code(info.settings.first)
        when = first if choices.clip_frames else None
        bind_points(prim, materials, particles.material, when)


def _describe(
    prim: Usd.Prim, asset: Asset, particles: Particles, info: BakeInfo, origin: Floats
) -> None:
    """GaussianFleshParticlesAPI's rest state, in stage units."""
    prim.ApplyAPI("GaussianFleshParticlesAPI")
    units = asset.facts.units
    values = spread(particles, info.materials)
    density = values["density"]
    volume = np.asarray(particles.V0, np.float64)
    indices = np.ascontiguousarray(particles.material, np.int32)
    rest = np.asarray(particles.X, np.float64) / units.length - origin
    scales = np.asarray(particles.scale, np.float64) / units.length
    for name, kind, value in (
        ("restPositions", Types.Point3fArray, vectors(rest)),
        ("restOrientations", Types.QuatfArray, quaternions(particles.orientation)),
        ("restScales", Types.Float3Array, vectors(scales)),
        ("restVolumes", Types.FloatArray, Vt.FloatArray.FromNumpy(f32(volume / units.volume))),
        ("masses", Types.FloatArray, Vt.FloatArray.FromNumpy(f32(density * volume / units.mass))),
        ("materialIndices", Types.IntArray, Vt.IntArray.FromNumpy(indices)),
    ):
        prim.CreateAttribute(f"gaussianFlesh:{name}", kind, False, UNIFORM).Set(value)
    if particles.own is None:
        return
    for name, value in (
        ("youngsModulus", values["youngs_modulus"] / units.pressure),
        ("poissonsRatio", values["poissons_ratio"]),
        ("densities", density / units.density),
        *(
            (p.attribute, values[p.name] / units.factor(p.unit))
            for p in law_parameters(m.law for m in info.materials)
        ),
    ):
        made = prim.CreateAttribute(f"gaussianFlesh:{name}", Types.FloatArray, False, UNIFORM)
        made.Set(Vt.FloatArray.FromNumpy(f32(value)))

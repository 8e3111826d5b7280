"""Poses of meshes and Gaussians for every written frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Surface
from gf_usd.core.frames.frame import (
    STRETCH,
    BakedFrame,
    Frame,
    GaussianPose,
    Health,
    MeshPose,
    Pose,
    SurfacePose,
)
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import BlendShapes
from gf_usd.pipeline.checkpoint import Checkpoint
from gf_usd.pipeline.frames.captured import SplatDeformer
from gf_usd.pipeline.frames.flows import FlowSurfaces
from gf_usd.pipeline.frames.period import Period
from gf_usd.pipeline.measures.inside import Inside, InsideMeasure
from gf_usd.pipeline.measures.outside import OutsideMeasure
from gf_usd.prepare.bodies.coarse import coarse_meshes, mesh_names

if TYPE_CHECKING:
    from gf_usd.geometry.flesh.sheets import Sheet
    from gf_usd.geometry.skinning import MeshSkin
    from gf_usd.physics.frame_loop import Solver
    from gf_usd.physics.output.gaussians import GaussianTrack
    from gf_usd.pipeline.measures.observe import Observer

IMPLAUSIBLE = 2.0  # volume ratio of a particle: the volumes of bodies are measured above it


class FrameBuilder:
    """Makes the samples of one variant, poses of meshes and Gaussians, from its solver's frames.

    track : the axes of the particles.
    skin : of the meshes; None: the solver embeds them itself.
    surfaces : that are written.
    settings : as `sampled`.
    splats : the captured Gaussians.
    tets : keys of the tetrahedra among the embedded points.
    observer : receives every frame.
    flows : the surfaces of flowing bodies; None: none are written.
    bodies : prim paths of each body.
    sheets, shapes : of characters, by prim path: see `Sheet` and `with_shapes`.
    waiting : meshes that are replaced by particles once a particle of their body is converted.
    open_end : the motion may end before its last frame: see `at_end`.
    """

    def __init__(
        self,
        solver: Solver,
        track: GaussianTrack,
        skin: MeshSkin | None,
        surfaces: Sequence[Surface],
        settings: Settings,
        splats: SplatDeformer,
        tets: Sequence[str] = (),
        observer: Observer | None = None,
        flows: FlowSurfaces | None = None,
        waiting: Mapping[str, int] | None = None,
        *,
        bodies: Sequence[Sequence[str]] = (),
        sheets: Mapping[str, Sheet] | None = None,
        shapes: Mapping[str, BlendShapes] | None = None,
        open_end: bool = False,
    ) -> None:
        self._bodies, self._sheets, self._shapes = bodies, sheets or {}, shapes or {}
        self._tets, self._observer, self._flows = tets, observer, flows
        waiting = waiting or {}
        self._waiting = frozenset(waiting.values())
        self.solver, self._track, self._skin = solver, track, skin
        self._surfaces, self._settings, self._splats = surfaces, settings, splats
        meshes = [
            one
            for one in surfaces
            if one.splats is None and len(one.triangles) and one.path not in waiting
        ]
        self._inside, self._outside, self._coarse = None, None, ""
        self.coarse: tuple[str, ...] = ()  # prim paths of meshes with long faces
        if meshes:
            spacing = solver.particles.spacing
            self._inside = InsideMeasure(meshes, spacing, settings.frames, open_end=open_end)
            if found := coarse_meshes(meshes, spacing):
                self.coarse, self._coarse = tuple(found), mesh_names(found, spacing)
                self._outside = OutsideMeasure(meshes, solver.particles.X, spacing)
        self._poses: Mapping[str, Pose] = {}  # pose of the last sample
        self._x = solver.particles.X  # [m] then

    def state(self) -> dict[str, Any]:
        """The state from which the next sample is made: `solver` and `track` of a `Checkpoint`."""
        track = {**self._track.state(), **self._splats.state()}
        return {"solver": self.solver.save(), "track": track}

    def samples(
        self, since: Checkpoint | None = None, period: Period | None = None
    ) -> Iterator[BakedFrame]:
        """The samples, in playback order. Raises SolverError where the simulation fails.

        since : the checkpoint to continue from; None: from the start.
        period : of a repeated cycle, which may skip samples.
        """
        if since is None:
            frames = self.solver.frames()
        else:
            self.solver.load(since.solver)
            self._track.load(since.track)
            self._splats.load(since.track)
            frames = self.solver.frames_after(since.index, since.last)
        goes_on = True
        while goes_on:
            goes_on = False
            for frame in frames:
                after = period.observe(frame.index, frame.particles.x) if period else frame.index
                yield self.sample(frame)
                if after != frame.index:
                    frames = self.solver.frames_after(after, frame.health)
                    goes_on = True
                    break

    def sample(self, frame: Frame) -> BakedFrame:
        """Convert a frame of the solver, the one after the previous call's, to a sample."""
        from gf_usd.physics.grid.embedding import deform_normals

        s = self._settings
        gaussians = self._track.advance(frame.particles)
        poses = self._of_characters(frame.embedded, frame.index)
        if self._observer:
            self._observer.add_frame(frame, poses)
        if self._skin:
            skinned = self._skin.poses(frame.particles, self._track.turn)
            poses = self._of_characters(skinned, frame.index)
        meshes = {}
        splats = self._splats.poses(poses, s.time_code(frame.index))
        for surface in self._surfaces:
            if surface.splats is not None:
                continue
            pose = poses[surface.path]
            normals = None
            if surface.normals is not None and surface.normal_points is not None:
                normals = deform_normals(surface.normals, surface.normal_points, pose.F)
            meshes[surface.path] = MeshPose(
                points=pose.x, velocities=pose.v * s.time_scale, normals=normals
            )
        self._poses, self._x = poses, frame.particles.x
        health = self._with_stretched(self._with_expanded(frame), frame)
        converted = self._converted(frame)
        if self._inside and self._inside.is_measured(frame.index):
            health = self._with_measures(health, self._inside.measure(frame.index, poses))
        return BakedFrame(
            index=frame.index,
            time_code=s.time_code(frame.index),
            meshes=meshes,
            gaussians=replace(
                gaussians,
                velocities=gaussians.velocities * s.time_scale,
                F=frame.particles.F if s.deformation_gradients else None,
                stress=frame.stress,
                internal=frame.internal,
            ),
            health=health,
            splats=splats if self._surfaces else {},
            flows=self._flows.poses(frame.particles, self._waiting - converted)
            if self._flows
            else {},
            converted=converted,
            tets={
                key: MeshPose(points=poses[key].x, velocities=poses[key].v * s.time_scale)
                for key in self._tets
            },
        )

    def _of_characters(self, poses: Mapping[str, Pose], index: int) -> Mapping[str, Pose]:
        """The poses of embedded points at a frame, with those of sheets and with blend shapes."""
        from gf_usd.geometry.flesh.shapes import with_shapes

        out, time = dict(poses), self._settings.frame_time
        for path in self._sheets.keys() & out.keys():
            out[path] = self._sheets[path].pose(out[path], index, time)
        for path in self._shapes.keys() & out.keys():
            out[path] = with_shapes(out[path], self._shapes[path], index, time)
        return out

    def _converted(self, frame: Frame) -> frozenset[int]:
        """Bodies of `waiting` that flow in a frame."""
        if frame.converted is None:
            return frozenset()
        body = self.solver.particles.body_of
        return self._waiting & {int(k) for k in np.unique(body[frame.converted])}

    def at_end(self, sample: BakedFrame) -> BakedFrame:
        """The last sample, with its measures taken as thoroughly as in a last frame."""
        if self._inside is None:
            return sample
        found = self._inside.measure(sample.index, self._poses, ends=True)
        return replace(sample, health=self._with_measures(sample.health, found))

    def _with_expanded(self, frame: Frame) -> Health:
        """The health of a frame, with the body that expanded most where particles have an
        implausible volume.
        """
        health = frame.health
        if health.max_J <= IMPLAUSIBLE or not self._bodies:
            return health
        volume = mean_of_bodies(np.linalg.det(frame.particles.F), self.solver.particles)
        most = int(volume.argmax())
        return replace(health, expanded=float(volume[most]), expanded_body=self._bodies[most][0])

    def _with_stretched(self, health: Health, frame: Frame) -> Health:
        """The health of a frame, with the body of whose volume the largest share is stretched more
        than STRETCH times.
        """
        if health.max_stretch <= STRETCH or not self._bodies:
            return health
        F = frame.particles.F
        squared = np.linalg.eigvalsh(np.swapaxes(F, 1, 2) @ F)[:, -1]  # of the largest stretch
        share = mean_of_bodies(squared > STRETCH**2, self.solver.particles)
        most = int(share.argmax())
        return replace(health, stretched=float(share[most]), stretched_body=self._bodies[most][0])

    def _with_measures(self, health: Health, found: Inside) -> Health:
        """Add the measured share inside a body and, for the last sample, the share outside the
        mesh.
        """
        health = replace(health, inside_share=found.share, inside_depth=found.depth)
        if self._outside is None:
            return health
        outside = self._outside.measure(self._poses, self._x)
        return replace(
            health, outside_share=outside.share, outside_depth=outside.depth,
            outside_mesh=self._coarse,
        )  # fmt: skip


def mean_of_bodies(values: Floats, particles: Particles) -> Floats:
    """(B,) mean over the rest volume of each body of values (N,); 0 of one without particles."""
    body, V0 = particles.body_of, np.asarray(particles.V0, float)
    whole = np.bincount(body, V0)
    return np.divide(
        np.bincount(body, V0 * values), whole, out=np.zeros(len(whole)), where=whole > 0.0
    )


def with_lead_frames(samples: Iterable[BakedFrame], settings: Settings) -> Iterator[BakedFrame]:
    """The samples, preceded by copies of the first pose for the frames before the start.

    settings : as `sampled`.
    """
    for sample in samples:
        if sample.index == 0:
            for index in range(settings.first, 0):
                yield _standing(sample, index, settings.time_code(index))
        yield sample


def _standing(first: BakedFrame, index: int, time_code: float) -> BakedFrame:
    def stop(pose: MeshPose | GaussianPose | SurfacePose) -> Any:
        return replace(pose, velocities=np.zeros_like(pose.velocities))

    nothing = (0.0, 0.0, 0.0)
    return replace(
        first,
        index=index,
        time_code=time_code,
        meshes={path: stop(pose) for path, pose in first.meshes.items()},
        tets={key: stop(pose) for key, pose in first.tets.items()},
        flows={body: stop(pose) for body, pose in first.flows.items()},
        gaussians=stop(first.gaussians),
        health=replace(first.health, kinetic=0.0, momentum=nothing, angular_momentum=nothing),
    )

"""From a solver's frames to the samples that are written: poses of meshes and Gaussians."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import SplatPose, Splats, StageFacts, Surface, joined
from gf_usd.core.frames import (
    BakedFrame,
    Frame,
    GaussianPose,
    MeshPose,
    Particles,
    Pose,
    Settings,
)
from gf_usd.core.radiance import Y_0, linear_to_srgb
from gf_usd.pipeline.checkpoint import Checkpoint
from gf_usd.pipeline.health.warnings import NOT_PERIODIC
from gf_usd.pipeline.measures.inside import InsideMeasure
from gf_usd.prepare.outputs import SplatSequence

if TYPE_CHECKING:
    from gf_usd.geometry.skinning import MeshSkin
    from gf_usd.layers.space import Space
    from gf_usd.physics.frame_loop import Solver
    from gf_usd.physics.gaussians import CarriedSplats, GaussianTrack
    from gf_usd.pipeline.measures.observe import Observer


class FrameBuilder:
    """The samples of one variant: poses of meshes and Gaussians, from the frames of its solver.

    track : of the particles' axes.
    skin : of the meshes; None: the solver carries them itself.
    surfaces : that are written.
    settings : as `sampled`.
    splats : the captured Gaussians.
    tets : keys of the tetrahedra among the embedded points.
    observer : is shown every frame.
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
    ) -> None:
        self._tets, self._observer = tets, observer
        self.solver, self._track, self._skin = solver, track, skin
        self._surfaces, self._settings, self._splats = surfaces, settings, splats
        meshes = [one for one in surfaces if one.splats is None and len(one.triangles)]
        self._inside = None
        if meshes:
            self._inside = InsideMeasure(meshes, solver.particles.spacing, settings.frames)

    def state(self) -> dict[str, Any]:
        """What the next sample starts from: `solver` and `track` of a `Checkpoint`."""
        track = {**self._track.state(), **self._splats.state()}
        return {"solver": self.solver.save(), "track": track}

    def samples(
        self, since: Checkpoint | None = None, period: Period | None = None
    ) -> Iterator[BakedFrame]:
        """The samples, in playback time.  Raises SolverError where the simulation fails.

        since : what to go on after; None: from the start.  period : of a cycle that is repeated,
        which may leave samples out.
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
                after = period.see(frame.index, frame.particles.x) if period else frame.index
                yield self.sample(frame)
                if after != frame.index:
                    frames = self.solver.frames_after(after, frame.health)
                    goes_on = True
                    break

    def sample(self, frame: Frame) -> BakedFrame:
        """The sample that a frame of the solver makes, which follows on the one before it."""
        from gf_usd.physics.grid.embedding import deform_normals

        s = self._settings
        gaussians = self._track.advance(frame.particles)
        poses = frame.embedded
        if self._observer:
            self._observer.see(frame, poses)
        if self._skin:
            poses = self._skin.poses(frame.particles, self._track.turn)
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
        health = frame.health
        if self._inside and self._inside.asked(frame.index):
            found = self._inside.measure(frame.index, poses)
            health = replace(health, inside_share=found.share, inside_depth=found.depth)
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
            tets={
                key: MeshPose(points=poses[key].x, velocities=poses[key].v * s.time_scale)
                for key in self._tets
            },
        )


# From the world to axes whose Y is up, for column vectors, by the world's up axis.
UPRIGHT = {"Y": np.eye(3), "Z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])}
OWN, WORLD, STOOD = "own", "world", "stood"  # spaces of exported files; STOOD: world with Y up
SAYS_UP = "spz"  # the files that say that Y is up

TINY = 1e-12  # [stage units] a flattened particle still has a logarithm of its scale


class SplatDeformer:
    """The captured Gaussians of an asset through the motion, and the splat files of a variant.

    splats : what is deformed, by prim path.
    source : the USD file of their prims.
    files : of the variant; without captured Gaussians they hold the particles.
    """

    def __init__(
        self,
        splats: Mapping[str, Splats],
        source: Path,
        settings: Settings,
        facts: StageFacts,
        particles: Particles,
        files: Sequence[SplatSequence] = (),
    ) -> None:
        self._files, self._particles = files, particles
        self._unit = facts.units.length
        self._tracks: dict[str, CarriedSplats] = {}
        self._spaces: dict[str, Space] = {}
        self._turns = {WORLD: np.eye(3), STOOD: UPRIGHT[facts.up_axis]}
        # The same Gaussians in spaces of files that are not their prims'.
        self._elsewhere: dict[str, dict[str, CarriedSplats]] = {}
        self._embedded: Mapping[str, Pose] = {}
        self._now: dict[str, SplatPose] = {}
        self._there: dict[str, dict[str, SplatPose]] = {}
        if not splats:
            return
        from gf_usd.layers.space import Space
        from gf_usd.layers.stage import clock, open_source
        from gf_usd.physics.gaussians import CarriedSplats

        self._source = open_source(source)  # the spaces read its transforms frame by frame
        time = clock(self._source, settings)
        for path, one in splats.items():
            prim = self._source.GetPrimAtPath(path)
            self._tracks[path] = CarriedSplats(one)
            self._spaces[path] = Space(prim, time, self._unit)
        for kind in sorted({self._space_of(one) for one in self._files} - {OWN}):
            self._elsewhere[kind] = {path: CarriedSplats(one) for path, one in splats.items()}

    def load(self, state: Mapping[str, Floats]) -> None:
        """Go on from `state`, which may hold more."""
        for name, track in self._named():
            track.load({k[len(name) :]: v for k, v in state.items() if k.startswith(name)})

    def state(self) -> dict[str, Floats]:
        """What the next frame starts from, for `Checkpoint.track`."""
        rows = self._named()
        return {f"{name}{key}": v for name, one in rows for key, v in one.state().items()}

    def _named(self) -> list[tuple[str, CarriedSplats]]:
        own = [(f"carried{k}_", one) for k, one in enumerate(self._tracks.values())]
        return own + [
            (f"{kind}{k}_", one)
            for kind, tracks in self._elsewhere.items()
            for k, one in enumerate(tracks.values())
        ]

    def poses(self, embedded: Mapping[str, Pose], time_code: float) -> dict[str, SplatPose]:
        """The Gaussians at one sample, by prim path, from the poses of the embedded points."""
        self._embedded = embedded
        for path, track in self._tracks.items():
            to_local = self._spaces[path].from_world(time_code)[:3, :3].T / self._unit
            self._now[path] = track.advance(embedded[path], np.asarray(to_local))
        for kind, tracks in self._elsewhere.items():
            to_there = self._turns[kind] / self._unit
            self._there[kind] = {p: one.advance(embedded[p], to_there) for p, one in tracks.items()}
        return dict(self._now)

    def held(self, frame: BakedFrame) -> BakedFrame:
        """A frame before the start: the pose asked for last, in the prims' spaces at its time."""
        return replace(frame, splats=self.poses(self._embedded, frame.time_code))

    def export(self, frame: BakedFrame, number: int) -> None:
        """Write the files of a frame, the one that `poses` was asked for last.

        number : of the frame, 0 for the first that is written.

        One set of captured Gaussians stays in the space of its prim, which is that of the file
        where it came from one.  Several stand in the world, in stage units; so do the particles of
        an asset that has none.  SPZ says that Y is up: there all stand in the world, with Y up.
        """
        made: dict[str, Splats] = {}
        for sequence in self._files:
            kind = self._space_of(sequence)
            if kind not in made:
                made[kind] = self._in(kind, frame)
            sequence.write(made[kind], number)

    def _space_of(self, sequence: SplatSequence) -> str:
        """OWN, WORLD or STOOD."""
        single = len(self._spaces) == 1
        if sequence.suffix != SAYS_UP:
            return OWN if single else WORLD
        if single:
            ((_, space),) = self._spaces.items()
            stood = np.eye(4)
            stood[:3, :3] = self._turns[STOOD].T
            if not space.animated and np.allclose(space.from_world(0.0), stood, rtol=0, atol=1e-12):
                return OWN
        return STOOD

    def _in(self, kind: str, frame: BakedFrame) -> Splats:
        """What was asked for last, in one of the spaces of files."""
        if kind == OWN:
            ((path, pose),) = self._now.items()
            at = self._spaces[path].points(pose.positions, frame.time_code)
            return posed(self._tracks[path].splats, pose, at)
        turn = self._turns[kind]
        if not self._tracks:
            return self._particles_in(frame, turn)
        sets = []
        for path, pose in self._there[kind].items():
            at = np.asarray(pose.positions) / self._unit @ turn.T
            sets.append(posed(self._elsewhere[kind][path].splats, pose, at))
        return joined(sets)

    def _particles_in(self, frame: BakedFrame, turn: Floats) -> Splats:
        p = self._particles
        quaternions = np.asarray(frame.gaussians.orientations, float)
        from scipy.spatial.transform import Rotation  # see `nearby`

        turned = Rotation.from_matrix(turn) * Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
        return Splats(
            positions=np.asarray(frame.gaussians.positions) / self._unit @ turn.T,
            orientations=turned.as_quat()[:, [3, 0, 1, 2]],
            scales=np.maximum(np.asarray(frame.gaussians.scales) / self._unit, TINY),
            opacities=p.opacity,
            harmonics=((linear_to_srgb(p.color) - 0.5) / Y_0)[:, None, :],
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What was clamped, in words."""
        from gf_usd.physics.gaussians import STRETCH

        return tuple(
            f"{path}: {track.clamped} times a Gaussian would have been stretched or flattened more"
            f" than {STRETCH:g} times beyond its own axes, and was kept there"
            for path, track in self._tracks.items()
            if track.clamped
        )


def posed(rest: Splats, pose: SplatPose, at: np.ndarray) -> Splats:
    """Gaussians at a pose; at (N, 3) are its positions in the space of its orientations."""
    return replace(
        rest,
        positions=at,
        orientations=pose.orientations,
        scales=pose.scales,
        harmonics=rest.harmonics if pose.harmonics is None else pose.harmonics,
    )


def with_held(samples: Iterable[BakedFrame], settings: Settings) -> Iterator[BakedFrame]:
    """The samples, with those before the start that are written: the first pose, standing still.

    settings : as `sampled`.
    """
    for sample in samples:
        if sample.index == 0:
            for index in range(settings.first, 0):
                yield _standing(sample, index, settings.time_code(index))
        yield sample


def _standing(first: BakedFrame, index: int, time_code: float) -> BakedFrame:
    def stop(pose: MeshPose | GaussianPose) -> MeshPose | GaussianPose:
        return replace(pose, velocities=np.zeros_like(pose.velocities))

    nothing = (0.0, 0.0, 0.0)
    return replace(
        first,
        index=index,
        time_code=time_code,
        meshes={path: stop(pose) for path, pose in first.meshes.items()},
        tets={key: stop(pose) for key, pose in first.tets.items()},
        gaussians=stop(first.gaussians),
        health=replace(first.health, kinetic=0.0, momentum=nothing, angular_momentum=nothing),
    )


PERIODIC = 0.002  # of the radius: --loop auto ends; under a pixel of a body 500 pixels wide
PHASES = 16  # samples of a cycle that are compared with those of the cycle before


class Period:
    """How far a repeated cycle is from being periodic, and when it need not be repeated again.

    The difference of two cycles is the largest way of a point from where it was a period before,
    over up to `PHASES` samples spread over the cycle.

    cycle : samples of a period, 0: nothing is repeated; repeats : times, at most; first : index of
    the first sample that is written; radius : [m].  until : repeat only until two cycles differ by
    `PERIODIC` of the radius at most.
    """

    def __init__(
        self, cycle: int, repeats: int, first: int, radius: float, *, until: bool = False
    ) -> None:
        self._cycle, self._first, self._radius = cycle, first, radius
        self._until = until
        self._begin = first - cycle * repeats  # where the first cycle begins
        self._phases = np.unique(np.linspace(0, max(cycle - 1, 0), PHASES).astype(int)).tolist()
        self._poses: dict[int, Floats] = {}  # by phase
        self._now = 0.0  # [m] of the cycle so far
        self.difference: float | None = None  # [m] of the last whole cycle
        self.skipped = 0  # samples that were not simulated, as the cycle was periodic before

    def see(self, index: int, x: Floats) -> int:
        """Take notice of positions x (n, 3) [m] at a sample.

        Returns the index of the sample from which the simulation goes on: this one, or the last
        before those that are written, at which everything is as it is now.
        """
        since = index - self._begin
        if not self._cycle or since < 0:
            return index
        phase = since % self._cycle
        if phase == 0 and index <= self._first:
            self._now = 0.0
        if phase in self._phases:
            if (before := self._poses.get(phase)) is not None:
                self._now = max(self._now, float(np.linalg.norm(x - before, axis=1).max()))
            self._poses[phase] = np.array(x)
        last = phase == self._cycle - 1
        if since >= self._cycle and (last or index > self._first):
            self.difference = self._now
        if self._until and last and index < self._first and self.share <= PERIODIC:
            self.skipped = self._first - 1 - index
            self._until = False
            return self._first - 1
        return index

    def state(self) -> dict[str, Floats]:
        """What `load` goes on from."""
        if not self._cycle:
            return {}
        difference = np.nan if self.difference is None else self.difference
        numbers = np.array([self._now, difference, self.skipped])
        return {"period": numbers} | {f"period{k}": x for k, x in self._poses.items()}

    def load(self, state: Mapping[str, Floats]) -> None:
        """Go on from `state`, which may hold more."""
        if not self._cycle:
            return
        now, difference, skipped = state["period"].tolist()
        self._now, self.skipped = now, int(skipped)
        self._until = self._until and not self.skipped
        self.difference = None if np.isnan(difference) else difference
        self._poses = {k: state[f"period{k}"] for k in self._phases if f"period{k}" in state}

    @property
    def share(self) -> float:
        """The difference over the radius; inf where there is none yet."""
        return np.inf if self.difference is None else self.difference / self._radius

    @property
    def cycles(self) -> int:
        """Cycles that are simulated, with the one that is written."""
        return (self._first - self._begin - self.skipped) // self._cycle + 1

    @property
    def health(self) -> dict[str, float | int]:
        """What the report says of it; nothing where nothing was repeated."""
        if not self._cycle or self.difference is None:
            return {}
        return {
            "loop_cycles": self.cycles,
            "loop_difference_m": self.difference,
            "loop_difference_share": self.share,
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """What is said of it."""
        if not self._cycle or self.difference is None:
            return ()
        each = f"{self.difference:.2g} m, {100.0 * self.share:.2g} % of the radius"
        if self._until and self.share > PERIODIC:
            return (
                f"the cycle that is written is the last of {self.cycles}, the most that --loop auto"
                f" simulates, and still differs from the one before by {each}; up to"
                f" {100.0 * PERIODIC:g} % counts as periodic",
            )
        more = "; a larger --loop brings it closer" if self.share > NOT_PERIODIC else ""
        return (
            f"the cycle that is written, number {self.cycles}, differs from the one before by"
            f" {each}{more}",
        )

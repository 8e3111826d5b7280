"""Captured Gaussians that move with a body: in the stage and as splat files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import SplatPose, Splats, StageFacts, joined
from gf_usd.core.errors import counted
from gf_usd.core.frames.frame import BakedFrame, Pose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.radiance import Y_0, linear_to_srgb
from gf_usd.prepare.outputs.outputs import SplatSequence

if TYPE_CHECKING:
    from gf_usd.layers.space import Space
    from gf_usd.physics.output.gaussians import CarriedSplats


# From the world to axes whose Y is up, for column vectors, by the world's up axis.
UPRIGHT = {"Y": np.eye(3), "Z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])}

OWN, WORLD, WORLD_Y_UP = (
    "own",
    "world",
    "stood",
)  # spaces of exported files; WORLD_Y_UP: world with Y up

SAYS_UP = "spz"  # formats that are defined with Y up

TINY = 1e-12  # [stage units] lower limit, because splat files store the logarithm of scales


class SplatDeformer:
    """Deforms the captured Gaussians of an asset and writes the splat files of a variant.

    splats : by prim path.
    source : the USD file of their prims.
    files : splat sequences of the variant; without captured Gaussians they contain the particles.
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
        self._turns = {WORLD: np.eye(3), WORLD_Y_UP: UPRIGHT[facts.up_axis]}
        # the Gaussians in the spaces of files that differ from their prims'
        self._elsewhere: dict[str, dict[str, CarriedSplats]] = {}
        self._embedded: Mapping[str, Pose] = {}
        self._now: dict[str, SplatPose] = {}
        self._there: dict[str, dict[str, SplatPose]] = {}
        if not splats:
            return
        from gf_usd.layers.space import Space
        from gf_usd.layers.stage import clock, open_source
        from gf_usd.physics.output.gaussians import CarriedSplats

        self._source = open_source(source)  # the spaces read its transforms frame by frame
        time = clock(self._source, settings)
        for path, one in splats.items():
            prim = self._source.GetPrimAtPath(path)
            self._tracks[path] = CarriedSplats(one)
            self._spaces[path] = Space(prim, time, self._unit)
        for kind in sorted({self._space_of(one) for one in self._files} - {OWN}):
            self._elsewhere[kind] = {path: CarriedSplats(one) for path, one in splats.items()}

    def load(self, state: Mapping[str, Floats]) -> None:
        """Restore `state`; other keys are ignored."""
        for name, track in self._named():
            track.load({k[len(name) :]: v for k, v in state.items() if k.startswith(name)})

    def state(self) -> dict[str, Floats]:
        """The state from which the next frame is made, for `Checkpoint.track`."""
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
        """A frame before the start: the last result of `poses`, in the prims' spaces at the time of
        that frame.
        """
        return replace(frame, splats=self.poses(self._embedded, frame.time_code))

    def export(self, frame: BakedFrame, number: int) -> None:
        """Write the splat files of a frame, from the last result of `poses`.

        number : of the frame, 0 for the first that is written.

        A single set of captured Gaussians stays in the space of its prim, which is the space of its
        source file. Several sets are written in world space, in stage units; so are the particles
        of an asset without captured Gaussians. SPZ is defined with Y up, so its files are in world
        space with Y up.
        """
        made: dict[str, Splats] = {}
        for sequence in self._files:
            kind = self._space_of(sequence)
            if kind not in made:
                made[kind] = self._in(kind, frame)
            sequence.write(made[kind], number)

    def _space_of(self, sequence: SplatSequence) -> str:
        """The space of a sequence: OWN, WORLD or WORLD_Y_UP."""
        single = len(self._spaces) == 1
        if sequence.suffix != SAYS_UP:
            return OWN if single else WORLD
        if single:
            ((_, space),) = self._spaces.items()
            stood = np.eye(4)
            stood[:3, :3] = self._turns[WORLD_Y_UP].T
            if not space.animated and np.allclose(space.from_world(0.0), stood, rtol=0, atol=1e-12):
                return OWN
        return WORLD_Y_UP

    def _in(self, kind: str, frame: BakedFrame) -> Splats:
        """The last result of `poses`, in a space of splat files."""
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
        from scipy.spatial.transform import Rotation  # takes long to import: see `core.neighbors`

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
        """Notes on clamped values."""
        from gf_usd.physics.output.gaussians import STRETCH

        return tuple(
            f"<{path}>: Gaussians were clamped {counted(track.clamped, 'time')}, because they would"
            f" have been stretched or flattened more than {STRETCH:g} times relative to their own"
            " axes"
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

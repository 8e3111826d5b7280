"""The motion of the bodies of a bake: the points of meshes that are near each other, in all frames.

Gaussians can be points of a body too; they follow the same joints or shapes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.scene import MotionFrame, Recording
from gf_usd.delivery.joints import kabsch

RIGID = 1e-4  # of the size of a mesh: it moves as a rigid body within this
FLAT = 1e-3  # of the box around a mesh: less volume than this is none


@dataclass(frozen=True, kw_only=True)
class BodyMotion:
    """Meshes and Gaussians that are described together, world, meters."""

    meshes: tuple[int, ...]  # into the meshes of the recording
    starts: Ints  # (M + S + 1,) where the points of each mesh begin, and those of each set
    frames: Floats  # (T, V, 3) [m]
    radius: float  # [m] of the sphere that has the volume of the meshes
    splats: tuple[tuple[int, Ints], ...] = ()  # S sets of Gaussians, and which of each
    shown: tuple[bool, ...] = ()  # (T,) in which frames; none: in all of them

    @property
    def rest(self) -> Floats:
        """(V, 3) [m] the points of the first frame."""
        return self.frames[0]

    @cached_property
    def moves(self) -> bool:
        """False where every frame is the first one."""
        return bool((self.frames != self.frames[:1]).any())

    def points_of(self, mesh: int) -> slice:
        """Where the points of a mesh are, an index into the meshes of the recording."""
        return self._part(self.meshes.index(mesh))

    def splats_of(self, number: int) -> slice:
        """Where the Gaussians of `splats[number]` are."""
        return self._part(len(self.meshes) + number)

    def _part(self, at: int) -> slice:
        return slice(int(self.starts[at]), int(self.starts[at + 1]))


def bodies_of(
    recording: Recording, frames: Sequence[MotionFrame], meshes: Sequence[int]
) -> tuple[BodyMotion, ...]:
    """Meshes of a recording as bodies: those under one root prim whose boxes overlap in the first
    frame.

    The meshes of one body are visible in the same frames.  What the bake does not move and is
    rigid, such as an obstacle, is a body of its own. frames : including the shapes of hidden
    meshes. meshes : a subset of the meshes.
    """
    shown = {i: tuple(i not in frame.hidden for frame in frames) for i in meshes}
    motions = {i: np.array([frame.meshes[i] for frame in frames]) for i in meshes}
    alone = {i for i in meshes if not recording.baked[i] and _is_rigid(motions[i])}
    groups: list[list[int]] = [[i] for i in alone]
    for mesh in (i for i in meshes if i not in alone):
        near = [
            group
            for group in groups
            if any(
                other not in alone
                and _root(recording, mesh) == _root(recording, other)
                and shown[mesh] == shown[other]
                and _meet(motions[mesh][0], motions[other][0])
                for other in group
            )
        ]
        groups = [group for group in groups if group not in near]
        groups.append(sorted([mesh, *(one for group in near for one in group)]))
    found = []
    for group in sorted(groups):
        counts = [motions[i].shape[1] for i in group]
        found.append(
            BodyMotion(
                meshes=tuple(group),
                starts=np.cumsum([0, *counts]),
                frames=np.concatenate([motions[i] for i in group], axis=1),
                radius=_radius(recording, group, motions),
                shown=() if all(shown[group[0]]) else shown[group[0]],
            )
        )
    return tuple(found)


def _is_rigid(frames: Floats) -> bool:
    """Whether points (T, V, 3) keep their distances."""
    if (frames == frames[:1]).all():
        return True
    R, d = kabsch(frames[0], frames, np.ones(len(frames[0])))
    off = frames[0] @ R.transpose(0, 2, 1) + d[:, None] - frames
    return float(np.abs(off).max()) <= RIGID * float(np.ptp(frames[0], axis=0).max())


def _root(recording: Recording, mesh: int) -> str:
    return recording.meshes[mesh].name.split("/")[1]


def _meet(a: Floats, b: Floats) -> bool:
    return bool((a.min(0) <= b.max(0)).all() and (b.min(0) <= a.max(0)).all())


def _radius(recording: Recording, group: Sequence[int], motions: Mapping[int, Floats]) -> float:
    """r = (3 V / 4 pi)^(1/3); half the diagonal of the box where there is no volume."""
    volume = box = 0.0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in group:
        points = motions[i][0]
        center = points.mean(axis=0)
        volume += abs(signed_volume(points - center, recording.meshes[i].triangles))
        box += float(np.prod(np.ptp(points, axis=0)))
        low, high = np.minimum(low, points.min(0)), np.maximum(high, points.max(0))
    if volume <= FLAT * box or volume == 0.0:
        return float(np.linalg.norm(high - low)) / 2.0
    return float(np.cbrt(3.0 * volume / (4.0 * np.pi)))

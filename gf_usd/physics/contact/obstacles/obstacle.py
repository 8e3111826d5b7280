"""Obstacles: their position over time, and contact planes on their surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.core.stage import Collider
from gf_usd.physics.contact.distance.closest import Closest, above_plane
from gf_usd.physics.contact.distance.tree import SurfaceTree

KEPT = 4  # frames: a detection uses the positions at a few frames, some ten times each


@dataclass(frozen=True, kw_only=True)
class Plane:
    """Tangent planes of one obstacle near some points, and their velocities."""

    seen: Closest
    velocity: Floats  # (k, 3) [m/s] of the closest points


class Obstacle:
    """One obstacle over time; constant before its first and after its last frame.

    frame_time : [s] simulated time between two frames.
    """

    def __init__(self, collider: Collider, frame_time: float) -> None:
        self.collider = collider
        self.frame_time = frame_time
        self.endless = collider.shape == "plane"
        frames = [collider.positions(f) for f in range(collider.frames)]
        self._positions: dict[float, Floats] = {}  # of the frames last requested
        self._low = np.min([p.min(0) for p in frames], axis=0)
        self._high = np.max([p.max(0) for p in frames], axis=0)
        self._tree: SurfaceTree | None = None  # built on first use
        self._fitted: Floats | None = None  # the positions that it was last fitted to
        self._near = np.zeros(0, np.int64)  # triangle near which each numbered point was found last

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Corners (3,) [m] of the bounding box over all frames."""
        return self._low, self._high

    def positions(self, frame: float) -> Floats:
        """Points (V, 3) [m] at a frame, linearly interpolated."""
        last = self.collider.frames - 1
        frame = float(np.clip(frame, 0.0, last))
        if frame not in self._positions:
            if len(self._positions) >= KEPT:
                self._positions.clear()
            now = self._positions[frame] = self._at(frame)
            now.flags.writeable = False
        return self._positions[frame]

    def _at(self, frame: float) -> Floats:
        last = self.collider.frames - 1
        low = min(int(frame), max(last - 1, 0))
        start = self.collider.positions(low)
        t = frame - low
        return start if t == 0.0 else (1.0 - t) * start + t * self.collider.positions(low + 1)

    def _triangles_of(self, points: Ints) -> Ints:
        """(n,) the triangle that each of points (n,) was near at last; -1: none."""
        more = int(points.max(initial=-1)) + 1 - len(self._near)
        if more > 0:
            self._near = np.append(self._near, np.full(more, -1))
        return self._near[points]

    def speed(self, frame: float) -> float:
        """[m/s] of its fastest point between a frame and the next."""
        if not self.collider.moves:
            return 0.0
        way = self.positions(np.floor(frame) + 1.0) - self.positions(np.floor(frame))
        return float(np.linalg.norm(way, axis=1).max()) / self.frame_time

    def gaps(self, low: Floats, high: Floats) -> Floats:
        """(n,) [m] distances of boxes with corners (n, 3) [m] to the bounding box over all frames;
        0 where they overlap.
        """
        return np.zeros(len(low)) if self.endless else box_gap(low, high, *self.box)

    def planes(
        self, X: Floats, reach: float, frame: float, span: float, of: Ints | None = None
    ) -> Plane:
        """Tangent planes for points X (n, 3) [m] at a frame; the velocity is that of the next span
        [s].

        of : (n,) numbers >= 0 of the points, under which their triangles are kept; the next query
        of the same numbers is faster, with the same result.
        """
        now, triangles = self.positions(frame), self.collider.triangles
        if self.endless:
            seen = above_plane(X, now[triangles[0]], reach)
        else:
            if self._tree is None:
                self._tree = SurfaceTree(self.positions(0.0), triangles)
            likely = None if of is None else self._triangles_of(of)
            seen = self._tree.closest(
                X, now, reach, moved=now is not self._fitted, likely=likely
            )  # fmt: skip
            self._fitted = now
            if of is not None:
                self._near[of[seen.rows]] = seen.triangle
        if not self.collider.moves or span <= 0.0:
            return Plane(seen=seen, velocity=np.zeros_like(seen.point))
        way = self.positions(frame + span / self.frame_time) - now
        corners = way[triangles[seen.triangle]]
        return Plane(seen=seen, velocity=np.einsum("nk,nka->na", seen.weights, corners) / span)


def obstacles(colliders: Sequence[Collider], frame_time: float) -> tuple[Obstacle, ...]:
    """The obstacles of colliders; frame_time : [s] between two frames."""
    return tuple(Obstacle(collider, frame_time) for collider in colliders)


def box_gap(low: Floats, high: Floats, other_low: Floats, other_high: Floats) -> Floats:
    """(n,) [m] distances of boxes with corners (n, 3) [m], or (3,), from others; 0 where they
    overlap.
    """
    return lengths(np.maximum(np.maximum(other_low - high, low - other_high), 0.0))

"""How much of the surface of the bodies lies inside a body: what contact did not keep apart.

A triangle is inside where the surface of all bodies winds around both points a little off its
middle, on either side (generalized winding number; Jacobson, Kavan and Sorkine-Hornung 2013, summed
fast as Barill et al. 2018, by libigl): one of the two is within the body it bounds anyway.  What is
inside at rest, as where shells overlap in the source, is the asset's own and does not count.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.frames import Pose

OFF = 2e-3  # of the longest edge of the box around all: a point off the surface
WITHIN = 0.5  # winding numbers are whole but for the error of the fast sum
LOOKS = 8  # times that a bake is looked at before its end
GLANCE = 1500  # triangles of such a look
MOST = 20_000  # triangles of the last look
WAYS = 16  # directions in which the depth is looked for
DEEPEST = 64  # triangles whose depth is looked for, at most
STEPS = np.array([0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0])  # [spacings]


@dataclass(frozen=True, kw_only=True)
class Inside:
    """What was found at one time."""

    share: float  # of the area looked at
    depth: float  # [m] of the deepest, to the nearest place outside, in steps of STEPS


class InsideMeasure:
    """The meshes of all bodies.

    surfaces : at rest; spacing : [m] of the particles; frames : of the solver.
    """

    def __init__(self, surfaces: Sequence[Surface], spacing: float, frames: int) -> None:
        first = np.cumsum([0, *(len(one.points) for one in surfaces)])
        self._paths = [one.path for one in surfaces]
        self._triangles = np.ascontiguousarray(
            np.concatenate([one.triangles + k for one, k in zip(surfaces, first)]), dtype=np.int64
        )
        self._points = np.concatenate([np.asarray(one.points, float) for one in surfaces])
        self._spacing, self._last = spacing, frames - 1
        self._stride = max(1, -(-frames // LOOKS))
        self._rest: dict[int, Ints] = {}  # which of a look's triangles are inside at rest

    def asked(self, index: int) -> bool:
        """Whether a frame is looked at."""
        return index == self._last or (index > 0 and index % self._stride == 0)

    def measure(self, index: int, poses: Mapping[str, Pose]) -> Inside:
        """What is inside at a frame, in which the meshes have these poses."""
        most = MOST if index == self._last else GLANCE
        step = max(1, -(-len(self._triangles) // most))
        looked = np.arange(0, len(self._triangles), step)
        if step not in self._rest:
            self._rest[step] = self._inside(self._points, looked)[0]
        moved = np.concatenate([poses[path].x for path in self._paths])
        inside, area, center, normal = self._inside(moved, looked)
        inside = inside & ~self._rest[step]
        total = float(area.sum())
        share = float(area[inside].sum()) / total if total > 0.0 else 0.0
        return Inside(share=share, depth=self._depth(moved, center[inside], normal[inside]))

    def _inside(self, points: Floats, looked: Ints) -> tuple[Ints, Floats, Floats, Floats]:
        a, b, c = np.moveaxis(points[self._triangles[looked]], 1, 0)
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1)
        normal /= np.where(length > 0.0, length, 1.0)[:, None]
        center = (a + b + c) / 3.0
        off = OFF * float(np.ptp(points, axis=0).max()) * normal
        turns = np.abs(self._turns(points, np.concatenate([center + off, center - off])))
        both = turns.reshape(2, -1).min(0) > WITHIN
        return both & (length > 0.0), 0.5 * length, center, normal

    def _depth(self, points: Floats, center: Floats, normal: Floats) -> float:
        if len(center) == 0:
            return 0.0
        some = np.arange(0, len(center), -(-len(center) // DEEPEST))
        steps = self._spacing * STEPS
        depth = np.full(len(some), steps[-1])
        for way in hemisphere(normal[some]):
            X = center[some, None] + steps[:, None] * way[:, None]
            turns = np.abs(self._turns(points, X.reshape(-1, 3))).reshape(len(some), -1)
            out = turns <= WITHIN
            depth = np.minimum(depth, np.where(out.any(1), steps[out.argmax(1)], steps[-1]))
        return float(depth.max())

    def _turns(self, points: Floats, X: Floats) -> Floats:
        return np.asarray(
            igl.fast_winding_number(
                np.ascontiguousarray(points, dtype=float),
                self._triangles,
                np.ascontiguousarray(X, dtype=float),
            )
        ).reshape(-1)


def hemisphere(normal: Floats) -> Iterator[Floats]:
    """Directions (n, 3) of unit length, even over the half space ahead of normals (n, 3)."""
    side = np.cross(normal, np.eye(3)[np.abs(normal).argmin(1)])
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-30)
    other = np.cross(normal, side)
    for k in range(WAYS):  # a spiral (Fibonacci)
        up = 1.0 - (k + 0.5) / WAYS
        turn, out = k * np.pi * (3.0 - 5.0**0.5), np.sqrt(1.0 - up * up)
        yield up * normal + out * (np.cos(turn) * side + np.sin(turn) * other)

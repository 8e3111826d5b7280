"""How much of the surface of the bodies lies inside a body: what contact did not keep apart.

A triangle is inside where the surface of all bodies winds around both points a little off its
middle, on either side (generalized winding number; Jacobson, Kavan and Sorkine-Hornung 2013, summed
fast as Barill et al. 2018, by libigl): one of the two is within the body it bounds anyway.  What is
inside at rest, as where shells overlap in the source, is the asset's own and does not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.stage import Skin
from gf_usd.physics.grid.reference import Rows

OFF = 2e-3  # of the longest edge of the box around all: a point off the surface
WITHIN = 0.5  # winding numbers are whole but for the error of the fast sum
LOOKS = 8  # times that a bake is looked at before its end
GLANCE = 1500  # triangles of such a look
MOST = 20_000  # triangles of the last look
STEPS = np.array([0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0])  # [spacings]


@dataclass(frozen=True, kw_only=True)
class Inside:
    """What was found at one time."""

    share: float  # of the area looked at
    depth: float  # [m] along the normal to where it comes out, of the deepest; up to a step


class InsideMeasure:
    """The surfaces of all bodies.

    skins : one a body, at rest; rows : of their points on the grid; frames : of the bake.
    """

    def __init__(
        self, skins: Sequence[Skin], rows: Sequence[Rows], spacing: float, frames: int
    ) -> None:
        first = np.cumsum([0, *(len(skin.points) for skin in skins)])
        self._points = np.concatenate([skin.points for skin in skins])
        self._triangles = np.ascontiguousarray(
            np.concatenate([skin.triangles + k for skin, k in zip(skins, first)]), dtype=np.int64
        )
        self._rows, self._spacing, self._last = rows, spacing, frames - 1
        self._stride = max(1, -(-frames // LOOKS))
        self._rest: dict[int, Ints] = {}  # which of a look's triangles are inside at rest

    def asked(self, index: int) -> bool:
        """Whether a frame is looked at."""
        return index == self._last or (index > 0 and index % self._stride == 0)

    def measure(self, index: int, u: Floats, offset: Floats) -> Inside:
        """What is inside at a frame; u (nodes, 3) [m] as `Rows` stack them, offset (3,) [m]."""
        most = MOST if index == self._last else GLANCE
        step = max(1, -(-len(self._triangles) // most))
        looked = np.arange(0, len(self._triangles), step)
        if step not in self._rest:
            self._rest[step] = self._inside(self._points, looked)[0]
        moved = self._points + offset + np.concatenate([rows.W @ u for rows in self._rows])
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
        steps = self._spacing * STEPS
        way = center[:, None] + steps[:, None] * normal[:, None]
        out = np.abs(self._turns(points, way.reshape(-1, 3))).reshape(len(center), -1) <= WITHIN
        first = np.where(out.any(1), out.argmax(1), len(steps) - 1)
        return float(steps[first].max())

    def _turns(self, points: Floats, X: Floats) -> Floats:
        return np.asarray(
            igl.fast_winding_number(
                np.ascontiguousarray(points, dtype=float),
                self._triangles,
                np.ascontiguousarray(X, dtype=float),
            )
        ).reshape(-1)

"""How much of the surface of the bodies lies inside a body: what contact did not keep apart.

Triangles are looked at in pieces no larger than half a square with edges of a spacing: of a coarse
mesh a single one is a percent of the surface.  A piece is inside where the surface of all bodies
winds around both points a little off its middle, on either side (generalized winding number;
Jacobson, Kavan and Sorkine-Hornung 2013, summed fast as Barill et al. 2018, by libigl): one of the
two is within the body it bounds anyway.  What is inside at rest, as where shells overlap in the
source, is the asset's own and does not count.

Nor does what is less than DEEP under the surface of what it is in.  Contact acts on samples a
spacing apart: places of the surface are up to half of that from the nearest of them, and its
springs are made to yield by a quarter of a spacing in an impact.  So surfaces that are pressed
together stand in each other by a part of a spacing, and look as if they touched.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.frames import Pose
from gf_usd.core.mesh import divided, signed_volume

# Of the longest edge of the box around all: a point off the surface, by ten times the rounding of
# points in single precision.  What is as near to another place of the surface seems to be inside.
OFF = 1e-6
WITHIN = 0.5  # winding numbers are whole but for the error of the fast sum
LOOKS = 8  # times that a bake is looked at before its end
GLANCE = 1500  # pieces of such a look
MOST = 20_000  # pieces of the last look
WAYS = 16  # directions in which the depth is looked for
DEEP = 0.5  # [spacings] from where a piece inside counts
STEEP = 0.5  # cosine with the normal of a way back that leaves its own curved surface
DEEPEST = 64  # pieces whose depth is looked for, at most
STEPS = np.array([0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0])  # [spacings]


@dataclass(frozen=True, kw_only=True)
class Inside:
    """What was found at one time."""

    share: float  # of the area looked at, more than DEEP inside
    depth: float  # [m] of the deepest, to where it comes out, in steps of STEPS


class InsideMeasure:
    """The meshes of all bodies.

    surfaces : at rest; spacing : [m] of the particles; frames : of the solver, at most; open_end :
    the motion may end before the last of them.
    """

    def __init__(
        self, surfaces: Sequence[Surface], spacing: float, frames: int, *, open_end: bool = False
    ) -> None:
        self._paths = [one.path for one in surfaces]
        self._points, self._triangles, self._ends = stacked(surfaces)
        self._pieces = divided(self._points, self._triangles, 0.5 * spacing**2)
        counts = np.diff(self._ends)
        self._surface = np.repeat(np.arange(len(surfaces)), counts)[self._pieces.of]
        self._spacing, self._last = spacing, frames - 1
        self._stride, self._open_end = max(1, -(-frames // LOOKS)), open_end
        self._rest: dict[int, Ints] = {}  # which of a look's pieces are inside at rest

    def asked(self, index: int) -> bool:
        """Whether a frame is looked at: LOOKS times evenly, or where the end is open after 8, 16,
        32, ... frames.
        """
        if self._open_end and index != self._last:
            return index >= LOOKS and index & (index - 1) == 0
        return index == self._last or (index > 0 and index % self._stride == 0)

    def measure(self, index: int, poses: Mapping[str, Pose], *, ends: bool = False) -> Inside:
        """What is inside at a frame, in which the meshes have these poses.

        ends : the motion ends there, whatever frames there might have been.
        """
        most = MOST if ends or index == self._last else GLANCE
        step = max(1, -(-len(self._pieces.of) // most))
        looked = np.arange(0, len(self._pieces.of), step)
        rest = self._wound(self._points)
        if step not in self._rest:
            self._rest[step] = self._inside(rest, looked)[0]
        moved = self._wound(np.concatenate([poses[path].x for path in self._paths]))
        inside, area, center, normal = self._inside(moved, looked)
        rows = np.flatnonzero(inside & ~self._rest[step])
        deep = rows[~self._shallow(rest, moved, looked[rows], center[rows], normal[rows])]
        total = float(area.sum())
        share = float(area[deep].sum()) / total if total > 0.0 else 0.0
        deepest = deep if len(deep) else rows
        return Inside(share=share, depth=self._depth(moved, center[deepest], normal[deepest]))

    def _wound(self, points: Floats) -> WoundSurfaces:
        return WoundSurfaces(points, self._triangles, self._ends)

    def _shallow(
        self, rest: WoundSurfaces, now: WoundSurfaces, which: Ints, center: Floats, normal: Floats
    ) -> Ints:
        """Whether pieces `which` (n,) that are inside come out within DEEP.

        Ahead a place is out where nothing winds around it.  Behind it is still in the body that the
        triangle bounds, and out of what else that is in, where all wind once and a half at most and
        its own surface does.  Of one surface the two cannot be told apart where a part is thinner
        at rest than DEEP: such a part counts unless it comes out ahead.
        """
        reach = DEEP * self._spacing
        out = np.zeros(len(which), bool)
        _, _, X, N = self._geometry(self._points, which)
        thick = np.abs(rest.turns(X - reach * N)) > WITHIN
        for side, within, least in ((-1.0, 1.0 + WITHIN, STEEP), (1.0, WITHIN, 0.0)):
            for way in directions(side * normal, least):
                left = np.flatnonzero(~out & (thick | (side > 0.0)))
                at = center[left] + reach * way[left]
                free = np.abs(now.turns(at)) <= within
                if side < 0.0:
                    left, at = left[free], at[free]
                    free = np.abs(now.own_turns(self._surface[which[left]], at)) > WITHIN
                out[left[free]] = True
        return out

    def _inside(self, now: WoundSurfaces, looked: Ints) -> tuple[Ints, Floats, Floats, Floats]:
        sound, area, center, normal = self._geometry(now.points, looked)
        off = OFF * float(np.ptp(now.points, axis=0).max()) * normal
        inside = sound & (np.abs(now.turns(center + off)) > WITHIN)
        rows = np.flatnonzero(inside)  # few: a body does not wind around what is off its surface
        inside[rows] = np.abs(now.turns(center[rows] - off[rows])) > WITHIN
        return inside, area, center, normal

    def _geometry(self, points: Floats, which: Ints) -> tuple[Ints, Floats, Floats, Floats]:
        """Whether pieces (n,) have an area, and it; their middles and unit normals (n, 3)."""
        corners = points[self._triangles[self._pieces.of[which]]]
        a, b, c = np.moveaxis(corners, 1, 0)
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1)
        normal /= np.where(length > 0.0, length, 1.0)[:, None]
        middle = np.einsum("nk,nka->na", self._pieces.weights[which], corners)
        return length > 0.0, 0.5 * length * self._pieces.share[which], middle, normal

    def _depth(self, now: WoundSurfaces, center: Floats, normal: Floats) -> float:
        if len(center) == 0:
            return 0.0
        some = np.arange(0, len(center), -(-len(center) // DEEPEST))
        steps = self._spacing * STEPS
        depth = np.full(len(some), steps[-1])
        # Ahead it comes out of all, behind of what it is in besides the body that it bounds.
        for side, within, least in ((1.0, WITHIN, 0.0), (-1.0, 1.0 + WITHIN, STEEP)):
            for way in directions(side * normal[some], least):
                X = center[some, None] + steps[:, None] * way[:, None]
                around = np.abs(now.turns(X.reshape(-1, 3))).reshape(len(some), -1)
                out = around <= within
                depth = np.minimum(depth, np.where(out.any(1), steps[out.argmax(1)], steps[-1]))
        return float(depth.max())


class WoundSurfaces:
    """How often surfaces, as they are at one time, wind around points.

    The hierarchy of the fast sum is built once for each set of triangles: of ten ducks with 70,000
    triangles that takes 62 ms, and what is asked of it, for 768 points, 4 ms (measured).

    points : (V, 3) [m]; triangles : (T, 3) of all; ends : (S + 1,) where those of each begin.
    """

    def __init__(self, points: Floats, triangles: Ints, ends: Ints) -> None:
        self.points, self._triangles, self._ends = points, triangles, ends
        self._built: dict[tuple[int, int], igl.FastWindingNumberBVH] = {}

    def turns(self, X: Floats) -> Floats:
        """(n,) winding numbers of all surfaces together around X (n, 3) [m]."""
        return self._turns(0, len(self._triangles), X)

    def own_turns(self, surface: Ints, X: Floats) -> Floats:
        """(n,) of surface number `surface` (n,) alone around each of X (n, 3) [m]."""
        out = np.zeros(len(X))
        for k in np.unique(surface):
            mine = surface == k
            out[mine] = self._turns(int(self._ends[k]), int(self._ends[k + 1]), X[mine])
        return out

    def _turns(self, first: int, behind: int, X: Floats) -> Floats:
        if len(X) == 0:
            return np.zeros(0)
        if (first, behind) not in self._built:
            made = self._built[first, behind] = igl.FastWindingNumberBVH()
            points = np.ascontiguousarray(self.points, dtype=float)
            made.init(points, np.ascontiguousarray(self._triangles[first:behind]))
        found = self._built[first, behind].winding_number(np.ascontiguousarray(X, dtype=float))
        return np.asarray(found).reshape(-1)


def stacked(surfaces: Sequence[Surface]) -> tuple[Floats, Ints, Ints]:
    """Points (V, 3) [m] of all at rest, triangles (T, 3) of all, and where those of each begin."""
    first = np.cumsum([0, *(len(one.points) for one in surfaces)])
    triangles = np.concatenate([outward(one) + k for one, k in zip(surfaces, first)])
    return (
        np.concatenate([np.asarray(one.points, float) for one in surfaces]),
        np.ascontiguousarray(triangles, dtype=np.int64),
        np.cumsum([0, *(len(one.triangles) for one in surfaces)]),
    )


def outward(surface: Surface) -> Ints:
    """Its triangles (T, 3), turned where it is inside out as a whole."""
    turned = signed_volume(surface.points, surface.triangles) < 0.0
    return surface.triangles[:, ::-1] if turned else surface.triangles


def directions(normal: Floats, least: float) -> Iterator[Floats]:
    """Unit directions (n, 3), even over those whose cosine with normals (n, 3) is over `least`."""
    side = np.cross(normal, np.eye(3)[np.abs(normal).argmin(1)])
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-30)
    other = np.cross(normal, side)
    for k in range(WAYS):  # a spiral (Fibonacci)
        up = 1.0 - (1.0 - least) * (k + 0.5) / WAYS
        turn, out = k * np.pi * (3.0 - 5.0**0.5), np.sqrt(1.0 - up * up)
        yield up * normal + out * (np.cos(turn) * side + np.sin(turn) * other)

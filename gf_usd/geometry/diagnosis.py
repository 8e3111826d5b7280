"""Diagnosis of a mesh as the boundary of a solid.

Faces are counted as authored; everything else is measured on the welded triangles that the fill
uses.  Lengths are in meters.

Faces that are there more than once: duplicates, walls back to back, surfaces with two sides.

Faces without area, and which of them hold nothing together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.mesh import WELD_FRACTION, areas, proper, shells, weld
from gf_usd.core.neighbors import components
from gf_usd.geometry import winding
from gf_usd.geometry.winding import Edges, boundary_loops, fan_area

HOLE_LIMIT = 0.05  # a hole is small, and repair closes it, up to this share of its shell's area


@dataclass(frozen=True, kw_only=True)
class Hole:
    """A loop of boundary edges."""

    edges: int
    size: float  # [m] diagonal of its box
    center: Floats  # (3,) [m]
    share: float  # of the area of its shell with all holes closed by flat fans


@dataclass(frozen=True, kw_only=True)
class Shell:
    """An edge-connected part of a mesh."""

    index: int  # as in topology.shells
    triangles: int
    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    area: float  # [m^2]
    volume: float  # [m^3] enclosed, were all its triangles to agree; holes closed by the winding
    winding: str  # outward | inside out | cavity | mixed | one-sided | open | flat
    against: int  # triangles that face against their neighbors
    holes: tuple[Hole, ...]
    inner: bool = False  # lies in the flesh of another shell: it bounds nothing

    @property
    def size(self) -> Floats:
        """(3,) [m] of its box."""
        return self.high - self.low


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The measured properties of one surface."""

    path: str
    type_name: str
    points: int
    faces: int
    face_sizes: dict[str, int]  # triangles, quads, n-gons (five corners or more)
    largest_face: int  # corners
    area: float  # [m^2]
    shells: tuple[Shell, ...]
    boundary_edges: int
    loose_edges: int  # boundary edges that lie in no closed loop
    collapsed: int  # triangles with two corners in one place
    slivers: int  # triangles without area
    duplicates: int  # triangles that are there twice, or cancel back to back
    crowded_edges: int  # edges that more than two triangles share

    @property
    def holes(self) -> tuple[Hole, ...]:
        """Of all shells."""
        return tuple(hole for shell in self.shells for hole in shell.holes)

    @property
    def hole_share(self) -> float:
        """Flat area of all holes over the area of the closed surface."""
        closed = sum(s.area / (1.0 - sum(h.share for h in s.holes)) for s in self.shells)
        return 1.0 - self.area / closed if closed > 0.0 else 0.0

    @property
    def watertight(self) -> bool:
        return self.boundary_edges == 0 and bool(self.shells)

    @property
    def volume(self) -> float:
        """[m^3] of the shells, cavities taken off, inner shells left out; overlaps count twice."""
        flesh = [s for s in self.shells if not s.inner]
        return sum(-s.volume if s.winding == "cavity" else s.volume for s in flesh)

    def with_winding(self, *kinds: str) -> int:
        """How many shells are wound in any of these ways."""
        return sum(s.winding in kinds for s in self.shells)


def diagnose(surface: Surface) -> Diagnosis:
    """Diagnose one surface."""
    counts = surface.face_counts
    welded = weld(surface.points)[0][surface.triangles]
    sound = proper(welded)
    triangles = np.ascontiguousarray(welded[sound], np.int64)
    edges = Edges.of(triangles)
    parts, loose = _shells(surface.points, triangles, edges) if len(triangles) else ((), 0)
    return Diagnosis(
        path=surface.path,
        type_name=surface.type_name,
        points=len(surface.points),
        faces=len(counts),
        face_sizes={
            "triangles": int((counts == 3).sum()),
            "quads": int((counts == 4).sum()),
            "ngons": int((counts > 4).sum()),
        },
        largest_face=int(counts.max(initial=0)),
        area=sum(shell.area for shell in parts),
        shells=parts,
        boundary_edges=len(edges.boundary),
        loose_edges=loose,
        collapsed=int((~sound).sum()),
        slivers=int(slivers(surface.points, triangles).sum()),
        duplicates=_duplicates(triangles, authored_faces(surface)[sound]),
        crowded_edges=edges.crowded,
    )


def _duplicates(triangles: Ints, face: Ints) -> int:
    return int((doubled(triangles, face) != SINGLE).sum())


def _shells(points: Floats, triangles: Ints, edges: Edges) -> tuple[tuple[Shell, ...], int]:
    """Shells, and the boundary edges that lie in no closed loop."""
    label = shells(triangles)
    patch = winding.patches(points, triangles, edges)
    agreed = winding.turned(triangles, patch.against)
    area = np.bincount(label, areas(points, triangles))
    low, high = winding.boxes(points, triangles, label)
    volume = np.abs(winding.volumes(points, agreed, label))
    facing = winding.facing(points, agreed, label)
    against = np.bincount(label, patch.against)
    one_sided = np.bincount(label, patch.one_sided) > 0
    # Boundary edges chain only where their triangles agree.
    loops: list[Ints] = []
    loose, faced = 0, agreed
    if len(edges.boundary):
        apart = winding.facing(points, agreed, patch.label)
        faced = winding.turned(agreed, apart.wrong[patch.label])
        loops, loose = boundary_loops(Edges.of(faced))
    holes: dict[int, list[Ints]] = {}
    for loop in loops:
        holes.setdefault(int(label[loop[0] // 3]), []).append(faced.reshape(-1)[loop])

    def kind(k: int) -> str:
        if one_sided[k]:
            return "one-sided"
        if against[k]:
            return "mixed"
        if facing.now[k] == 0:
            return "open" if holes.get(k) else "flat"
        if facing.goal[k] == -1:
            return "cavity"
        return "outward" if facing.now[k] > 0 else "inside out"

    made = tuple(
        Shell(
            index=k,
            triangles=count,
            low=low[k],
            high=high[k],
            area=float(area[k]),
            volume=float(volume[k]),
            winding=kind(k),
            against=int(against[k]),
            inner=bool(facing.inner[k]),
            holes=_holes([points[ring] for ring in holes.get(k, ())], float(area[k])),
        )
        for k, count in enumerate(np.bincount(label).tolist())
    )
    return made, loose


def _holes(rings: list[Floats], area: float) -> tuple[Hole, ...]:
    """Holes of one shell of an area [m^2], the largest first."""
    fans = [fan_area(ring) for ring in rings]
    closed = area + sum(fans)
    made = [
        Hole(
            edges=len(ring),
            size=float(np.linalg.norm(np.ptp(ring, axis=0))),
            center=ring.mean(0),
            share=fan / closed if closed > 0.0 else 0.0,
        )
        for ring, fan in zip(rings, fans)
    ]
    return tuple(sorted(made, key=lambda hole: -hole.share))


def faults(seen: Diagnosis) -> list[str]:
    """The defects of a mesh as a boundary, as text."""
    said = []
    if seen.holes:
        share = f"{100 * seen.hole_share:.2g} % of the closed area"
        said.append(f"{_count(len(seen.holes), 'hole')} ({share})")
    if against := sum(shell.against for shell in seen.shells):
        said.append(f"{_count(against, 'triangle')} facing the other way")
    if inward := seen.with_winding("inside out"):
        said.append(f"{inward} of {_count(len(seen.shells), 'shell')} inside out")
    if inner := sum(shell.inner for shell in seen.shells):
        said.append(f"{_count(inner, 'shell')} inside others that bound no volume")
    if seen.duplicates:
        said.append(_count(seen.duplicates, "duplicate triangle"))
    return said


def tolerated_defects(seen: Diagnosis) -> str:
    """Defects of a mesh that the fill tolerates, as text; "" where there are none.

    The winding number gives the expected inside for meshes with holes, duplicate faces or a few
    reversed faces; whole parts that face inward inside others are treated as cavities.
    """
    said = faults(seen)
    if not said:
        return ""
    small = any(hole.share <= HOLE_LIMIT for hole in seen.holes)
    hint = "; --repair fixes this" if small or len(said) > bool(seen.holes) else ""
    return f"<{seen.path}> is filled despite {', '.join(said)}{hint}"


KEPT = 0.9  # of the volume that meshes enclose: less is worth a warning; overlaps count twice in it


def lost_volume_warning(seen: Sequence[Diagnosis], volume: float) -> str:
    """A warning where defects of meshes remove much of the enclosed volume; else "".

    volume : [m^3] of them that was filled.
    """
    whole = sum(one.volume for one in seen)
    if volume >= KEPT * whole or not any(faults(one) for one in seen):
        return ""
    return (
        f"only {volume:.3g} of the {whole:.3g} m^3 enclosed by the meshes are filled: try --repair"
    )


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


Flags = NDArray[np.bool_]


SINGLE, DUPLICATE, WALL, OTHER_SIDE = range(4)


def authored_faces(surface: Surface) -> Ints:
    """(T,) the authored face that each of `Surface.triangles` was cut from."""
    ends = np.cumsum(surface.face_counts)
    return np.searchsorted(ends, surface.triangle_corners[:, 0], side="right")


def doubled(triangles: Ints, face: Ints) -> Ints:
    """(T,) what makes a triangle superfluous as the fill sees it; SINGLE where nothing does.

    DUPLICATE : one that faces the same way, or more of them, is there too.
    WALL : as many face one way as the other, so that they cancel: both go.
    OTHER_SIDE : so too, but without them the rest would be open or gone (a surface that was
    modeled with both its sides): one side stays.

    Whole faces (T,) are compared by their outlines, since a quad and its reverse may be cut along
    different diagonals; then what is left, triangle by triangle.
    """
    kind = np.full(len(triangles), SINGLE)
    for one in (face, np.arange(len(triangles))):
        left = np.flatnonzero(kind == SINGLE)
        if len(left):
            kind[left] = _doubled(triangles[left], np.unique(one[left], return_inverse=True)[1])
    return kind


def _doubled(triangles: Ints, face: Ints) -> Ints:
    """As `doubled`, for faces numbered from 0."""
    edges = Edges.of(triangles)
    group, odd = _outlines(edges, face)
    ahead, back = np.bincount(group, ~odd), np.bincount(group, odd)
    kind = np.full(len(group), SINGLE)
    if (ahead + back == 1).all():
        return kind[face]
    balanced = (ahead == back)[group]
    wanted = balanced | ((back > ahead)[group] == odd)
    mine = np.flatnonzero(wanted)
    first = np.zeros(len(group), bool)
    first[mine[np.unique(group[mine], return_index=True)[1]]] = True
    kind[~first] = DUPLICATE
    kind[balanced] = WALL
    two_sided = balanced & _needed(edges, face, balanced)
    kind[two_sided] = OTHER_SIDE
    kind[two_sided & first] = SINGLE
    return kind[face]


def _outlines(edges: Edges, face: Ints) -> tuple[Ints, Flags]:
    """(F,) a number for each outline, and whether it is run through the other way.

    An outline is the set of edges that one triangle of the face has alone.
    """
    of = np.repeat(face, 3)
    _, at, uses = np.unique(
        of * len(edges.uses) + edges.id, return_inverse=True, return_counts=True
    )
    rim = np.flatnonzero(uses[at.reshape(-1)] == 1)
    rim = rim[np.lexsort((edges.id[rim], of[rim]))]
    count = np.bincount(of[rim], minlength=int(face.max()) + 1)
    start = np.cumsum(count) - count
    group = np.arange(len(count))  # a face without an outline is like no other
    odd = np.zeros(len(count), bool)
    for n in np.unique(count[count > 0]):
        rows = np.flatnonzero(count == n)
        halves = rim[start[rows][:, None] + np.arange(n)]
        _, first, same = np.unique(edges.id[halves], axis=0, return_index=True, return_inverse=True)
        group[rows] = rows[first[same.reshape(-1)]]
        lowest = edges.directed[halves[:, 0]]
        odd[rows] = lowest[:, 0] > lowest[:, 1]
    return group, odd


def _needed(edges: Edges, face: Ints, balanced: Flags) -> Flags:
    """(F,) balanced faces of which one side must stay.

    Of a connected set of them the rim decides.  Edges that the rest uses an odd number of times
    would be left open without it; where the rest uses them an even number of times it hangs on
    a surface that is whole.  A set without either is all there is of its shell.
    """
    double = balanced[face]
    slot = np.repeat(double, 3)
    rest = np.bincount(edges.id[~slot], minlength=len(edges.uses))
    n = len(face)
    mine = np.flatnonzero(slot)
    graph = coo_matrix(
        (np.ones(len(mine), np.int8), (mine // 3, n + edges.id[mine])),
        shape=(n + len(edges.uses),) * 2,
    )
    part = components(graph)[1][:n]
    met = rest[edges.id[mine]]
    size = int(part.max()) + 1
    opened = np.bincount(part[mine // 3], met % 2 == 1, size)
    whole = np.bincount(part[mine // 3], (met > 0) & (met % 2 == 0), size)
    needed = (opened > whole) | ((opened == 0) & (whole == 0))
    out = np.zeros(len(balanced), bool)
    out[face[double & needed[part]]] = True
    return out


def slivers(points: Floats, triangles: Ints) -> Flags:
    """(T,) True where three different vertices lie in one line, within the welding tolerance.

    The height over the longest edge, 2 A / L, is what is measured.
    """
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(sides, axis=2).max(1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return twice_area <= WELD_FRACTION * float(np.linalg.norm(np.ptp(points, axis=0))) * longest


def removable_slivers(sliver: Flags, edges: Edges) -> Flags:
    """(T,) slivers whose removal opens no seam.

    A sliver between two triangles and one (a T-junction) closes a surface.
    """
    uses = edges.uses[edges.id].reshape(-1, 3)
    return sliver & ((uses == 2).sum(1) <= (uses == 1).sum(1))

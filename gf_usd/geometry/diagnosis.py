"""Diagnosis of a mesh as the boundary of a solid: holes, winding, duplicate and degenerate faces.

Faces are counted as authored; everything else is measured on the welded triangles from which the
solid is built. Lengths are in meters.

This module also classifies duplicate triangles (`classify_duplicates`) and zero-area triangles
(`slivers`, `removable_slivers`), which repair removes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints, cross, lengths
from gf_usd.core.asset import Surface
from gf_usd.core.errors import counted
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import WELD_FRACTION, Edges, Welded, first_equal, numbered
from gf_usd.core.neighbors import components
from gf_usd.core.units import percent_text, volume_text
from gf_usd.geometry import winding
from gf_usd.geometry.winding import boundary_loops, fan_area

HOLE_LIMIT = 0.05  # share of the area of its shell up to which repair closes a hole


@dataclass(frozen=True, kw_only=True)
class Hole:
    """A loop of boundary edges."""

    edges: int
    size: float  # [m] diagonal of its bounding box
    center: Floats  # (3,) [m]
    share: float  # of the area of its shell with all holes closed by triangle fans


@dataclass(frozen=True, kw_only=True)
class Shell:
    """An edge-connected part of a mesh."""

    index: int  # as in topology.shells
    triangles: int
    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    area: float  # [m^2]
    volume: float  # [m^3] enclosed, after its triangles are given a consistent winding
    winding: str  # outward | inside out | cavity | mixed | one-sided | open | flat
    against: int  # triangles wound opposite to the majority
    holes: tuple[Hole, ...]
    inner: bool = False  # lies inside the solid of another shell, so that it bounds no volume

    @property
    def size(self) -> Floats:
        """(3,) [m] extent of its bounding box."""
        return self.high - self.low


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """What is measured on one surface."""

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
    collapsed: int  # triangles with two coincident corners
    slivers: int  # triangles of zero area
    duplicates: int  # coincident triangles of equal or opposite orientation
    non_manifold_edges: int  # edges that more than two triangles share

    @property
    def holes(self) -> tuple[Hole, ...]:
        """Of all shells."""
        return tuple(hole for shell in self.shells for hole in shell.holes)

    @property
    def hole_share(self) -> float:
        """Area of the triangle fans over all holes, divided by the area of the closed surface."""
        closed = sum(s.area / (1.0 - sum(h.share for h in s.holes)) for s in self.shells)
        return 1.0 - self.area / closed if closed > 0.0 else 0.0

    @property
    def watertight(self) -> bool:
        return self.boundary_edges == 0 and bool(self.shells)

    @property
    def volume(self) -> float:
        """[m^3] of the shells minus cavities, without inner shells; overlaps count twice."""
        outer = [s for s in self.shells if not s.inner]
        return sum(-s.volume if s.winding == "cavity" else s.volume for s in outer)

    def with_winding(self, *kinds: str) -> int:
        """Number of shells whose winding is any of these kinds."""
        return sum(s.winding in kinds for s in self.shells)


def diagnose(surface: Surface) -> Diagnosis:
    """Diagnose one surface."""
    counts = surface.face_counts
    welded = surface.welded
    triangles, edges = welded.triangles, welded.edges
    parts, loose = _shells(surface.points, welded) if len(triangles) else ((), 0)
    duplicates = classify_duplicates(triangles, authored_faces(surface)[welded.source], edges)
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
        collapsed=len(surface.triangles) - len(triangles),
        slivers=int(slivers(surface.points, triangles).sum()),
        duplicates=int((duplicates != SINGLE).sum()),
        non_manifold_edges=edges.non_manifold,
    )


def _shells(points: Floats, welded: Welded) -> tuple[tuple[Shell, ...], int]:
    """The shells, and the number of boundary edges that lie in no closed loop."""
    triangles, edges, label = welded.triangles, welded.edges, welded.shell
    patch = winding.patches(points, triangles, edges)
    turned = patch.against.any()
    agreed = winding.flipped(triangles, patch.against) if turned else triangles
    low, high = winding.boxes(points, triangles, label)
    orientation = winding.orientations(points, agreed, label)
    volume = np.abs(orientation.volume)
    area = np.bincount(label, areas(points, triangles)) if turned else orientation.area
    against = np.bincount(label, patch.against)
    one_sided = np.bincount(label, patch.one_sided) > 0
    # Boundary edges form loops only where the winding of their triangles is consistent.
    loops: list[Ints] = []
    loose, faced = 0, agreed
    if len(edges.boundary):
        of_patches = orientation
        if not np.array_equal(patch.label, label):
            of_patches = winding.orientations(points, agreed, patch.label)
        faced = winding.flipped(agreed, of_patches.wrong[patch.label])
        loops, loose = boundary_loops(Edges.of(faced))
    holes: dict[int, list[Ints]] = {}
    for loop in loops:
        holes.setdefault(int(label[loop[0] // 3]), []).append(faced.reshape(-1)[loop])

    def kind(k: int) -> str:
        if one_sided[k]:
            return "one-sided"
        if against[k]:
            return "mixed"
        if orientation.current[k] == 0:
            return "open" if holes.get(k) else "flat"
        if orientation.target[k] == -1:
            return "cavity"
        return "outward" if orientation.current[k] > 0 else "inside out"

    made = tuple(
        Shell(
            index=k,
            triangles=count,
            low=low[k],
            high=high[k],
            area=float(area[k]),
            volume=0.0 if one_sided[k] else float(volume[k]),  # it has no inside
            winding=kind(k),
            against=int(against[k]),
            inner=bool(orientation.inner[k]),
            holes=_holes([points[ring] for ring in holes.get(k, ())], float(area[k])),
        )
        for k, count in enumerate(np.bincount(label).tolist())
    )
    return made, loose


def _holes(rings: list[Floats], area: float) -> tuple[Hole, ...]:
    """The holes of one shell, the largest first; rings : (n, 3) [m] of each; area : [m^2]."""
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


def faults(*seen: Diagnosis) -> list[str]:
    """Phrases for the faults of meshes as the boundary of a solid; numbers are sums over them."""
    found = []
    if holes := sum(len(one.holes) for one in seen):
        worst = max(seen, key=lambda one: one.hole_share)
        share = f"{percent_text(worst.hole_share)} of the closed area"
        where = share if len(seen) == 1 else f"at most {share}, of <{worst.path}>"
        found.append(f"{counted(holes, 'hole')} ({where})")
    shells = [shell for one in seen for shell in one.shells]
    if against := sum(shell.against for shell in shells):
        found.append(f"{counted(against, 'triangle')} facing the other way")
    if inward := sum(one.with_winding("inside out") for one in seen):
        found.append(f"{inward} of {counted(len(shells), 'shell')} inside out")
    if inner := sum(shell.inner for shell in shells):
        found.append(f"{counted(inner, 'shell')} inside others that bound no volume")
    if duplicates := sum(one.duplicates for one in seen):
        found.append(counted(duplicates, "duplicate triangle"))
    return found


SEPARATE = 3  # meshes with faults up to which each has a note of its own


def tolerated_defects(seen: Sequence[Diagnosis]) -> list[str]:
    """Notes on the faults with which meshes are filled nevertheless.

    The generalized winding number is robust to holes, duplicate faces and single faces of reversed
    winding. A whole part that faces inward inside another one is taken as a cavity.
    """
    faulty = [one for one in seen if faults(one)]
    if len(faulty) > SEPARATE:
        text = f"{len(faulty)} meshes are filled despite {', '.join(faults(*faulty))}"
        return [text + _remedy(faulty)]
    return [
        f"<{one.path}> is filled despite {', '.join(faults(one))}{_remedy([one])}" for one in faulty
    ]


def _remedy(faulty: Sequence[Diagnosis]) -> str:
    """How to repair one of these meshes at least; "" where all have holes only that stay open."""
    small = any(hole.share <= HOLE_LIMIT for one in faulty for hole in one.holes)
    other = any(len(faults(one)) > bool(one.holes) for one in faulty)
    return "; --repair fixes this" if small or other else ""


FILLED_SHARE = 0.9  # of the enclosed volume, overlaps counted twice: a warning if less is filled


def lost_volume_warning(
    seen: Sequence[Diagnosis], volume: float, enclosed: Callable[[], Collection[str]]
) -> str:
    """A warning where much of the volume that faulty meshes enclose is not filled; else "".

    volume : [m^3] that was filled; enclosed : prim paths of meshes inside others, which add nothing
    to it (`Solid.enclosed`).
    """
    whole = sum(one.volume for one in seen)
    if volume >= FILLED_SHARE * whole or not any(faults(one) for one in seen):
        return ""
    inner = enclosed()
    whole = sum(one.volume for one in seen if one.path not in inner)
    if volume >= FILLED_SHARE * whole:
        return ""
    return (
        f"only {volume_text(volume)} of the {volume_text(whole)} enclosed by the meshes are filled:"
        " try --repair"
    )


Flags = NDArray[np.bool_]


SINGLE, DUPLICATE, WALL, OTHER_SIDE = range(4)


def authored_faces(surface: Surface) -> Ints:
    """(T,) the authored face of each of `Surface.triangles`."""
    ends = np.cumsum(surface.face_counts)
    return np.searchsorted(ends, surface.triangle_corners[:, 0], side="right")


def classify_duplicates(triangles: Ints, face: Ints, edges: Edges | None = None) -> Ints:
    """(T,) why a triangle is redundant for the winding number; SINGLE where it is not.

    DUPLICATE : a coincident triangle of the same orientation is kept.
    WALL : coincident triangles of opposite orientation, whose winding numbers cancel; all are
    removed.
    OTHER_SIDE : likewise, but without them the rest would be open or empty (a double-sided
    surface): one side is kept, as SINGLE.

    face : (T,) the face that each triangle is part of. Whole faces are compared first, by their
    outlines, since a quad and its reverse may be triangulated along different diagonals; the
    remaining triangles are then compared one by one.

    edges : of the triangles, where they are known.
    """
    kind = np.full(len(triangles), SINGLE)
    for one in (face, np.arange(len(triangles))):
        left = np.flatnonzero(kind == SINGLE)
        if len(left):
            of = numbered(one[left]).of
            if edges is None or len(left) < len(triangles):
                edges = Edges.of(triangles[left])
            kind[left] = _classify_faces(edges, of)
            if of.max() + 1 == len(left):  # every face is a triangle: they have been compared
                break
    return kind


def _classify_faces(edges: Edges, face: Ints) -> Ints:
    """As `classify_duplicates`, for whole faces, numbered from 0."""
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
    two_sided = balanced & _double_sided(edges, face, balanced)
    kind[two_sided] = OTHER_SIDE
    kind[two_sided & first] = SINGLE
    return kind[face]


def _outlines(edges: Edges, face: Ints) -> tuple[Ints, Flags]:
    """(F,) the number of the outline of each face, and whether the face traverses it in reverse.

    The outline of a face is the set of edges that only one of its triangles has.
    """
    of = np.repeat(face, 3)
    if np.array_equal(face, np.arange(len(face))):  # every face is a triangle
        sides = np.argsort(edges.id.reshape(-1, 3), axis=1)
        rim = (3 * face[:, None] + sides).reshape(-1)
    else:
        found = numbered(of * len(edges.uses) + edges.id)
        rim = found.order[np.repeat(found.count == 1, found.count)]  # by face, then by edge
    count = np.bincount(of[rim], minlength=int(face.max()) + 1)
    start = np.cumsum(count) - count
    group = np.arange(len(count))  # a face without an outline has no duplicates
    odd = np.zeros(len(count), bool)
    for n in np.unique(count[count > 0]):
        rows = np.flatnonzero(count == n)
        halves = rim[start[rows][:, None] + np.arange(n)]
        group[rows] = rows[first_equal(edges.id[halves])]
        lowest = edges.directed[halves[:, 0]]
        odd[rows] = lowest[:, 0] > lowest[:, 1]
    return group, odd


def _double_sided(edges: Edges, face: Ints, balanced: Flags) -> Flags:
    """(F,) balanced faces (as many of one orientation as of the other) of which one side is kept.

    Decided for each connected set of balanced faces, by the edges that it shares with other faces.
    An edge that the other faces use an odd number of times would become a boundary edge without the
    set; one that they use an even number of times belongs to a closed surface without it. One side
    is kept where edges of the first kind are the majority, or where the set shares no edges.
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
    """(T,) True where three distinct vertices are collinear within the welding tolerance.

    Measured is the height over the longest edge, 2 A / L.
    """
    corners = points[triangles]
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, bc, ca = b - a, c - b, a - c
    longest = np.maximum(np.maximum(lengths(ab), lengths(bc)), lengths(ca))
    twice_area = lengths(cross(ab, bc))
    return twice_area <= WELD_FRACTION * float(np.linalg.norm(np.ptp(points, axis=0))) * longest


def removable_slivers(sliver: Flags, edges: Edges) -> Flags:
    """(T,) slivers whose removal creates no boundary edges.

    A sliver at a T-junction, between one triangle and two, is kept: it closes the surface.
    """
    uses = edges.uses[edges.id].reshape(-1, 3)
    return sliver & ((uses == 2).sum(1) <= (uses == 1).sum(1))

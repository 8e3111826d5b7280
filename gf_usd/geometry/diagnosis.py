"""What is right and wrong with a mesh as a boundary of something solid.

Faces are counted as authored; everything else is measured on the welded triangles that the fill
uses.  Lengths are in metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.geometry import winding
from gf_usd.geometry.doubled import SINGLE, authored_faces, doubled
from gf_usd.geometry.edges import Edges, boundary_loops, fan_area
from gf_usd.geometry.faces import slivers
from gf_usd.model import Floats, Ints, Surface
from gf_usd.topology import proper, shells, weld

HOLE_LIMIT = 0.05  # a hole is small, and repair closes it, up to this share of its shell's area


@dataclass(frozen=True, kw_only=True)
class Hole:
    """A loop of boundary edges."""

    edges: int
    size: float  # [m] diagonal of its box
    centre: Floats  # (3,) [m]
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
    against: int  # triangles that face against their neighbours
    holes: tuple[Hole, ...]
    inner: bool = False  # lies in the flesh of another shell: it bounds nothing

    @property
    def size(self) -> Floats:
        """(3,) [m] of its box."""
        return self.high - self.low


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """One surface, looked at."""

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
    """Look at one surface."""
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
    area = np.bincount(label, winding.areas(points, triangles))
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
            centre=ring.mean(0),
            share=fan / closed if closed > 0.0 else 0.0,
        )
        for ring, fan in zip(rings, fans)
    ]
    return tuple(sorted(made, key=lambda hole: -hole.share))


def faults(seen: Diagnosis) -> list[str]:
    """What is wrong with a mesh as a boundary, in words."""
    said = []
    if seen.holes:
        share = f"{100 * seen.hole_share:.2g} % of the closed area"
        said.append(f"{_count(len(seen.holes), 'hole')} ({share})")
    if against := sum(shell.against for shell in seen.shells):
        said.append(f"{_count(against, 'triangle')} facing against the rest")
    if inward := seen.with_winding("inside out"):
        said.append(f"{inward} of {_count(len(seen.shells), 'shell')} inside out")
    if inner := sum(shell.inner for shell in seen.shells):
        said.append(f"{_count(inner, 'shell')} inside others that bound nothing")
    if seen.duplicates:
        said.append(_count(seen.duplicates, "duplicate triangle"))
    return said


def tolerated(seen: Diagnosis) -> str:
    """What the fill puts up with in a mesh, in words; "" where there is nothing to say.

    The winding number judges the inside of a mesh with holes, with doubled faces or with a few
    faces turned as a person would; whole parts that face inward inside others are taken as hollow.
    """
    said = faults(seen)
    if not said:
        return ""
    small = any(hole.share <= HOLE_LIMIT for hole in seen.holes)
    mends = "; --repair mends such things" if small or len(said) > bool(seen.holes) else ""
    return f"<{seen.path}> is filled in spite of {', '.join(said)}{mends}"


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"

"""A solid: the surfaces that bound it, and the test for points inside.

A point is inside where the absolute value of the generalized winding number of a surface exceeds
one half (Jacobson, Kavan and Sorkine-Hornung 2013). It is evaluated for each surface separately,
which is robust to overlapping shells, reversed winding and small holes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import Edges, Welded, boundary_edges
from gf_usd.core.neighbors import components
from gf_usd.geometry.winding import boundary_loops, enclosing_parts, volumes, winding_hierarchy

OPEN_FRACTION = 0.25  # share of holes in the closed area above which a surface has no inside
FLAT_FRACTION = 1e-4  # volume below this share of (area)^(3/2): flat
PROBES = 200_000  # sample points for volumes without a closed form
LEAST_PROBES = 2_000  # of them in each group of surfaces whose boxes overlap
# By which boxes that touch may overlap along an axis: the rounding of two coordinates to float32,
# and at least and at most these shares of the smaller box.  Where rounding is coarser, boxes that
# overlap cannot be distinguished from others.
ROUNDING = float(np.finfo(np.float32).eps)  # of the largest coordinate
TOUCHING, MOST_TOUCHING = 1e-6, 1e-2
RECURRENCE = 1.2207440846057596
INSIDE = 0.5
# Triangles of a surface from which its hierarchy is released after filling: it takes some 200 bytes
# for each, which made the peak of a bake with 1.3 million triangles 14 % higher (measured).
KEPT = 200_000
TESTED = 64  # points of a surface, about, that are tested for being inside another one

Measured = TypeVar("Measured")


class Bounds:
    """Winding numbers of one surface at rest.

    The hierarchy of the fast sum (Barill et al. 2018) is built by the first query and kept: for the
    7,000 triangles of a duck it takes 8.5 ms, a query of 100 points 0.6 ms (measured).

    points : (V, 3) [m]; triangles : (T, 3).
    """

    def __init__(self, points: Floats, triangles: Ints) -> None:
        # Centered, to keep precision far from the origin.
        self._center = points.mean(0)
        self._points, self._triangles = points, triangles
        self.low, self.high = points.min(0), points.max(0)
        self._kept: igl.FastWindingNumberBVH | None = None

    def inside(self, X: Floats) -> NDArray[np.bool_]:
        """(n,) True for points (n, 3) [m] with a winding number of more than 1/2 in magnitude."""
        near = np.ones(len(X), bool)
        for x, low, high in zip(X.T, self.low, self.high):
            near &= (low <= x) & (x <= high)
        if near.any():
            near[near] = np.abs(self.winding_numbers(X[near])) > INSIDE
        return near

    def winding_numbers(self, X: Floats) -> NDArray[np.float64]:
        """(n,) about points X (n, 3) [m]."""
        return np.asarray(self._hierarchy().winding_number(X - self._center)).reshape(-1)

    def _hierarchy(self) -> igl.FastWindingNumberBVH:
        if self._kept is None:
            self._kept = winding_hierarchy(self._points - self._center, self._triangles)
        return self._kept

    def __getstate__(self) -> dict[str, Any]:
        """Without the hierarchy, which cannot be pickled: plans with pins have solids."""
        return {**self.__dict__, "_kept": None}

    def release(self) -> None:
        """Free the hierarchy of a large surface; the next query builds it again."""
        if len(self._triangles) > KEPT:
            self._kept = None


@dataclass(frozen=True, kw_only=True)
class Solid:
    """The union of an asset's closed surfaces."""

    surfaces: tuple[Surface, ...]
    triangles: tuple[Ints, ...]  # (T, 3) of each, see `Surface.welded`
    sources: tuple[Ints, ...]  # (T,) row in Surface.triangles of each
    volume: float  # [m^3]
    low: Floats  # (3,) [m]
    high: Floats  # (3,) [m]
    embedded: tuple[
        tuple[str, str], ...
    ]  # (prim path, reason) of surfaces that are not filled and move with the body
    bounds: tuple[Bounds, ...] = field(repr=False)  # of each surface
    walls: Mapping[str, str] = field(default_factory=dict)  # prim path of the surface that contains
    # the triangles of an embedded one as the inner side of its wall, by that one's prim path
    # prim paths of meshes that bound a volume together; the first is that of their surface
    joined: tuple[tuple[str, ...], ...] = ()
    # Results of `thickness`, which a bake needs for its resolution and an inspection once more.
    _thickness: dict[tuple[int, bytes], Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _rings: dict[int, list[Ints]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def filled(self) -> dict[str, int]:
        """The surface that each filled mesh is, or is a part of, by prim path; inner sides of walls
        are part of that of the outer side.
        """
        index = {s.path: k for k, s in enumerate(self.surfaces)}
        parts = {path: index[group[0]] for group in self.joined for path in group}
        sides = {inner: index[outer] for inner, outer in self.walls.items()}
        return sides | parts | index

    def inside(self, X: Floats) -> NDArray[np.bool_]:
        """(n,) True for points (n, 3) [m] inside any of the surfaces.

        Points are sorted along one axis, so that each surface sees only those between its ends:
        220,000 points against all boxes of 400 balls would take nine times as long (measured).
        """
        if len(self.bounds) == 1:
            return self.bounds[0].inside(X)
        low, high = (np.array(ends) for ends in zip(*((one.low, one.high) for one in self.bounds)))
        whole = high.max(0) - low.min(0)
        axis = int(np.argmin((high - low).sum(0) / np.where(whole > 0.0, whole, 1.0)))
        order = np.argsort(X[:, axis])
        X = X[order]
        left = np.ones(len(X), bool)
        first = np.searchsorted(X[:, axis], low[:, axis], "left")
        last = np.searchsorted(X[:, axis], high[:, axis], "right")
        for k in np.flatnonzero(first < last):
            rows = first[k] + np.flatnonzero(left[first[k] : last[k]])
            left[rows] = ~self.bounds[k].inside(X[rows])
        out = np.empty(len(X), bool)
        out[order] = ~left
        return out

    def adding_nothing(self) -> set[str]:
        """`enclosed`, and the paths of joined meshes, which may lie around others as clothes do."""
        return self.enclosed() | {group[0] for group in self.joined}

    def enclosed(self) -> set[str]:
        """Prim paths of surfaces that are inside another one, and add nothing to the union."""
        points = [s.face_points for s in self.surfaces]
        low, high = np.array([p.min(0) for p in points]), np.array([p.max(0) for p in points])
        within = np.asarray(((low[:, None] >= low) & (high[:, None] <= high)).all(2))
        np.fill_diagonal(within, False)
        found = set()
        for a, X in enumerate(points):
            X = X[:: max(1, len(X) // TESTED)]
            if any(self.bounds[b].inside(X).all() for b in np.flatnonzero(within[a])):
                found.add(self.surfaces[a].path)
        return found

    def measured(self, of: tuple[int, bytes], measure: Callable[[], Measured]) -> Measured:
        """The thickness for a number of rays and a body of each surface, measured once."""
        if of not in self._thickness:
            self._thickness[of] = measure()
        return self._thickness[of]

    def release(self) -> None:
        """Free the hierarchies of large surfaces after the last of many queries."""
        for one in self.bounds:
            one.release()

    def rings(self, index: int) -> list[Ints]:
        """The rims of the holes of a surface as closed rings of points, in the direction in which
        a triangle that closes one passes its edges.
        """
        if index not in self._rings:
            triangles = self.triangles[index]
            has_holes = len(self.surfaces[index].welded.boundary) > 0
            loops = boundary_loops(Edges.of(triangles))[0] if has_holes else []
            # adjacent triangles traverse their common edge in opposite directions
            self._rings[index] = [triangles.reshape(-1)[loop[::-1]] for loop in loops]
        return self._rings[index]

    def part(self, members: Ints) -> Solid:
        """The solid of some of the surfaces; its volume is not known (nan) unless they are all."""
        if len(members) == len(self.surfaces):
            return self
        surfaces = tuple(self.surfaces[k] for k in members)
        points = np.concatenate([s.face_points for s in surfaces])
        return replace(
            self,
            surfaces=surfaces,
            triangles=tuple(self.triangles[k] for k in members),
            sources=tuple(self.sources[k] for k in members),
            bounds=tuple(self.bounds[k] for k in members),
            volume=np.nan,
            low=points.min(0),
            high=points.max(0),
        )

    def outward(self, index: int) -> tuple[Floats, Ints]:
        """Points and triangles of a surface, counter-clockwise as seen from outside.

        A surface that is inside out as a whole still has an outside.
        """
        triangles = self.triangles[index]
        if self.orientation(index) < 0.0:
            triangles = triangles[:, ::-1]
        return self.surfaces[index].points, triangles

    def orientation(self, index: int) -> float:
        """-1 for a surface that is inside out as a whole, else 1."""
        return -1.0 if self.surfaces[index].signed_volume < 0.0 else 1.0


def hole_fraction(points: Floats, triangles: Ints, edges: Ints | None = None) -> float:
    """Area of flat fans over the holes, over the area of surface and fans; 0 where closed.

    Each connected set of boundary edges is closed by triangles to its centroid.

    edges : (E, 2) `boundary_edges`, where they are known.
    """
    edges = boundary_edges(triangles) if edges is None else edges
    if len(edges) == 0:
        return 0.0
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    area = 0.5 * np.linalg.norm(cross(b - a, c - a), axis=1).sum()
    n = len(points)
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    label = components(graph)[1][edges[:, 0]]
    start, end = points[edges[:, 0]], points[edges[:, 1]]
    loop = np.unique(label, return_inverse=True)[1]
    count = np.bincount(loop)
    center = np.stack([np.bincount(loop, start[:, d]) / count for d in range(3)], 1)[loop]
    fan = 0.5 * np.linalg.norm(cross(start - center, end - center), axis=1).sum()
    return float(fan / (area + fan))


def build_solid(
    asset: Asset, *, repaired: bool = False, unfilled: Mapping[str, str] | None = None
) -> Solid:
    """Sort an asset's surfaces into those that bound a solid and those that are embedded in it.

    repaired : --repair was given, so that no hint names it.
    unfilled : prim paths of surfaces that bound none whatever their holes, and why.

    Raises InputError where none bounds a solid.
    """
    kept, triangles, sources, embedded = [], [], [], []
    for surface in asset.surfaces:
        welded, source, reason = closed_triangles(surface)
        reason = reason or (unfilled or {}).get(surface.path, "")
        if reason:
            embedded.append((surface.path, reason))
            continue
        kept.append(surface)
        triangles.append(welded)
        sources.append(source)
    if not kept:
        listed = "\n".join(f"  <{path}>: {reason}" for path, reason in embedded)
        raise InputError(
            f"{asset.facts.path}: no mesh encloses a volume, so nothing can be filled:\n{listed}",
            "close the holes or give the mesh thickness"
            + ("" if repaired else "; --repair makes open and flat sheets one spacing thick"),
        )
    points = np.concatenate([s.face_points for s in kept])
    low, high = points.min(0), points.max(0)
    partial = Solid(
        surfaces=tuple(kept), triangles=tuple(triangles), sources=tuple(sources), volume=0.0,
        bounds=tuple(Bounds(s.points, t) for s, t in zip(kept, triangles)),
        low=low, high=high, embedded=tuple(embedded),
    )  # fmt: skip
    return replace(partial, volume=_volume(partial, asset, repaired))


def closed_triangles(surface: Surface) -> tuple[Ints, Ints, str]:
    """Welded triangles, rows in `Surface.triangles`, and why they bound no solid, "" if they do."""
    welded, source = surface.welded.triangles, surface.welded.source
    if len(welded) == 0:
        return welded, source, "every face is collapsed"
    open_share = hole_fraction(surface.points, welded, surface.welded.boundary)
    if open_share > OPEN_FRACTION:
        edges, holes = len(surface.welded.boundary), surface.hole_faces
        reason = (
            f"the surface is open: {edges} boundary edges, holes of {100 * open_share:.0f} % of the"
            f" closed area (at most {100 * OPEN_FRACTION:.0f} %)"
        )
        if holes:
            are = "a hole" if holes == 1 else "holes"
            reason += f"; holeIndices of the mesh makes {holes} of its faces {are}"
        return welded, source, reason
    a, b, c = np.moveaxis(surface.points[welded], 1, 0)
    area = 0.5 * float(np.linalg.norm(cross(b - a, c - a), axis=1).sum())
    volume = abs(surface.signed_volume)
    if volume <= FLAT_FRACTION * area**1.5:
        return welded, source, f"it is flat: volume {volume:.3g} m^3 for an area of {area:.3g} m^2"
    return welded, source, ""


def mean_thickness(surface: Surface) -> float:
    """[m] 2 V / A of a surface: of a plate its thickness, of a long rod its radius.

    V is the sum of its shells, however each is wound: one half may be the other one mirrored.  Only
    a shell that faces away from the one around it is a cavity, whose volume is subtracted.
    """
    points, triangles, label = surface.points, surface.welded.triangles, surface.welded.shell
    area = float(areas(points, triangles).sum())
    if not area:
        return 0.0
    volume = volumes(points, triangles, label)
    size, outward = np.abs(volume), volume > 0.0
    if outward.any() and not outward.all():
        around = enclosing_parts(points, triangles, label, size)
        size[(around >= 0) & (outward != outward[around])] *= -1.0
    return 2.0 * max(float(size.sum()), 0.0) / area


def spread_evenly(count: int) -> NDArray[np.float64]:
    """(count, 3) quasirandom points of the unit cube: the R3 sequence (Roberts 2018).

    x_k = 1/2 + k (1/g, 1/g^2, 1/g^3) mod 1 with g^4 = g + 1.  A regular lattice would miss or count
    whole layers of solids with axis-aligned faces.
    """
    return (0.5 + np.arange(count)[:, None] / RECURRENCE ** np.arange(1, 4)) % 1.0


def _volume(solid: Solid, asset: Asset, repaired: bool) -> float:
    """Volume of the union [m^3].

    The volume of a single closed shell whose box overlaps no other is exact, by the divergence
    theorem. The others are grouped by overlapping boxes, and each group is sampled in its box.
    """
    total, counted = 0.0, []
    for members in np.split(*_by_box(solid)):
        if len(members) == 1 and _one_shell(solid.surfaces[members[0]].welded):
            total += abs(solid.surfaces[members[0]].signed_volume)
        else:
            counted.append(members)
    for members in counted:
        part = solid.part(members)
        size = part.high - part.low
        X = part.low + size * spread_evenly(max(LEAST_PROBES, PROBES // len(counted)))
        total += float(part.inside(X).mean() * np.prod(size))
    if total <= 0.0:
        raise InputError(
            f"{asset.facts.path}: none of {PROBES} tested points is inside its "
            f"{len(solid.surfaces)} surfaces",
            "the walls are thinner than a hundredth of the asset; give the mesh thickness"
            + ("" if repaired else ", or add --repair"),
        )
    return total


def _one_shell(welded: Welded) -> bool:
    return len(welded.boundary) == 0 and int(welded.shell.max()) == 0


def _by_box(solid: Solid) -> tuple[Ints, Ints]:
    """(S,) surfaces in order of groups of transitively overlapping boxes.

    Second: the start of each group but the first.  Boxes that touch, up to the rounding of float32
    where they are, do not overlap.
    """
    low = np.array([s.face_points.min(0) for s in solid.surfaces])
    high = np.array([s.face_points.max(0) for s in solid.surfaces])
    far, n = np.maximum(np.abs(low), np.abs(high)), len(low)
    one, two = [], []
    for k in range(n):
        shared = np.minimum(high, high[k]) - np.maximum(low, low[k])
        size = np.minimum(high - low, high[k] - low[k])
        rounding = ROUNDING * np.maximum(far, far[k])
        slack = np.clip(rounding, TOUCHING * size, MOST_TOUCHING * size)
        near = np.flatnonzero((shared > slack).all(1))
        one.append(np.full(len(near), k))
        two.append(near)
    rows, columns = np.concatenate(one), np.concatenate(two)
    label = components(coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n)))[1]
    order = np.argsort(label, kind="stable")
    return order, np.flatnonzero(np.diff(label[order])) + 1

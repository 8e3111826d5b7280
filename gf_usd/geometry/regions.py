"""Regions of pins: which points a region constrains, and the distance to its boundary.

A volume (a box, the inside of meshes) constrains the points in it. A patch of a surface constrains
the body at the patch only: a point is constrained if it is not inside the body and the patch is
the part of the surface nearest to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints, corners, cross
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.mesh.measures import areas
from gf_usd.core.mesh.topology import boundary_edges, weld
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Pin, Region
from gf_usd.geometry.solid import INSIDE, Solid
from gf_usd.geometry.thin.thicken import shells_of

BOX = "box:"
ON_SURFACE = 1e-6  # of the body's diagonal: a point nearer to the patch counts as on it
# Corners are numbered x + 2 y + 4 z; triangles are counter-clockwise seen from outside.
BOX_CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
BOX_TRIANGLES = np.array(
    [
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],
    ]
)  # fmt: skip


def parse_box(text: str, unit: float, option: str = "--pin") -> tuple[Floats, Floats]:
    """Low and high corner [m] of "box:x0,y0,z0,x1,y1,z1" in stage units of `unit` [m].

    option : the command-line option, for messages. Raises UsageError for any other text.
    """
    texts = text.removeprefix(BOX).split(",")
    try:
        numbers = np.array([float(word) for word in texts])
    except ValueError:
        numbers = np.full(6, np.nan)
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise UsageError(
            f"{option} {text} is not a box",
            f"give two corners in stage units: {option} box:-1,0,-1,1,0.2,1",
        )
    low, high = np.minimum(numbers[:3], numbers[3:]), np.maximum(numbers[:3], numbers[3:])
    if (high - low).min() <= 0.0:
        raise UsageError(
            f"{option} {text} has no volume: its sides are {(high - low).tolist()}",
            "give two opposite corners that differ along every axis",
        )
    return low * unit, high * unit


def box_region(
    text: str, unit: float, surfaces: Floats, path: Floats, option: str = "--pin"
) -> Region:
    """The region of a box.

    surfaces : (V, 3) [m] points of the body at rest; path : (F, V, 3) [m] at each frame. A box
    moves with at least three points in it, or with all points where it contains fewer.
    """
    low, high = parse_box(text, unit, option)
    corners = low + (high - low) * BOX_CORNERS
    if len(path) == 1:
        return Region(
            name=text, kind="volume", points=corners, triangles=BOX_TRIANGLES, path=corners[None]
        )
    inside = ((surfaces >= low) & (surfaces <= high)).all(1)
    chosen = np.flatnonzero(inside) if inside.sum() >= 3 else np.arange(len(surfaces))
    points = np.concatenate([corners, surfaces[chosen]])
    return Region(
        name=text,
        kind="volume",
        points=points,
        triangles=BOX_TRIANGLES,
        path=np.concatenate([np.broadcast_to(corners, (len(path), 8, 3)), path[:, chosen]], axis=1),
    )


PROBES = 12  # points along each edge of the box around a mesh, which tell whether it encloses any
FLAT = 1e-5  # of the largest extent: a mesh this thin lies in a plane


def part_of_joined(region: Region, solid: Solid) -> Region:
    """The region of a mesh, as a patch where the mesh is a part of a joined one and by itself
    encloses nothing, as one face of a box.
    """
    if region.kind != "volume" or not any(region.name in group for group in solid.joined):
        return region
    used, renumbered = np.unique(region.triangles, return_inverse=True)
    points = region.points[used]
    across = np.linalg.svd(points - points.mean(0), compute_uv=False)
    flat = across[-1] <= FLAT * across[0]  # where points of the lattice may lie in it exactly
    ticks = (np.arange(PROBES) + 0.5) / PROBES
    lattice = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), -1).reshape(-1, 3)
    inside = points.min(0) + np.ptp(points, axis=0) * lattice
    if not flat and Shape(region.points, region.triangles).encloses(inside).any():
        return region
    return replace(
        region, kind="patch", points=points, triangles=renumbered.reshape(-1, 3),
        path=region.path[:, used], body=region.name,
    )  # fmt: skip


def make_pin(
    region: Region, solid: Solid, drawn: Sequence[Surface] = (), option: str = "--pin"
) -> Pin:
    """The pin of a region.  Raises InputError for a patch of a surface that is not filled.

    drawn : the authored surfaces, where the solid has sheets that were thickened.
    """
    used = np.unique(region.triangles)
    anchors, path = region.points, region.path
    if region.name.startswith(BOX):
        used = np.arange(8, len(anchors)) if len(anchors) > 8 else used
        anchors, path = anchors[used], path[:, used]
    if region.kind == "volume":
        shape = Shape(region.points, region.triangles)
        holds, nearest = shape.encloses, shape.nearest
    else:
        at = _surface_of_patch(region, solid, option)
        part = _sheet_patch(region, solid, at, drawn) or _SolidPatch(region, solid, at)
        holds, nearest = part.holds, part.nearest
    return Pin(
        name=region.name, inside=holds, nearest=nearest, anchors=anchors, path=path,
        patch=region.kind == "patch",
    )  # fmt: skip


def make_rigid(region: Region, solid: Solid, drawn: Sequence[Surface] = ()) -> Pin:
    """A rigid region: the points that a volume encloses, or those nearest to a surface patch that
    are not in another surface only.

    drawn : as in `make_pin`.  Raises InputError for a patch of a surface that is not filled.
    """
    pin = make_pin(region, solid, drawn, "--rigid")
    inside = pin.inside
    if region.kind == "patch":
        at = _surface_of_patch(region, solid, "--rigid")
        sheet = _sheet_patch(region, solid, at, drawn)
        inside = sheet.holds if sheet else _nearest_to(region, solid, at)
    still = region.points[None]
    return replace(
        pin, inside=inside, anchors=still[0], path=still, sharp=False, rigid=True, patch=False
    )


def _surface_of_patch(region: Region, solid: Solid, option: str) -> int:
    """Index of the solid's surface that a patch is part of; raises InputError without one."""
    filled = solid.filled
    if region.body not in filled:
        raise InputError(
            f"{option} {region.name} is part of <{region.body}>, which is not filled",
            "name a part of a mesh that is filled, or a box",
        )
    return filled[region.body]


def _nearest_to(region: Region, solid: Solid, at: int) -> Callable[[Floats], Floats]:
    """A test of points X (n, 3) [m]: (n,) whether the patch is the nearest part of its surface, and
    no other surface alone encloses the point.
    """
    patch = Shape(region.points, region.triangles)
    whole = Shape(solid.surfaces[at].points, solid.triangles[at])
    return partial(_as_near, patch, whole, solid, _tolerance(solid))


def _as_near(patch: Shape, whole: Shape, solid: Solid, slack: float, X: Floats) -> Floats:
    """(n,) whether a patch is nearest to X (n, 3) [m], up to some slack [m], of a whole surface,
    and X is not in other surfaces of the solid only.

    Where surfaces touch, the nearest one is ambiguous: both are equally near.
    """
    out = np.asarray(patch.closest(X)[0] <= whole.closest(X)[0] + slack)
    near = np.flatnonzero(out)
    beyond = near[~whole.encloses(X[near])]
    out[beyond] = ~solid.inside(X[beyond])
    return out


def _tolerance(solid: Solid) -> float:
    """[m] distance up to which a point counts as on a surface."""
    return ON_SURFACE * float(np.linalg.norm(solid.high - solid.low))


class Shape:
    """Distance and inside queries of triangles, centered to keep precision far from the origin."""

    def __init__(self, points: Floats, triangles: Ints) -> None:
        self.center = points.mean(0)
        self._points = np.ascontiguousarray(points - self.center, dtype=float)
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int64)

    def closest(self, X: Floats) -> tuple[Floats, Floats]:
        """Distance (n,) [m] to the triangles and the closest points (n, 3) [m]."""
        if len(X) == 0:
            return np.zeros(0), np.zeros((0, 3))
        squared, _, nearest = igl.point_mesh_squared_distance(
            np.ascontiguousarray(X - self.center), self._points, self._triangles
        )
        return np.sqrt(np.asarray(squared).reshape(-1)), np.asarray(nearest) + self.center

    def closest_with_normal(self, X: Floats) -> tuple[Floats, Floats]:
        """The closest points (n, 3) [m], and the unit normals (n, 3) of their triangles."""
        if len(X) == 0:
            return np.zeros((0, 3)), np.zeros((0, 3))
        _, face, nearest = igl.point_mesh_squared_distance(
            np.ascontiguousarray(X - self.center), self._points, self._triangles
        )
        a, b, c = np.moveaxis(self._points[self._triangles[np.asarray(face).reshape(-1)]], 1, 0)
        normal = cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.asarray(nearest) + self.center, normal / np.where(length > 0.0, length, 1.0)

    def nearest(self, X: Floats) -> Floats:
        """(n, 3) [m] closest points on the triangles."""
        return self.closest(X)[1]

    def encloses(self, X: Floats) -> Floats:
        """(n,) True inside, by the generalized winding number."""
        if len(X) == 0:
            return np.zeros(0, bool)
        w = igl.fast_winding_number(self._points, self._triangles, X - self.center)
        return np.abs(np.asarray(w).reshape(-1)) > INSIDE

    def deepest(self, X: Floats) -> float:
        """[m] largest distance from the surface of those points X (n, 3) [m] that are inside; 0
        where none is."""
        low, high = corners(self._points + self.center)
        near = X[((low < X) & (high > X)).all(1)]
        inside = near[self.encloses(near)]
        return float(self.closest(inside)[0].max(initial=0.0))


class _SolidPatch:
    """The points that a patch of the surface of a solid constrains."""

    def __init__(self, region: Region, solid: Solid, at: int) -> None:
        self._patch = Shape(region.points, region.triangles)
        self._solid = solid
        self._own = _OwnSurface(solid, at)
        self._slack = _tolerance(solid)
        self.nearest = self._patch.nearest

    def holds(self, X: Floats) -> Floats:
        """(n,) True on the patch, and outside the solid where the patch is nearest."""
        away = self._patch.closest(X)[0]
        out = away <= self._slack
        rest = np.flatnonzero(~out)
        near = rest[away[rest] <= self._own.distance(X[rest]) + self._slack]
        near = near[self._own.nearest(X[near])]
        out[near] = ~self._solid.inside(X[near])
        return out


class _OwnSurface:
    """Distance queries to the surface that a patch is part of, and to the solid's others."""

    def __init__(self, solid: Solid, at: int) -> None:
        self._shape = Shape(solid.surfaces[at].points, solid.triangles[at])
        self.encloses = self._shape.encloses
        others = [k for k in range(len(solid.surfaces)) if k != at]
        self._others = [Shape(solid.surfaces[k].points, solid.triangles[k]) for k in others]
        self._slack = _tolerance(solid)

    def distance(self, X: Floats) -> Floats:
        """(n,) [m]."""
        return self._shape.closest(X)[0]

    def nearest(self, X: Floats) -> Floats:
        """(n,) whether no other surface is nearer, so that adjacent bodies are not constrained."""
        out = np.ones(len(X), bool)
        own = self.distance(X) if self._others else 0.0
        for other in self._others:
            out &= own <= other.closest(X)[0] + self._slack
        return out


ALONG = 0.1  # [thicknesses] tangential tolerance, where the sides of a plate are not parallel
ACROSS = 1.5  # [thicknesses] normal tolerance, where the thickness of a plate varies


def _sheet_patch(
    region: Region, solid: Solid, at: int, drawn: Sequence[Surface]
) -> _SheetPatch | None:
    """The patch as part of a thickened sheet, if most of its area is; else None."""
    sheet = next((s for s in drawn if s.path == region.body), None)
    if sheet is None:
        return None
    corners = region.points[region.triangles]
    off = _OwnSurface(solid, at).distance(corners.mean(1)) > _tolerance(solid)
    area = areas(region.points, region.triangles)
    return _SheetPatch(region, solid, at, sheet) if area[off].sum() > 0.5 * area.sum() else None


class _SheetPatch:
    """The points that a patch of a thickened sheet constrains: all of the layer at the patch."""

    def __init__(self, region: Region, solid: Solid, at: int, sheet: Surface) -> None:
        self._patch = Shape(region.points, region.triangles)
        self._sheet = Shape(sheet.points, sheet.triangles)
        self._solid = solid
        self._own = _OwnSurface(solid, at)
        self._slack = _tolerance(solid)
        self._thickness = _thickness_at(region, sheet)
        self._far = float(np.linalg.norm(solid.high - solid.low))
        edges = _inner_boundary(region, sheet, self._thickness, self._slack)
        # edges as triangles with two equal corners
        self._edges = Shape(region.points, edges[:, [0, 1, 1]]) if len(edges) else None

    def holds(self, X: Floats) -> Floats:
        """(n,) True where the nearest point of the sheet lies in the patch, or opposite to it on
        the other side of a plate, and no other surface is nearer."""
        at, normal = self._sheet.closest_with_normal(X)
        away = self._patch.nearest(at) - at
        across = np.abs(np.einsum("ni,ni->n", away, normal))
        along = np.sqrt(np.maximum(np.einsum("ni,ni->n", away, away) - across**2, 0.0))
        # the difference of squares has half of the digits
        out = along <= self._slack + ALONG * self._thickness
        out &= across <= self._slack + ACROSS * self._thickness
        rest = np.flatnonzero(out)
        rest = rest[~self._own.encloses(X[rest])]
        out[rest] = ~self._solid.inside(X[rest]) & self._own.nearest(X[rest])
        return out

    def nearest(self, X: Floats) -> Floats:
        """(n, 3) [m] nearest points on the border between the patch and the rest of the sheet.

        They are shifted along the sheet's normal to the offset of X, so that distances are measured
        along the sheet. Where the patch is the whole sheet they are one body diagonal away.
        """
        if self._edges is None:
            return X + self._far
        at, normal = self._sheet.closest_with_normal(X)
        edge = self._edges.nearest(at)
        along = edge - at
        if self._thickness > 0.0:  # the border may be on the other side of a plate
            along -= np.einsum("ni,ni->n", along, normal)[:, None] * normal
        shifted = at + along + np.einsum("ni,ni->n", X - at, normal)[:, None] * normal
        return np.where(self._own.nearest(X)[:, None], shifted, self._edges.nearest(X))


def _thickness_at(region: Region, sheet: Surface) -> float:
    """[m] authored thickness of a sheet at a patch: 0, or that of a thin plate."""
    seen = shells_of(sheet)
    shape = kd_tree(sheet.points[sheet.triangles[seen.source]].mean(1))
    label = seen.label[shape.query(region.points[region.triangles].mean(1))[1]]
    return float(seen.thickness[label].max())


def _inner_boundary(region: Region, sheet: Surface, thickness: float, slack: float) -> Ints:
    """(n, 2) edges, in points of the region, between a patch and the rest of its sheet."""
    welded, _ = weld(region.points)
    # the two coincident faces of a double-sided sheet count once
    faces = np.unique(np.sort(welded[region.triangles], axis=1), axis=0)
    halves = faces[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2)
    edges, first, uses = np.unique(halves, axis=0, return_index=True, return_counts=True)
    edges, opposite = edges[uses == 1], faces[:, [2, 0, 1]].reshape(-1)[first[uses == 1]]
    start, end = region.points[edges[:, 0]], region.points[edges[:, 1]]
    if thickness > 0.0:
        # at the rim of the plate, a step of one thickness out of the patch leaves the plate
        along = end - start
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), slack)
        out = start - region.points[opposite]
        out -= np.einsum("ni,ni->n", out, along)[:, None] * along
        out *= thickness / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), slack)
        step = 0.5 * (start + end) + out
        gap = Shape(sheet.points, sheet.triangles).closest(step)[0]
        return edges[gap < 0.5 * thickness]
    rim = boundary_edges(weld(sheet.points)[0][sheet.triangles])
    if not len(rim):
        return edges
    gap, _ = kd_tree(sheet.points[rim].mean(1)).query(0.5 * (start + end))
    return edges[gap > slack]

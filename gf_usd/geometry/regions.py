"""Pins: which points of a body a region holds, and where its boundary is.

A volume (a box, the inside of meshes) holds what lies in it.  A patch of a surface holds nothing
inside the body: the body is held at the patch itself, so a point is held if the patch is the part
of the surface nearest to it and it does not lie within the body.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import igl
import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.mesh import areas, boundary_edges, weld
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Pin, Region
from gf_usd.geometry.solid import INSIDE, Solid
from gf_usd.geometry.thin.thicken import measure_shells

BOX = "box:"
ON_SURFACE = 1e-6  # of the body's size: nearer than this a point lies on the patch
# Corners are numbered x + 2 y + 4 z; triangles look outward.
BOX_CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
BOX_TRIANGLES = np.array(
    [
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],
    ]
)  # fmt: skip


def parse_box(text: str, unit: float, option: str = "--pin") -> tuple[Floats, Floats]:
    """Low and high corner [m] of "box:x0,y0,z0,x1,y1,z1" in stage units of `unit` [m].

    option : that names it, for messages.  Raises UsageError for anything else.
    """
    words = text.removeprefix(BOX).split(",")
    try:
        numbers = np.array([float(word) for word in words])
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
    """The region of a box; the points (V, 3) of the body move along path (F, V, 3), and it with
    those that lie in it (or, where none does, with the nearest ones).
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


def make_pin(
    region: Region, solid: Solid, drawn: Sequence[Surface] = (), option: str = "--pin"
) -> Pin:
    """The pin of a region.  Raises InputError for a patch of something that is not filled.

    drawn : the surfaces as they are drawn, where the solid has sheets that were given thickness.
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
        at = _filled_by(region, solid, option)
        part = _sheet_part(region, solid, at, drawn) or _Patch(region, solid, at)
        holds, nearest = part.holds, part.nearest
    return Pin(
        name=region.name, inside=holds, nearest=nearest, anchors=anchors, path=path,
        patch=region.kind == "patch",
    )  # fmt: skip


def make_rigid(region: Region, solid: Solid, drawn: Sequence[Surface] = ()) -> Pin:
    """A rigid region: what a volume encloses, or all that is nearest to a patch of the surface.

    drawn : as of `make_pin`.  Raises InputError for a patch of something that is not filled.
    """
    pin = make_pin(region, solid, drawn, "--rigid")
    inside = pin.inside
    if region.kind == "patch":
        at = _filled_by(region, solid, "--rigid")
        sheet = _sheet_part(region, solid, at, drawn)
        inside = sheet.holds if sheet else _nearest_to(region, solid, at)
    still = region.points[None]
    return replace(
        pin, inside=inside, anchors=still[0], path=still, sharp=False, rigid=True, patch=False
    )


def _filled_by(region: Region, solid: Solid, option: str) -> int:
    """The surface of the solid that a patch is part of; raises InputError where there is none."""
    paths = [s.path for s in solid.surfaces]
    if region.body not in paths:
        raise InputError(
            f"{option} {region.name} is part of <{region.body}>, which is not filled",
            "name a part of a mesh that is filled, or a box",
        )
    return paths.index(region.body)


def _nearest_to(region: Region, solid: Solid, at: int) -> Callable[[Floats], Floats]:
    """Whether points X (n, 3) [m] are nearer to a patch than to the rest of its surface."""
    patch = Shape(region.points, region.triangles)
    whole = Shape(solid.surfaces[at].points, solid.triangles[at])
    slack = _slack(solid)
    return lambda X: np.asarray(patch.closest(X)[0] <= whole.closest(X)[0] + slack)


def _slack(solid: Solid) -> float:
    """[m] at which a point lies on a surface."""
    return ON_SURFACE * float(np.linalg.norm(solid.high - solid.low))


class Shape:
    """Triangles to ask for distances; centered, so that far from the origin no digits are lost."""

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
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.asarray(nearest) + self.center, normal / np.where(length > 0.0, length, 1.0)

    def nearest(self, X: Floats) -> Floats:
        """(n, 3) [m] on the triangles."""
        return self.closest(X)[1]

    def encloses(self, X: Floats) -> Floats:
        """(n,) inside, by the winding number."""
        if len(X) == 0:
            return np.zeros(0, bool)
        w = igl.fast_winding_number(self._points, self._triangles, X - self.center)
        return np.abs(np.asarray(w).reshape(-1)) > INSIDE


class _Patch:
    """What a part of the surface of a solid holds."""

    def __init__(self, region: Region, solid: Solid, at: int) -> None:
        self._patch = Shape(region.points, region.triangles)
        self._solid = solid
        self._own = _OwnSurface(solid, at)
        self._slack = _slack(solid)
        self.nearest = self._patch.nearest

    def holds(self, X: Floats) -> Floats:
        """(n,) on the patch, or outside the solid with the patch nearest."""
        away = self._patch.closest(X)[0]
        out = away <= self._slack
        rest = np.flatnonzero(~out)
        near = rest[away[rest] <= self._own.distance(X[rest]) + self._slack]
        near = near[self._own.nearest(X[near])]
        out[near] = ~self._solid.inside(X[near])
        return out


class _OwnSurface:
    """One surface of a solid among the others."""

    def __init__(self, solid: Solid, at: int) -> None:
        self._shape = Shape(solid.surfaces[at].points, solid.triangles[at])
        self.encloses = self._shape.encloses
        others = [k for k in range(len(solid.surfaces)) if k != at]
        self._others = [Shape(solid.surfaces[k].points, solid.triangles[k]) for k in others]
        self._slack = _slack(solid)

    def distance(self, X: Floats) -> Floats:
        """(n,) [m]."""
        return self._shape.closest(X)[0]

    def nearest(self, X: Floats) -> Floats:
        """(n,) whether none of the others is nearer: a body next to this one is not held by it."""
        out = np.ones(len(X), bool)
        own = self.distance(X) if self._others else 0.0
        for other in self._others:
            out &= own <= other.closest(X)[0] + self._slack
        return out


ALONG = 0.1  # thicknesses: sides of a plate may slope so much
ACROSS = 1.5  # thicknesses: from one side of a plate to the other, where it is not even


def _sheet_part(
    region: Region, solid: Solid, at: int, drawn: Sequence[Surface]
) -> _SheetPart | None:
    """What a patch holds if most of it lies within a sheet that was given thickness, else None."""
    sheet = next((s for s in drawn if s.path == region.body), None)
    if sheet is None:
        return None
    corners = region.points[region.triangles]
    off = _OwnSurface(solid, at).distance(corners.mean(1)) > _slack(solid)
    area = areas(region.points, region.triangles)
    return _SheetPart(region, solid, at, sheet) if area[off].sum() > 0.5 * area.sum() else None


class _SheetPart:
    """What a part of a sheet holds: all of the flesh that the sheet was given there."""

    def __init__(self, region: Region, solid: Solid, at: int, sheet: Surface) -> None:
        self._patch = Shape(region.points, region.triangles)
        self._sheet = Shape(sheet.points, sheet.triangles)
        self._solid = solid
        self._own = _OwnSurface(solid, at)
        self._slack = _slack(solid)
        self._thickness = _thickness_at(region, sheet)
        self._far = float(np.linalg.norm(solid.high - solid.low))
        edges = _inner_boundary(region, sheet, self._thickness, self._slack)
        # an edge is a triangle with two corners in one place
        self._edges = Shape(region.points, edges[:, [0, 1, 1]]) if len(edges) else None

    def holds(self, X: Floats) -> Floats:
        """(n,) the nearest point of the sheet lies in the patch, or on the back of a plate there,
        and no other surface is in between."""
        at, normal = self._sheet.closest_with_normal(X)
        away = self._patch.nearest(at) - at
        across = np.abs(np.einsum("ni,ni->n", away, normal))
        along = np.sqrt(np.maximum(np.einsum("ni,ni->n", away, away) - across**2, 0.0))
        # squares of the nearest points lose half of the digits
        out = along <= self._slack + ALONG * self._thickness
        out &= across <= self._slack + ACROSS * self._thickness
        rest = np.flatnonzero(out)
        rest = rest[~self._own.encloses(X[rest])]
        out[rest] = ~self._solid.inside(X[rest]) & self._own.nearest(X[rest])
        return out

    def nearest(self, X: Floats) -> Floats:
        """(n, 3) [m] where the rest of the sheet begins, as far from it along its normal as X.

        Far away where the patch is all of the sheet.  Points of other surfaces have no part in it.
        """
        if self._edges is None:
            return X + self._far
        at, normal = self._sheet.closest_with_normal(X)
        edge = self._edges.nearest(at)
        along = edge - at
        if self._thickness > 0.0:  # seen from the back of a plate too
            along -= np.einsum("ni,ni->n", along, normal)[:, None] * normal
        beside = at + along + np.einsum("ni,ni->n", X - at, normal)[:, None] * normal
        return np.where(self._own.nearest(X)[:, None], beside, self._edges.nearest(X))


def _thickness_at(region: Region, sheet: Surface) -> float:
    """[m] that a sheet has of itself where a patch is: 0, or that of a thin plate."""
    seen = measure_shells(sheet)
    shape = kd_tree(sheet.points[sheet.triangles[seen.source]].mean(1))
    label = seen.label[shape.query(region.points[region.triangles].mean(1))[1]]
    return float(seen.thickness[label].max())


def _inner_boundary(region: Region, sheet: Surface, thickness: float, slack: float) -> Ints:
    """Edges (n, 2) of a patch, points of the region, at which the sheet goes on."""
    welded, _ = weld(region.points)
    # faces of the front and the back of a sheet that is modeled with both are one
    faces = np.unique(np.sort(welded[region.triangles], axis=1), axis=0)
    halves = faces[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2)
    edges, first, uses = np.unique(halves, axis=0, return_index=True, return_counts=True)
    edges, opposite = edges[uses == 1], faces[:, [2, 0, 1]].reshape(-1)[first[uses == 1]]
    start, end = region.points[edges[:, 0]], region.points[edges[:, 1]]
    if thickness > 0.0:
        # the sides of a plate are its rim: a step out of the patch does not end on the plate
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

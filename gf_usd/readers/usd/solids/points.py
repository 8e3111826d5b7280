"""Surface reconstruction around the balls of a Points prim.

The body is the morphological closing (Serra 1982), by a ball of radius c, of the union of the balls
|x - p| <= w / 2 with points p and widths w: it contains x unless a ball of radius c around some
point contains x and intersects none of them.  Cavities are filled.  On a grid of edge h,

    f(x) = min_p (|x - p| - w_p / 2),    D = {f <= c} filled,    body = {x in D: dist(x, dD) >= c}

c is twice the median distance between neighbors, and at most the median width, so that separate
balls are not merged.  Dimples between neighbors are smoothed by a Gaussian of BLUR cells.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import proper, weld
from gf_usd.core.neighbors import kd_tree
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.stage import SkippedPrim
from gf_usd.readers.usd_physics.attributes import SOFT_BODIES, apis, body_of

CELLS = 96  # along the longest side, at most
FEWEST = 24  # along the longest side, at least
BLUR = 1.5  # [cells]
APART = 3.0  # [radii] distance between neighbors from which they are separate balls
NEAR = 8  # nearest balls, of about one size, that are evaluated at a point
PARTICLES = ("Newton", "Physx", "OmniPhysics", "PhysicsDeformable")  # prefixes of particle APIs


def is_body(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a Points prim is a body: it has widths, or an API of particles or deformables."""
    if any(attribute.HasAuthoredValue() for attribute in _widths_of(prim)):
        return True
    if any(name.startswith(PARTICLES) for name in apis(prim)):
        return True
    body = body_of(prim, time)
    return body is not None and bool(apis(body) & SOFT_BODIES.keys())


def widths(prim: Usd.Prim, points: Floats, time: Usd.TimeCode, notes: Notes) -> Floats:
    """(n,) positive widths in local units; where none are authored, from the spacing of the points.

    Raises SkippedPrim where neither gives a size.
    """
    where, count = str(prim.GetPath()), len(points)
    for attribute in _widths_of(prim):
        value = attribute.Get(time) if attribute.HasAuthoredValue() else None
        if value is None or not len(np.atleast_1d(value)):
            continue
        found = np.atleast_1d(np.asarray(value, dtype=np.float64))
        if len(found) not in (1, count) or not (np.isfinite(found) & (found > 0.0)).all():
            raise SkippedPrim(
                f"its {len(found)} widths are not valid: it needs one, or one for each of "
                f"{count} points, above 0"
            )
        return np.broadcast_to(found, (count,))
    if count < 2 or not (spacing := _spacing(points)) > 0.0:
        raise SkippedPrim(f"has {count} points in one place and no widths")
    notes.add(
        f"no widths are authored: the distance between neighbors, {spacing:.3g}, is used", where
    )
    return np.full(count, spacing)


def cover(points: Floats, wide: Floats) -> tuple[NDArray[np.float64], Ints]:
    """Vertices (V, 3) and outward-facing triangles (T, 3) of the surface around balls.

    points : (n, 3); wide : (n,) positive widths.  Raises SkippedPrim where the surface is empty.
    """
    points, radii = np.asarray(points, np.float64), np.asarray(wide, np.float64) / 2.0
    typical = float(np.median(radii))
    spacing = _spacing(points) if len(points) > 1 else 0.0
    low, high = (points - radii[:, None]).min(0), (points + radii[:, None]).max(0)
    side = float((high - low).max())
    h = max(side / CELLS, min(typical / 2.0, side / FEWEST))
    reach = max(min(2.0 * spacing, 2.0 * typical), h)
    margin = reach + 3.0 * h
    shape = np.ceil((high - low + 2.0 * margin) / h).astype(int) + 1
    axes = [low[d] - margin + h * np.arange(shape[d]) for d in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    f = _distance(nodes.reshape(-1, 3), points, radii, margin).reshape(shape)
    f = _without_cavities(f, reach, h)
    outer, faces = _contour(f - reach, nodes, h)
    inside = f <= reach
    depth = _to_surface(nodes[inside], outer, faces)
    g = -f  # outside D: f - reach is the distance to it
    g[inside] = depth - reach
    if spacing < APART * typical:
        from scipy import ndimage

        # Dimples between balls would be taken for thin parts of the body, with small particles.
        g = ndimage.gaussian_filter(g, BLUR)
    vertices, triangles = _contour(-g, nodes, h)
    if len(triangles) == 0:
        raise SkippedPrim(f"no surface could be constructed around its {len(points)} points")
    return vertices, triangles


def _widths_of(prim: Usd.Prim) -> list[Usd.Attribute]:
    """The attributes of widths; the primvar takes precedence, as in UsdGeomPoints."""
    found = (UsdGeom.PrimvarsAPI(prim).GetPrimvar("widths").GetAttr(), prim.GetAttribute("widths"))
    return [attribute for attribute in found if attribute]


def _spacing(points: Floats) -> float:
    """Median distance to the nearest other point."""
    return float(np.median(kd_tree(points).query(points, k=2)[0][:, 1]))


def _distance(x: Floats, points: Floats, radii: Floats, most: float) -> NDArray[np.float64]:
    """(m,) f at x (m, 3), at most `most`."""
    f = np.full(len(x), most)
    size = np.floor(np.log2(radii))
    for one in np.unique(size):
        mine = np.flatnonzero(size == one)
        reach = most + float(radii[mine].max())
        many = min(NEAR if np.ptp(radii[mine]) else 1, len(mine))
        away, which = kd_tree(points[mine]).query(
            x, k=np.arange(1, many + 1), distance_upper_bound=reach
        )
        found = np.append(radii[mine], 0.0)[which]  # `which` is len(mine) where none is near
        f = np.minimum(f, (away - found).min(axis=1))
    return f


def _without_cavities(f: Floats, level: float, h: float) -> NDArray[np.float64]:
    """f with the cavities of {f <= level} filled."""
    from scipy import ndimage

    label: Any = ndimage.label  # its stub returns no pair
    outside = label(f > level)[0]
    closed = (f > level) & (outside != outside[0, 0, 0])
    return np.where(closed, level - h, f)


def _contour(f: Floats, nodes: Floats, h: float) -> tuple[NDArray[np.float64], Ints]:
    """Vertices and triangles of f = 0, outward where f grows outward, by marching cubes."""
    import igl

    n = f.shape
    # igl expects x to vary fastest
    order = (2, 1, 0)
    values = np.ascontiguousarray(f.transpose(order)).ravel()
    at = np.ascontiguousarray(nodes.transpose(*order, 3)).reshape(-1, 3)
    march: Any = igl.marching_cubes  # its stub rejects unpacked sizes
    made = march(values, at, *map(int, n), 0.0)
    points = np.asarray(made[0], np.float64).reshape(-1, 3)
    triangles = np.asarray(made[1], np.int64).reshape(-1, 3)
    if len(triangles) == 0:
        return points, triangles
    # triangles are degenerate where the surface passes through a grid point
    one, _ = weld(points, 1e-6 * h)
    triangles = one[triangles]
    triangles = triangles[proper(triangles)]
    used, inner = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], inner.reshape(-1, 3)
    if signed_volume(points, triangles) < 0.0:
        triangles = triangles[:, ::-1].copy()
    return points, triangles


def _to_surface(x: Floats, points: Floats, triangles: Ints) -> NDArray[np.float64]:
    """(m,) distances of points x (m, 3) from triangles."""
    import igl

    center = points.mean(0)
    found: Any = igl.point_mesh_squared_distance(x - center, points - center, triangles)
    return np.sqrt(np.asarray(found[0], np.float64).reshape(-1))

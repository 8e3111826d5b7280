"""Closest-point queries on the surfaces of a solid, with normals and colors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.asset import NO_COLOR, Texture
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.geometry.solid import ROUNDING, Solid


@dataclass(frozen=True, kw_only=True)
class Nearest:
    """Nearest surface points of a set of points."""

    surface: Ints  # (n,) index into Solid.surfaces
    triangle: Ints  # (n,) row in that surface's triangles
    barycentric: Floats  # (n, 3)
    normal: Floats  # (n, 3) unit, outward
    distance: Floats  # (n,) [m]


def nearest(solid: Solid, X: Floats) -> Nearest:
    """Nearest points of the solid's surfaces for points X (n, 3) [m]."""
    counts = [len(s.points) for s in solid.surfaces]
    first = np.cumsum([0, *counts])
    points = np.concatenate([s.points for s in solid.surfaces])
    center = points.mean(0)
    points = points - center
    faces = np.concatenate([t + o for t, o in zip(solid.triangles, first)])
    owner = np.repeat(np.arange(len(counts)), [len(t) for t in solid.triangles])
    source = np.concatenate(solid.sources)
    found: Any = igl.point_mesh_squared_distance(X - center, points, faces)
    squared, at, closest = found
    a, b, c = np.moveaxis(points[faces[at]], 1, 0)
    n = cross(b - a, c - a)
    length = np.linalg.norm(n, axis=1, keepdims=True)
    n = n / np.where(length > 0.0, length, 1.0)
    # The normals of a surface that is inside out as a whole are negated.
    sign = np.array([solid.orientation(k) for k in range(len(solid.surfaces))])
    return Nearest(
        surface=owner[at],
        triangle=source[at],
        barycentric=barycentric(closest, a, b, c),
        normal=n * sign[owner[at], None],
        distance=np.sqrt(np.maximum(squared, 0.0)),
    )


def nearest_own(solid: Solid, X: Floats) -> Nearest:
    """Nearest points of the surfaces that points X (n, 3) [m] belong to.

    A point belongs to the nearest of the surfaces that enclose it, or of all where none does.  Only
    points in the box of another surface than the nearest one can be enclosed by another.
    """
    at = nearest(solid, X)
    surfaces, count = solid.surfaces, len(solid.surfaces)
    if count < 2:
        return at
    low = np.array([s.face_points.min(0) for s in surfaces])
    high = np.array([s.face_points.max(0) for s in surfaces])
    rounding = ROUNDING * float(np.maximum(np.abs(low), np.abs(high)).max())  # [m]
    first = at.surface.copy()
    for k in range(count):
        meet = ((low <= high[k] + rounding) & (high >= low[k] - rounding)).all(1)
        others = [int(j) for j in np.flatnonzero(meet) if j != k]
        mine = np.flatnonzero(first == k) if others else np.zeros(0, np.int64)
        boxed = {j: ((low[j] <= X[mine]) & (X[mine] <= high[j])).all(1) for j in others}
        some = np.any([*boxed.values(), np.zeros(len(mine), bool)], axis=0)
        strays = np.zeros(len(mine), bool)
        strays[some] = ~solid.bounds[k].inside(X[mine[some]])
        away = np.full(len(mine), np.inf)
        for j in others:
            rows = np.flatnonzero(strays & boxed[j])
            rows = rows[solid.bounds[j].inside(X[mine[rows]])]
            if len(rows):
                own = nearest(solid.part(np.array([j])), X[mine[rows]])
                closer = own.distance < away[rows]
                away[rows[closer]] = own.distance[closer]
                _replace(at, mine[rows[closer]], j, own, closer)
    return at


def _replace(at: Nearest, rows: Ints, surface: int, own: Nearest, which: NDArray[np.bool_]) -> None:
    at.surface[rows] = surface
    at.triangle[rows], at.barycentric[rows] = own.triangle[which], own.barycentric[which]
    at.normal[rows], at.distance[rows] = own.normal[which], own.distance[which]


def barycentric(p: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """(n, 3) barycentric coordinates of p in triangles abc; a corner for degenerate triangles."""
    u, v, w = b - a, c - a, p - a
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    wu, wv = (w * u).sum(1), (w * v).sum(1)
    det = uu * vv - uv * uv
    flat = det <= 1e-30
    det = np.where(flat, 1.0, det)
    s = np.where(flat, 0.0, (vv * wu - uv * wv) / det)
    t = np.where(flat, 0.0, (uu * wv - uv * wu) / det)
    out = np.clip(np.stack([1.0 - s - t, s, t], 1), 0.0, 1.0)
    return out / out.sum(1, keepdims=True)


def colors(solid: Solid, at: Nearest) -> NDArray[np.float64]:
    """(n, 3) linear colors at nearest points.

    In this order of precedence: texture of the bound material, its constant color, displayColor,
    mid gray.
    """
    out = np.tile(NO_COLOR, (len(at.triangle), 1))
    for index, surface in enumerate(solid.surfaces):
        mine = np.flatnonzero(at.surface == index)
        if len(mine) == 0:
            continue
        triangle, weight = at.triangle[mine], at.barycentric[mine]
        if surface.triangle_colors is not None:
            out[mine] = np.einsum("nk,nkc->nc", weight, surface.triangle_colors[triangle])
        if surface.triangle_materials is None:
            continue
        bound = surface.triangle_materials[triangle]
        for number, material in enumerate(surface.materials):
            here = bound == number
            if not here.any():
                continue
            if material.texture is not None and surface.triangle_uvs is not None:
                uv = np.einsum("nk,nkc->nc", weight[here], surface.triangle_uvs[triangle[here]])
                out[mine[here]] = sample(material.texture, uv)
            else:
                out[mine[here]] = material.color
    return out


def sample(texture: Texture, uv: Floats) -> NDArray[np.float64]:
    """(n, 3) linear texture colors at uv (n, 2), bilinear; v grows upward from the last row."""
    height, width = texture.pixels.shape[:2]
    x = uv[:, 0] * width - 0.5
    y = (1.0 - uv[:, 1]) * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]

    def pixel(ix: Ints, iy: Ints) -> NDArray[np.float64]:
        jx, okx = _wrap(ix, width, texture.wrap_s)
        jy, oky = _wrap(iy, height, texture.wrap_t)
        value = texture.pixels[jy, jx, :3].astype(float) / 255.0
        value = srgb_to_linear(value) if texture.srgb else value
        return np.where((okx & oky)[:, None], value, 0.0)

    top = pixel(x0, y0) * (1 - fx) + pixel(x0 + 1, y0) * fx
    low = pixel(x0, y0 + 1) * (1 - fx) + pixel(x0 + 1, y0 + 1) * fx
    return top * (1 - fy) + low * fy


def _wrap(i: Ints, n: int, mode: str) -> tuple[Ints, NDArray[np.bool_]]:
    """Texel index under a wrap mode, and whether the texel exists."""
    inside = (i >= 0) & (i < n)
    if mode == "clamp":
        return np.clip(i, 0, n - 1), np.ones_like(inside)
    if mode == "mirror":
        j = np.mod(i, 2 * n)
        return np.where(j < n, j, 2 * n - 1 - j), np.ones_like(inside)
    if mode == "black":
        return np.clip(i, 0, n - 1), inside
    return np.mod(i, n), np.ones_like(inside)

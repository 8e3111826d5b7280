"""Contact samples: points on the surface of each body, about one spacing apart (Poisson disks).

Sampling is deterministic, and symmetric across the mirror planes of a body (`mirror`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.arrays import corners as outermost
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.mesh.topology import first_equal, used_points
from gf_usd.core.neighbors import kd_tree
from gf_usd.geometry.sampling.holes import capped
from gf_usd.geometry.sampling.mirror import SAME, mirror_axes
from gf_usd.geometry.sampling.particles import TURNS
from gf_usd.geometry.sampling.pieces import cut_along
from gf_usd.geometry.solid import Solid

EXCLUDED = 0.7  # [spacings] least distance of two samples that are not on opposite walls of a gap
OPPOSED = 0.5  # least negated cosine of the normals of two opposite walls
FEW = 16  # nearest samples that are searched for one on the same wall
DENSITY = 12.0  # candidates per square of a spacing
LEAST_DRAWS = 64  # candidates on a surface
ALIKE = 0.1  # [spacings] tolerance of mirror symmetry, for differently triangulated polygons
PLASTIC = 1.3247179572447460  # plastic number, x^3 = x + 1, of the R2 sequence (Roberts 2018)


@dataclass(frozen=True, kw_only=True)
class _Candidates:
    """Candidate points on a surface, in order of preference."""

    X: Floats  # (n, 3) [m]
    normal: Floats  # (n, 3) of any length
    area: Floats  # (n,) [m^2] of the surface that each represents


def sample_surface(
    solid: Solid, spacing: float, bodies: Ints | None = None, up: str = "Y"
) -> SurfaceSamples:
    """Contact samples about a spacing [m] apart; corners of a coarse mesh are among them.

    Candidates are the vertices, then points distributed by area, also on the caps of holes
    (`holes`).  The samples are a maximal subset of them with distances of at least 0.7 spacings.
    The two walls of a narrow gap are sampled independently.  The area of a sample is the sum over
    the candidates nearest to it.

    bodies : (S,) the body of each surface, each sampled by itself; None: all are one.
    """
    body = np.zeros(len(solid.surfaces), np.int64) if bodies is None else bodies
    turn = TURNS[up]
    kept: list[tuple[Floats, Floats, Floats]] = []
    for k in range(int(body.max()) + 1):
        members = np.flatnonzero(body == k)
        own, whole = (
            [(p @ turn.T, t) for p, t in parts]
            for parts in (
                [solid.outward(int(s)) for s in members],
                [capped(solid, int(s), members, spacing) for s in members],
            )
        )
        kept.append(_sample_body(own, whole, spacing))
    X, area, normal = (np.concatenate(part) for part in zip(*kept))
    of = np.repeat(np.arange(len(kept)), [len(part[0]) for part in kept])
    return SurfaceSamples(
        X=X @ turn, area=area, normal=normal @ turn, body=None if bodies is None else of
    )


def _sample_body(
    own: Sequence[tuple[Floats, Ints]], surfaces: Sequence[tuple[Floats, Ints]], spacing: float
) -> tuple[Floats, Floats, Floats]:
    """Positions (n, 3) [m], areas (n,) [m^2] and normals (n, 3) of the samples of a body.

    own, surfaces : points and triangles of each; the same with caps, which are not considered for
    symmetry.

    Of a symmetric body one half is sampled, with points on the mirror plane itself.  Candidates so
    near to the plane that they would exclude their own mirror images come last: they are needed
    where the body is that thin.
    """
    ends = np.array([outermost(p[used_points(t)[0]]) for p, t in surfaces])
    low, high = ends[:, 0].min(0), ends[:, 1].max(0)
    middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
    mirrored = np.flatnonzero(mirror_axes(own, ALIKE * spacing))
    radius = EXCLUDED * spacing
    corners, vertices = [], []
    for points, triangles in surfaces:
        local = points - middle
        corners.append(_one_side(local[triangles], mirrored, size))
        vertices.append(_vertices(local, triangles))
    every = [
        *vertices,
        *(_rim(one, int(axis), spacing) for axis in mirrored for one in corners),
        *(_draws(one, spacing) for one in corners),
    ]
    X, normal, area = (
        np.concatenate([getattr(one, name) for one in every]) for name in ("X", "normal", "area")
    )
    for axis in mirrored:
        on_plane = np.abs(X[:, axis]) <= SAME * size
        X[on_plane, axis] = 0.0
        normal[on_plane, axis] = 0.0
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(length > 0.0, length, 1.0)
    sides = X[:, mirrored]
    free = ((sides == 0.0) | (sides > 0.5 * radius)).all(1)
    chosen = np.flatnonzero(free)
    chosen = chosen[thin(X[chosen], radius, normal[chosen])]
    near = np.flatnonzero(~free & (sides >= 0.0).all(1))
    if len(chosen) and len(near):
        near = near[_nearest(X, normal, near, chosen)[0] > radius]
    chosen = np.concatenate([chosen, near[thin(X[near], radius, normal[near])]])
    drawn = np.flatnonzero(area > 0.0)
    share = np.bincount(_nearest(X, normal, drawn, chosen)[1], area[drawn], len(chosen))
    chosen, area = chosen[share > 0.0], share[share > 0.0]
    X, normal = X[chosen], normal[chosen]
    for axis in mirrored:
        flip = np.where(np.arange(3) == axis, -1.0, 1.0)
        off = X[:, axis] > 0.0
        area = np.concatenate([np.where(off, 1.0, 2.0) * area, area[off]])
        normal = np.concatenate([normal, normal[off] * flip])
        X = np.concatenate([X, X[off] * flip])
    return middle + X, area, normal


def _one_side(corners: Floats, mirrored: Ints, size: float) -> NDArray[np.float64]:
    """Triangles (n, 3, 3) clipped to the upper side of the mirror planes through 0."""
    # `cut_along` clips at integers: scaled so that only 0 is within the body.
    corners, rows = corners / (2.0 * size), np.arange(len(corners))
    for axis in mirrored:
        corners, rows = cut_along(corners, rows, int(axis))
        corners = corners[corners[:, :, axis].mean(1) > 0.0]
        rows = np.arange(len(corners))
    return 2.0 * size * corners


def _cross(corners: Floats) -> Floats:
    """(n, 3) normals of triangles, of length twice the area."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return cross(b - a, c - a)


def _areas(corners: Floats) -> Floats:
    """(n,)"""
    return 0.5 * np.linalg.norm(_cross(corners), axis=1)


def _vertices(points: Floats, triangles: Ints) -> _Candidates:
    """Vertices, with area-weighted vertex normals."""
    corner = triangles.T.reshape(-1)
    around = np.stack(
        [np.bincount(corner, np.tile(n, 3), len(points)) for n in _cross(points[triangles]).T], 1
    )
    used = used_points(triangles)[0]
    return _Candidates(X=points[used], normal=around[used], area=np.zeros(len(used)))


def _draws(corners: Floats, spacing: float) -> _Candidates:
    """Points distributed over triangles (n, 3, 3), each for the same area."""
    area = _areas(corners)
    if area.sum() <= 0.0:
        return _Candidates(X=np.zeros((0, 3)), normal=np.zeros((0, 3)), area=np.zeros(0))
    count = max(LEAST_DRAWS, int(np.ceil(DENSITY * area.sum() / spacing**2)))
    # Stratified along the cumulative area.
    at = (np.arange(count) + 0.5) / count * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), at), len(area) - 1)
    r = (0.5 + np.arange(count)[:, None] / PLASTIC ** np.arange(1, 3)) % 1.0
    flip = r.sum(1) > 1.0
    r[flip] = 1.0 - r[flip]
    a, b, c = np.moveaxis(corners[face], 1, 0)
    X = a + r[:, :1] * (b - a) + r[:, 1:] * (c - a)
    share = np.full(count, area.sum() / count)
    return _Candidates(X=X, normal=_cross(corners)[face], area=share)


def _rim(corners: Floats, axis: int, spacing: float) -> _Candidates:
    """Points on the edges of triangles (n, 3, 3) in the mirror plane through 0."""
    normal = _cross(corners)
    X, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        mine = np.flatnonzero((start[:, axis] == 0.0) & (end[:, axis] == 0.0))
        length = np.linalg.norm(end[mine] - start[mine], axis=1)
        steps = np.ceil(np.sqrt(DENSITY) * length / spacing).astype(int) + 1
        row = np.repeat(mine, steps)
        t = np.concatenate([np.linspace(0.0, 1.0, n) for n in steps] or [np.zeros(0)])[:, None]
        X.append(start[row] + t * (end - start)[row])
        normals.append(normal[row])
    places = np.concatenate(X)
    return _Candidates(X=places, normal=np.concatenate(normals), area=np.zeros(len(places)))


def thin(points: Floats, radius: float, normal: Floats | None = None) -> Ints:
    """Indices of a maximal subset of points with distances of at least radius [m].

    Points earlier in the order are preferred.
    normal : (n, 3) unit or 0; points on opposite walls of a gap do not exclude each other.
    """
    kept = np.zeros(0, np.int64)
    left = np.arange(len(points))
    while len(left):
        kept = np.concatenate([kept, left[_thin_once(points[left], radius)]])
        left = left[kd_tree(points[kept]).query(points[left])[0] > radius]
    if normal is None or len(kept) == 0:
        return kept
    left = np.arange(len(points))
    while len(left := left[_nearest(points, normal, left, kept)[0] > radius]):
        kept = np.concatenate([kept, left[_thin_once(points[left], radius)]])
    return kept


def _nearest(X: Floats, normal: Floats, rows: Ints, of: Ints) -> tuple[Floats, Ints]:
    """(k,) [m] distances of points `rows` (k,) to the nearest of points `of` (m,) that is not on
    the opposite wall of a gap, and (k,) its index in `of`.

    Only the FEW nearest are searched; where all of them are on the opposite wall, the distance is
    inf and the index that of the nearest.
    """
    tree = kd_tree(X[of])
    distance, at = tree.query(X[rows])
    across = np.flatnonzero(_across(X, normal, rows, of[at]))
    if len(across):
        far, others = tree.query(X[rows[across]], k=min(FEW, len(of)))
        far, others = far.reshape(len(across), -1), others.reshape(len(across), -1)
        far = np.where(_across(X, normal, rows[across, None], of[others]), np.inf, far)
        best = far.argmin(1)[:, None]
        distance[across] = np.take_along_axis(far, best, 1)[:, 0]
        at[across] = np.take_along_axis(others, best, 1)[:, 0]
    return distance, at


def _across(X: Floats, normal: Floats, a: Ints, b: Ints) -> NDArray[np.bool_]:
    """Whether points a and b are on opposite walls of a gap: normals opposed, and each in front."""
    away = X[b] - X[a]
    opposed = (normal[a] * normal[b]).sum(-1) < -OPPOSED
    return opposed & ((away * normal[a]).sum(-1) > 0.0) & ((away * normal[b]).sum(-1) < 0.0)


def _thin_once(points: Floats, radius: float) -> Ints:
    """Ascending indices, no two within radius; the subset need not be maximal."""
    # Points in one cell of edge radius/sqrt(3) exclude each other, and are dropped first.
    cell = np.floor((points - points.min(0)) / (radius / np.sqrt(3.0))).astype(np.int64)
    first = np.unique(first_equal(cell))
    few = points[first]
    pairs = kd_tree(few).query_pairs(radius, output_type="ndarray")
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
    start = np.searchsorted(pairs[:, 0], np.arange(len(few) + 1)).tolist()
    later = pairs[:, 1].tolist()
    # In order: each point that is left drops those after it.  A loop over lists takes 0.6 times as
    # long as one over slices of arrays (measured).
    kept = bytearray(b"\1") * len(few)
    for i in range(len(few)):
        if kept[i]:
            for j in later[start[i] : start[i + 1]]:
                kept[j] = 0
    return first[np.frombuffer(kept, bool)]

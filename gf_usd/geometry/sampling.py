"""Filling a solid with particles, and its surface with contact samples.

Particles are stratified: one in each cube of a lattice, kept if it lies inside.  Eight cubes make a
cell of the solver's grid, so that every full cell holds exactly eight particles, each at a random
place about one of the cell's eight Gauss points (docs/physics.md).  All have the same rest volume
V0 = V / N.

Draws are made in a frame whose Y is up, so that an asset has the same particles whichever axis is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.frames import Particles, SurfaceSamples
from gf_usd.core.neighbors import kd_tree
from gf_usd.geometry.solid import Solid
from gf_usd.geometry.surface import colors, nearest

# Of a stratum that a particle may lie in.  Less is more accurate: of a bar 16 strata long the first
# frequency is 1.3 % low at 0.7, 0.44 % at 0.35, 0.12 % at 0 (measured); none shows as rows.
JITTER = 0.35
# Of a stratum: where the two Gauss points of a cell, .289 h from its middle, lie in its two strata.
# Bending of a bar four cells thick is 2.2 % too soft with them, 3.7 % with the strata's middles.
GAUSS = (1.0 - 1.0 / np.sqrt(3.0), 1.0 / np.sqrt(3.0))
SIGMA_T = 0.75  # tangential standard deviation over the spacing: no gaps between neighbors
SIGMA_R = 0.25  # along the normal
LEAST_PARTICLES = 16  # fewer do not hold a grid
MOST_PARTICLES = 50_000_000
# World to the frame of the draws: signed permutations, which lose no digit.
TURNS = {"Y": np.eye(3), "Z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])}
CHUNK = 2_000_000  # lattice cubes looked at together: bounds memory


def sample_solid(
    solid: Solid,
    *,
    particles: int | None,
    spacing: float | None,
    seed: int,
    uniform: bool = False,
    up: str = "Y",
) -> Particles:
    """Particles at a spacing [m], or about `particles` of them.

    uniform : drawn one by one anywhere in the solid, as the paper does, in place of strata.

    Raises InputError where the solid holds too few or too many at that spacing.
    """
    a = spacing if spacing else float(np.cbrt(solid.volume / (particles or 1)))
    expected = solid.volume / a**3
    if expected > MOST_PARTICLES:
        raise InputError(
            f"a spacing of {a:.3g} m would take {expected:.3g} particles"
            f" (at most {MOST_PARTICLES})",
            "raise --spacing or lower --particles",
        )
    rng = np.random.default_rng(seed)
    turn = TURNS[up]
    if uniform:
        corner, X = _uniform(solid, round(expected), rng, turn)
    else:
        corner, X = _strata(solid, a, rng, turn)
    if len(X) < LEAST_PARTICLES:
        raise InputError(
            f"only {len(X)} particles fit at a spacing of {a:.3g} m into {solid.volume:.3g} m^3"
            f" (at least {LEAST_PARTICLES})",
            "lower --spacing or raise --particles",
        )
    at = nearest(solid, X)
    n = len(X)
    s = float(np.cbrt(solid.volume / n))
    return Particles(
        X=X,
        V0=np.full(n, solid.volume / n),
        material=np.zeros(n, np.int64),
        orientation=quaternion_from_axis(at.normal),
        scale=np.tile(s * np.array([SIGMA_R, SIGMA_T, SIGMA_T]), (n, 1)),
        color=colors(solid, at),
        opacity=np.ones(n),
        surface=at.surface,
        spacing=s,
        volume=solid.volume,
        lattice=a,
        corner=corner,
    )


def _box(solid: Solid, turn: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest corner in the frame of the draws."""
    ends = np.stack([solid.low, solid.high]) @ turn.T
    return ends.min(0), ends.max(0)


def _strata(
    solid: Solid, a: float, rng: np.random.Generator, turn: Floats
) -> tuple[Floats, Floats]:
    """Corner of the lattice and the particles kept, cube by cube."""
    low, high = _box(solid, turn)
    size = high - low
    n = np.maximum(1, np.ceil(size / a).astype(int))
    # Centered on the asset: a symmetric asset gets a symmetric lattice.
    corner = low + 0.5 * (size - n * a)
    slab = max(1, CHUNK // int(n[1] * n[2]))
    kept = []
    for start in range(0, int(n[0]), slab):
        count = np.array([min(slab, int(n[0]) - start), n[1], n[2]])
        cube = np.stack(np.unravel_index(np.arange(np.prod(count)), tuple(count)), -1)
        cube[:, 0] += start
        place = np.array(GAUSS)[cube % 2] + JITTER * (rng.random(cube.shape) - 0.5)
        X = (corner + a * (cube + place)) @ turn
        kept.append(X[solid.inside(X)])
    return corner @ turn, np.concatenate(kept)


def _uniform(solid: Solid, n: int, rng: np.random.Generator, turn: Floats) -> tuple[Floats, Floats]:
    """Corner of the bounding box and exactly n points by rejection."""
    low, high = _box(solid, turn)
    kept: list[Floats] = []
    while (have := sum(len(k) for k in kept)) < n:
        X = (low + rng.random((4 * (n - have) + 64, 3)) * (high - low)) @ turn
        kept.append(X[solid.inside(X)])
    return low @ turn, np.concatenate(kept)[:n]


def quaternion_from_axis(n: Floats) -> NDArray[np.float64]:
    """(k, 4) the shortest rotation (w, x, y, z) that takes axis 0 to n (k, 3), unit."""
    w = 1.0 + n[:, 0]
    q = np.stack([w, np.zeros(len(n)), -n[:, 2], n[:, 1]], 1)
    q[w < 1e-9] = (0.0, 0.0, 1.0, 0.0)  # half a turn: any axis across will do
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def sample_surface(
    solid: Solid, spacing: float, seed: int, bodies: Ints | None = None, up: str = "Y"
) -> SurfaceSamples:
    """Contact samples about a spacing [m] apart; corners of a coarse mesh are among them.

    Candidates are the vertices, then random points by area; kept are some that are no nearer to
    each other than 0.7 spacings and leave no other candidate farther than that.  The area a sample
    stands for is that of the candidates nearest to it.
    bodies : (S,) the body of each surface, each sampled by itself; None: all are one.
    """
    rng = np.random.default_rng(seed + 1)
    body = np.zeros(len(solid.surfaces), np.int64) if bodies is None else bodies
    kept: list[tuple[Floats, Floats, Floats]] = []
    for k in range(int(body.max()) + 1):
        members = np.flatnonzero(body == k)
        kept.append(_sample_body([solid.outward(int(s)) for s in members], spacing, rng, up))
    X, area, normal = (np.concatenate(part) for part in zip(*kept))
    of = np.repeat(np.arange(len(kept)), [len(part[0]) for part in kept])
    return SurfaceSamples(X=X, area=area, normal=normal, body=None if bodies is None else of)


def _sample_body(
    surfaces: Sequence[tuple[Floats, Ints]], spacing: float, rng: np.random.Generator, up: str
) -> tuple[Floats, Floats, Floats]:
    """Places (n, 3) [m], areas (n,) [m^2] and normals (n, 3) on (points, triangles) of a body."""
    clouds, vertices, normals, corner_normals = [], [], [], []
    total = 0.0
    for points, triangles in surfaces:
        a, b, c = np.moveaxis(points[triangles], 1, 0)
        cross = np.cross(b - a, c - a)
        area = 0.5 * np.linalg.norm(cross, axis=1)
        total += float(area.sum())
        count = max(64, int(np.ceil(12.0 * area.sum() / spacing**2)))
        # Systematic draws along the cumulated area: every stretch of surface gets its share.
        u = (np.arange(count) + rng.random(count)) / count * area.sum()
        face = np.minimum(np.searchsorted(np.cumsum(area), u), len(area) - 1)
        r = rng.random((count, 2))
        flip = r.sum(1) > 1.0
        r[flip] = 1.0 - r[flip]
        clouds.append(a[face] + r[:, :1] * (b - a)[face] + r[:, 1:] * (c - a)[face])
        normals.append(cross[face])
        used = np.unique(triangles)
        vertices.append(points[used])
        around = np.zeros_like(points)
        for k in range(3):
            np.add.at(around, triangles[:, k], cross)
        corner_normals.append(around[used])
    cloud = np.concatenate(clouds)
    candidates = np.concatenate([*vertices, cloud])
    chosen = thin(candidates @ TURNS[up].T, 0.7 * spacing)
    X = candidates[chosen]
    share = np.bincount(kd_tree(X).query(cloud)[1], minlength=len(X)) / len(cloud)
    used = share > 0.0
    normal = np.concatenate([*corner_normals, *normals])[chosen][used]
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    return X[used], share[used] * total, normal


def thin(points: Floats, radius: float) -> Ints:
    """Indices of a subset, no two within radius [m] of each other and no point farther from it.

    Of points that exclude each other the first one tends to stay.
    """
    kept = np.zeros(0, np.int64)
    left = np.arange(len(points))
    while len(left):
        kept = np.concatenate([kept, left[_thin_once(points[left], radius)]])
        left = left[kd_tree(points[kept]).query(points[left])[0] > radius]
    return kept


def _thin_once(points: Floats, radius: float) -> Ints:
    """Indices, in order, no two within radius; may leave out points that would still fit."""
    # Points in one cell of edge radius/sqrt(3) exclude each other: drop those first, then search.
    cell = np.floor((points - points.min(0)) / (radius / np.sqrt(3.0))).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    first.sort()
    few = points[first]
    pairs = kd_tree(few).query_pairs(radius, output_type="ndarray")
    pairs = pairs[np.argsort(pairs[:, 1], kind="stable")]
    start = np.searchsorted(pairs[:, 1], np.arange(len(few) + 1))
    lower = pairs[:, 0]
    kept = np.ones(len(few), bool)
    for i in range(len(few)):
        if start[i] < start[i + 1]:
            kept[i] = not kept[lower[start[i] : start[i + 1]]].any()
    return first[kept]

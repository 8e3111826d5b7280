"""Sampling of a solid with particles.

Particles are quadrature points.  Those of a cell of the solver's grid integrate the filled part of
the cell exactly up to second moments (`filling`; docs/physics.md).  A full cell has the eight
points of the 2 x 2 x 2 Gauss rule, each of volume a^3; a cell that the surface cuts has four or
eight.  Each body has its own grid, centered on it.

The grid frame is Y-up, so that the particles do not depend on the up axis of the asset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.units import length_text, volume_text
from gf_usd.geometry.sampling.content import Grid
from gf_usd.geometry.sampling.filling import Filling, fill_cells
from gf_usd.geometry.solid import Solid
from gf_usd.geometry.surface import colors, nearest_own

SIGMA_T = 0.75  # tangential standard deviation over the spacing: no gaps between neighbors
SIGMA_R = 0.25  # along the normal
LEAST_PARTICLES = 16  # of a bake
LEAST_EXPECTED = 0.1  # volume / spacing^3 below which the grid cannot resolve the solid
MOST_PARTICLES = 50_000_000
# World to grid frame: signed permutations, which are exact.
TURNS = {"Y": np.eye(3), "Z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])}
CELL_PER_LATTICE = 2  # edge of a cell over the particle spacing
MOST_KEYS = 2.0**60  # cells of a box whose keys fit in 64 bits
ALIGNED = 1e-6  # [cells] by which a solid may extend beyond its cells


def sample_solid(
    solid: Solid,
    *,
    particles: int | None,
    spacing: float | None,
    seed: int,
    uniform: bool = False,
    up: str = "Y",
    bodies: Ints | None = None,
    scattered: Ints | None = None,
    later: Ints | None = None,
) -> Particles:
    """Particles at a spacing [m], or about `particles` of them.

    uniform : uniformly random positions in the solid, as in the paper, instead of quadrature
        points; seed : of the random numbers.
    bodies : (S,) the body of each surface; None: all are one.
    scattered : (S,) surfaces whose particles are randomly displaced (`_random_moves`); None: none.
    later : (S,) surfaces whose particles are so displaced when they change to another solver.

    Raises InputError where there are too few or too many particles at that spacing.
    """
    a = spacing if spacing else float(np.cbrt(solid.volume / (particles or 1)))
    expected = expected_particles(solid, a)
    turn = TURNS[up]
    if uniform:
        filled = _uniform(solid, round(expected), np.random.default_rng(seed), turn)
    else:
        filled = _quadrature(solid, a, turn, bodies)
    X, V0 = filled.X, filled.V0
    n = len(X)
    if n < LEAST_PARTICLES:
        raise _too_few(n, a, solid)
    surface, normal, color, depth = _look(solid, X, filled.body, bodies)
    inner = depth > a  # half the diagonal of a cube is less than its edge: it is all in the solid
    scatter = None
    if scattered is not None and scattered.any():
        rows = np.flatnonzero(scattered[surface] & inner)
        X = X.copy()
        X[rows] += _random_moves(len(rows), a, seed, turn)
    if later is not None and later.any():
        rows = np.flatnonzero(later[surface] & inner)
        scatter = np.zeros((n, 3))
        scatter[rows] = _random_moves(len(rows), a, seed, turn)
    volume = float(V0.sum())
    s = float(np.cbrt(volume / n))
    if not uniform:
        s = max(s, a)  # on the same grid, thin parts have more particles per volume
    return Particles(
        X=X,
        V0=V0,
        material=np.zeros(n, np.int64),
        orientation=quaternion_from_axis(normal),
        scale=np.tile(s * np.array([SIGMA_R, SIGMA_T, SIGMA_T]), (n, 1)),
        color=color,
        opacity=np.ones(n),
        surface=surface,
        spacing=s,
        volume=volume,
        lattice=a,
        corner=filled.corner[0],
        corners=filled.corner if len(filled.corner) > 1 else None,
        body=filled.body,
        outside=filled.outside,
        scatter=scatter,
    )


def expected_particles(solid: Solid, spacing: float) -> float:
    """About how many particles a solid has at a spacing [m], from its volume.

    Raises InputError where there are too few or too many.
    """
    expected = solid.volume / spacing**3
    if expected > MOST_PARTICLES:
        raise InputError(
            f"a spacing of {length_text(spacing)} would take {expected:.3g} particles"
            f" (at most {MOST_PARTICLES})",
            "raise --spacing or lower --particles",
        )
    if expected < LEAST_EXPECTED:
        raise _too_few(0, spacing, solid)
    return expected


def count_particles(solid: Solid, spacing: float, up: str = "Y") -> int:
    """The number of particles of a solid at a spacing [m], as one body."""
    return len(_quadrature(solid, spacing, TURNS[up], None).X)


@dataclass(frozen=True, kw_only=True)
class _Filled:
    """The particles of a solid, without attributes."""

    X: Floats  # (n, 3) [m]
    V0: Floats  # (n,) [m^3]
    corner: Floats  # (bodies, 3) [m] of the grid of each body
    body: Ints | None = None  # (n,); None: all are one
    outside: int = 0  # particles outside of the solid


def _too_few(n: int, a: float, solid: Solid) -> InputError:
    return InputError(
        f"only {n} particles fit at a spacing of {length_text(a)} into {volume_text(solid.volume)}"
        f" (at least {LEAST_PARTICLES})",
        "lower --spacing or raise --particles",
    )


def _look(
    solid: Solid, X: Floats, body: Ints | None, bodies: Ints | None
) -> tuple[Ints, Floats, Floats, Floats]:
    """Surface (n,) of its body that each particle belongs to, its normal and color (n, 3) at the
    nearest point, and the distance (n,) [m] from there."""
    surface = np.zeros(len(X), np.int64)
    normal, color, away = np.empty((len(X), 3)), np.empty((len(X), 3)), np.empty(len(X))
    body = np.zeros(len(X), np.int64) if body is None else body
    of = np.zeros(len(solid.surfaces), np.int64) if bodies is None else bodies
    for k in range(int(of.max()) + 1):
        mine, members = np.flatnonzero(body == k), np.flatnonzero(of == k)
        part = solid.part(members)
        at = nearest_own(part, X[mine])
        surface[mine], normal[mine] = members[at.surface], at.normal
        color[mine], away[mine] = colors(part, at), at.distance
    return surface, normal, color, away


def _box(solid: Solid, turn: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest corner of the bounding box in the grid frame."""
    ends = np.stack([solid.low, solid.high]) @ turn.T
    return ends.min(0), ends.max(0)


def _quadrature(solid: Solid, a: float, turn: Floats, bodies: Ints | None) -> _Filled:
    """Quadrature points of each body on cells of edge 2 a [m]."""
    of = np.zeros(len(solid.surfaces), np.int64) if bodies is None else bodies
    made = [_of_body(solid.part(np.flatnonzero(of == k)), a, turn) for k in range(of.max() + 1)]
    filled = [one for one, _ in made]
    return _Filled(
        X=np.concatenate([one.X for one in filled]),
        V0=np.concatenate([one.V0 for one in filled]),
        corner=np.array([corner for _, corner in made]),
        body=np.repeat(np.arange(len(made)), [len(one.X) for one in filled])
        if len(made) > 1
        else None,
        outside=sum(one.outside for one in filled),
    )


def _of_body(solid: Solid, a: float, turn: Floats) -> tuple[Filling, Floats]:
    """The particles of one body, and the corner (3,) [m] of its grid.

    The grid is centered on the body, so that the planes of a symmetric body are planes of the grid.
    """
    low, high = _box(solid, turn)
    h = CELL_PER_LATTICE * a
    reach = np.ceil((high - low) / h - ALIGNED)
    if np.prod(np.maximum(1.0, reach)) > MOST_KEYS:
        raise InputError(
            f"the body is {(high - low).max() / h:.3g} cells of {length_text(h)} long and fills"
            " too little of its box",
            "give it thickness, or lower --particles or raise --spacing",
        )
    count = np.maximum(1, reach.astype(np.int64))
    corner = 0.5 * (low + high - h * count)
    return fill_cells(solid, Grid(corner=corner, h=h, count=count, turn=turn)), corner @ turn


def _uniform(solid: Solid, n: int, rng: np.random.Generator, turn: Floats) -> _Filled:
    """n uniformly random points, by rejection sampling, each of the same volume."""
    low, high = _box(solid, turn)
    kept: list[Floats] = []
    while (have := sum(len(k) for k in kept)) < n:
        X = (low + rng.random((4 * (n - have) + 64, 3)) * (high - low)) @ turn
        kept.append(X[solid.inside(X)])
    V0 = np.full(n, solid.volume / n)
    return _Filled(X=np.concatenate(kept)[:n], V0=V0, corner=(low @ turn)[None])


def _random_moves(n: int, a: float, seed: int, turn: Floats) -> Floats:
    """(n, 3) [m] random displacements of up to half a spacing along each axis of the grid.

    A flow that stretches a regular lattice opens gaps between its rows.  Flowing materials are
    therefore sampled with a random point in each cube of the lattice (stratified or jittered
    sampling), as is usual for the material point method.  The outermost layer is not, since its
    surface would become rough.
    """
    return a * (np.random.default_rng(seed).random((n, 3)) - 0.5) @ turn


def quaternion_from_axis(n: Floats) -> NDArray[np.float64]:
    """(k, 4) the shortest rotation (w, x, y, z) from the x axis to unit vectors n (k, 3)."""
    w = 1.0 + n[:, 0]
    q = np.stack([w, np.zeros(len(n)), -n[:, 2], n[:, 1]], 1)
    q[w < 1e-9] = (0.0, 0.0, 1.0, 0.0)  # by 180 degrees, about any normal axis
    return q / np.linalg.norm(q, axis=1, keepdims=True)

"""Quadrature rules of cells: points of equal weight, exact up to second moments of the content.

For the part of a cell that is filled, of volume f, mean c and covariance C, and for k vectors v
with sum v = 0 and sum v v^T = k I, the points

    x = c + C^(1/2) v,      each of weight f / k

have the same volume, mean and covariance, so that they integrate all polynomials of degree two
exactly over the content, whatever its shape.  The corners of a cube are such vectors, of length
sqrt 3, and give a full cell its 2 x 2 x 2 Gauss points; so are the corners of a regular
tetrahedron, the least possible number (Stroud 1971, Approximate Calculation of Multiple Integrals,
degree two).  Any rotation of them is a rule, too: rotations are tried until all points are in the
solid and in the cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints

Flags = NDArray[np.bool_]

MANY = 0.76  # of a full cell: content above which a cell has eight points, else four
TURNS = 48  # rotations that are tried
VOID = 10  # penalty of a point outside the solid; that of one outside its cell is 1
WORST = np.iinfo(np.int64).max
MANY_POINTS, AT_ONCE = 20_000, 2  # points from which each trial is first tested by some: how many
EDGE = 1e-9  # [cells] tolerance of the test for points in their cell

CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
TETRAHEDRON = CUBE[[0, 3, 5, 6]]
OCTAHEDRON = np.sqrt(3.0) * np.concatenate([np.eye(3), -np.eye(3)])
# A tetrahedron with two edges normal to the z axis, symmetric across x and across y.
_UPRIGHT = np.sqrt(2.0) * np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)], float)
_UPRIGHT[:, 2] = (1.0, 1.0, -1.0, -1.0)


def _rotations(count: int) -> NDArray[np.float64]:
    """(count, 3, 3) evenly distributed rotations: super-Fibonacci spirals (Alexa 2022)."""
    psi = 1.533751168755204288118041  # the real solution of psi^4 = psi + 4
    s = np.arange(count) + 0.5
    r, q = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / np.sqrt(2.0), 2.0 * np.pi * s / psi
    x, y, z, w = r * np.sin(alpha), r * np.cos(alpha), q * np.sin(beta), q * np.cos(beta)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _rules() -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Two lists of rules: of four points, then six and eight; and of eight, then six and four."""
    upright = [s * np.roll(_UPRIGHT, k, axis=1) for k in range(3) for s in (1.0, -1.0)]
    turned = _rotations(TURNS)
    four = [TETRAHEDRON, -TETRAHEDRON, *upright, *(TETRAHEDRON @ R for R in turned)]
    eight = [CUBE, *(CUBE @ R for R in turned[: TURNS // 2])]
    return (*four, OCTAHEDRON, CUBE), (*eight, OCTAHEDRON, *four)


FEW_FIRST, MANY_FIRST = _rules()


@dataclass(frozen=True, kw_only=True)
class CellPoints:
    """The quadrature points of cells."""

    cell: Ints  # (N,) row of the cell of each point
    place: Floats  # (N, 3) from the center of the cell, in cells
    volume: Floats  # (N,) in cells
    outside: Ints  # (n,) points of each cell outside the solid with the best of the rules


def moment_points(
    moments: Floats,
    reach: tuple[Floats, Floats],
    own_image: Flags,
    inside: Callable[[Ints, Floats], Flags],
    thin: Flags | None = None,
) -> CellPoints:
    """The quadrature points of cells, by the rule with the least penalty (`VOID`).

    moments : (n, 10) of `content`.
    reach : (n, 3), (n, 3) lower and upper bound of the content of each, about the cell's center.
    own_image : (n, 3) axes across which a cell is its own mirror image; its points are then, too.
    inside : (m,) cells and (m, 3) positions in them -> (m,) whether these are in the solid.
    thin : (n,) cells that have eight points regardless of their content.
    """
    mean, root = mean_and_root(moments)
    full = (moments[:, 0] > 1.0 - EDGE) & (np.abs(mean) < EDGE).all(1)
    best = np.where(full, 0, WORST)
    chosen = np.zeros(len(moments), np.int64)
    many = moments[:, 0] > MANY
    if thin is not None:
        many = many | thin
    groups = ((many, MANY_FIRST, MANY_IMAGES), (~many, FEW_FIRST, FEW_IMAGES))
    tried = 1
    # The number of rules per pass is doubled, since each inside test has a fixed cost.
    first = 0
    while first < len(FEW_FIRST) and (best > 0).any():
        trials = []
        for group, rules, images in groups:
            left = group & (best > 0)
            for number in range(first, min(first + tried, len(rules))):
                # Only rules that have the mirror symmetries of the cell.
                keeps = ~(own_image & ~images[number]).any(1)
                trials.append((number, rules[number], np.flatnonzero(left & keeps)))
        places = [mean[r, None] + np.einsum("nab,kb->nka", root[r], v) for _, v, r in trials]
        owner = np.concatenate([np.repeat(r, len(v)) for _, v, r in trials])
        place = np.concatenate([one.reshape(-1, 3) for one in places])
        sizes = np.concatenate([np.full(len(r), len(v)) for _, v, r in trials])
        most = best[np.concatenate([r for _, _, r in trials])]
        penalty = _penalties(place, owner, sizes, reach, inside, most)
        ends = np.cumsum([len(rows) for _, _, rows in trials])
        for (number, _, rows), wrong in zip(trials, np.split(penalty, ends[:-1])):
            better = wrong < best[rows]
            best[rows[better]] = wrong[better]
            chosen[rows[better]] = number
        first, tried = first + tried, 2 * tried
    parts = []
    for group, rules, _ in groups:
        for number in np.unique(chosen[group]):
            rule = rules[number]
            mine = np.flatnonzero(group & (chosen == number))
            place = mean[mine, None] + np.einsum("nab,kb->nka", root[mine], rule)
            volume = np.repeat(moments[mine, 0] / len(rule), len(rule))
            parts.append((np.repeat(mine, len(rule)), place.reshape(-1, 3), volume))
    cell, place, volume = (np.concatenate(part) for part in zip(*parts))
    order = np.argsort(cell, kind="stable")
    return CellPoints(
        cell=cell[order],
        place=place[order],
        volume=volume[order],
        outside=best // VOID,
    )


def _penalties(
    place: Floats,
    owner: Ints,
    sizes: Ints,
    reach: tuple[Floats, Floats],
    inside: Callable[[Ints, Floats], Flags],
    most: Ints,
) -> Ints:
    """(k,) penalties of trials; WORST where one is found to be at least `most` (k,).

    One point outside the solid is worse than all points in neighboring cells.  Trials that cannot
    be better are not tested further: of 886,000 points of 1,800 open shells 547,000 are (measured).

    place, owner : (m, 3) and (m,) points of the trials, and their cells; sizes : (k,) points of
        each; reach, inside : see `moment_points`.
    """
    trial = np.repeat(np.arange(len(sizes)), sizes)
    turn = np.arange(len(trial)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    low, high = reach[0][owner] - EDGE, reach[1][owner] + EDGE
    outer = np.bincount(trial, ~((place >= low) & (place <= high)).all(1), len(sizes)).astype(int)
    penalty = outer.copy()
    longest = int(sizes.max(initial=0))
    step = AT_ONCE if len(trial) > MANY_POINTS else longest
    for first, end in ((0, step), (step, longest)):
        left = np.flatnonzero((penalty < most)[trial] & (turn >= first) & (turn < end))
        if len(left):
            void = ~inside(owner[left], place[left])
            penalty += VOID * np.bincount(trial[left], void, len(sizes)).astype(int)
    return np.where(penalty < most, penalty, WORST)


def covariance(moments: Floats) -> tuple[Floats, Floats]:
    """Mean (n, 3) and covariance (n, 3, 3) of the contents, in cells."""
    mean = moments[:, 1:4] / moments[:, :1]
    second = moments[:, 4:] / moments[:, :1]
    C = second[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]] - mean[:, :, None] * mean[:, None, :]
    return mean, C


def spreads(moments: Floats) -> NDArray[np.float64]:
    """(n, 3) principal variances of the contents, ascending."""
    return np.linalg.eigvalsh(covariance(moments)[1])


def mean_and_root(moments: Floats) -> tuple[Floats, Floats]:
    """Mean (n, 3) and symmetric square root (n, 3, 3) of the covariance of contents, in cells."""
    mean, C = covariance(moments)
    values, vectors = np.linalg.eigh(C)
    root = np.sqrt(np.maximum(values, 0.0))  # rounding makes eigenvalues of flat contents negative
    return mean, np.einsum("nab,nb,ncb->nac", vectors, root, vectors)


def _images(rule: Floats) -> Flags:
    """(3,) axes across which a rule is mirror-symmetric."""
    out = np.zeros(3, bool)
    for axis in range(3):
        mirrored = rule * np.where(np.arange(3) == axis, -1.0, 1.0)
        apart = np.linalg.norm(rule[:, None] - mirrored[None], axis=2).min(1)
        out[axis] = (apart < 1e-12).all()
    return out


FEW_IMAGES, MANY_IMAGES = ([_images(rule) for rule in rules] for rules in (FEW_FIRST, MANY_FIRST))

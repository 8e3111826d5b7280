"""Particles of a solid on a grid: those of its cells, slivers merged, and mirror images alike.

A cell is thin if there is no full cell within two of it: what it holds of a leg or a sheet has no
particles behind it to lean on.  So it has points of its own, and twice as many.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.geometry.sampling.content import POWERS, Content, Grid, find_content
from gf_usd.geometry.sampling.mirror import mirror_axes
from gf_usd.geometry.sampling.rules import CellPoints, moment_points, spreads
from gf_usd.geometry.solid import Solid

Flags = NDArray[np.bool_]

LATTICE = 8  # probes along each axis of a cell whose content is taken apart
LEAST_SHARE = 0.05  # of a content: a smaller part goes to the others
SLIVER = 0.24  # [cells] of volume: what holds less goes to a neighbor
# The same of thin cells.  With .24, square rods of 1.5 particles across and fewer had motions
# without any strain at the particles, and folded like cloth (`gf-usd verify --case thin`).
THIN_SLIVER = 0.005
FULL_SHARE = 0.99  # [cells] of volume that count as full
SAME_SURFACE = 0.05  # [cells] by which mirror images may differ where polygons are cut otherwise


@dataclass(frozen=True, kw_only=True)
class Filling:
    """Particles of a solid."""

    X: Floats  # (N, 3) [m] world
    V0: Floats  # (N,) [m^3]
    outside: int  # particles outside of the solid: no rule keeps all of their cell's in it
    counted: int  # cells whose moments are a count, where surfaces overlap or are open


def fill_cells(solid: Solid, grid: Grid) -> Filling:
    """Particles whose volume, center and second moments are those of the solid, cell by cell."""
    content = find_content(solid, grid)
    parts = [(grid.to_cells(s.points), t) for s, t in zip(solid.surfaces, solid.triangles)]
    mirrored = mirror_axes(parts, SAME_SURFACE)
    half = fold(content, grid.count, mirrored)
    own_image = mirrored & (grid.count % 2 == 1) & (half.ijk == grid.count // 2)
    thin = thin_cells(content, half, grid)
    kept, moments, reach = merge_slivers(half, grid, mirrored, own_image, thin)
    ijk, own_image, thin = half.ijk[kept], own_image[kept], thin[kept]
    middle = ijk + 0.5

    def inside(cells: Ints, place: Floats) -> Flags:
        return solid.inside(grid.to_world(middle[cells] + place))

    points = split_where_outside(
        moment_points(moments, reach, own_image, inside, thin), moments, reach, own_image, inside
    )
    # From the middle of the grid, so that mirror images differ by their sign alone.
    place = middle[points.cell] - 0.5 * grid.count + points.place
    volume, image = points.volume, own_image[points.cell]
    for axis in np.flatnonzero(mirrored):
        other = ~image[:, axis]
        flip = np.where(np.arange(3) == axis, -1.0, 1.0)
        place = np.concatenate([place, place[other] * flip])
        volume = np.concatenate([volume, volume[other]])
        image = np.concatenate([image, image[other]])
    cell = np.clip(np.floor(place + 0.5 * grid.count).astype(np.int64), 0, grid.count - 1)
    order = np.argsort(grid.key(cell), kind="stable")
    center = grid.to_world(0.5 * grid.count)
    return Filling(
        X=center + grid.h * place[order] @ grid.turn,
        V0=grid.h**3 * volume[order],
        outside=int(points.outside.sum()),
        counted=content.counted,
    )


def thin_cells(content: Content, some: Content, grid: Grid) -> Flags:
    """(n,) which of some cells have no full one of all among the 5 x 5 x 5 around them.

    Among the 3 x 3 x 3 edges of thick bodies have none either, and are better merged: the slanted
    bar of `gf-usd verify` is off by 1.8 % with 2000 particles so, and by 1.4 % as it is.
    """
    full = np.sort(grid.key(content.ijk[content.moments[:, 0] > FULL_SHARE]))
    left = np.flatnonzero(some.moments[:, 0] <= FULL_SHARE)  # of which none is found yet
    for step in np.ndindex(5, 5, 5):
        if not len(full):
            break
        at = some.ijk[left] + step - 2
        here = ((at >= 0) & (at < grid.count)).all(1)
        key = np.where(here, grid.key(at), -1)
        found = np.minimum(np.searchsorted(full, key), len(full) - 1)
        left = left[full[found] != key]
    thin = np.zeros(len(some.ijk), bool)
    thin[left] = True
    return thin


def split_where_outside(
    points: CellPoints,
    moments: Floats,
    reach: tuple[Floats, Floats],
    own_image: Flags,
    inside: Callable[[Ints, Floats], Flags],
) -> CellPoints:
    """The points, those of cells with some in the void made anew from two or more parts of them.

    A cell that holds some of two limbs has a mean between them; so has one that is bent.
    Parameters are those of `moment_points`.
    """
    rows, parts, lows, highs = [], [], [], []
    for row in np.flatnonzero((points.outside > 0) & ~own_image.any(1)):
        low, high = reach[0][row], reach[1][row]
        for part, span in _parts(moments[row], low, high, lambda P, row=row: inside(
            np.full(len(P), row), P
        )):  # fmt: skip
            rows.append(row)
            parts.append(part)
            lows.append(span[0])
            highs.append(span[1])
    if not rows:
        return points
    of = np.array(rows)
    made = moment_points(
        np.array(parts), (np.array(lows), np.array(highs)), np.zeros((len(of), 3), bool),
        lambda cells, place: inside(of[cells], place),
    )  # fmt: skip
    outside = points.outside.copy()
    anew = np.bincount(of, made.outside, minlength=len(outside)).astype(np.int64)
    better = np.isin(np.arange(len(outside)), of) & (anew < outside)
    outside[better] = anew[better]
    old, new = ~better[points.cell], better[of[made.cell]]
    cell = np.concatenate([points.cell[old], of[made.cell[new]]])
    order = np.argsort(cell, kind="stable")
    return CellPoints(
        cell=cell[order],
        place=np.concatenate([points.place[old], made.place[new]])[order],
        volume=np.concatenate([points.volume[old], made.volume[new]])[order],
        outside=outside,
    )


def _parts(
    moments: Floats, low: Floats, high: Floats, inside: Callable[[Floats], Flags]
) -> list[tuple[Floats, tuple[Floats, Floats]]]:
    """Moments (10,) of parts of a content that add up to it, with the span of each; may be none.

    Parts are connected, by probes on a lattice; what is connected is cut at its mean, across the
    direction in which it is longest.  What the probes miss is shared out by volume.
    """
    step = (high - low) / LATTICE
    at = np.stack(np.meshgrid(*[np.arange(LATTICE)] * 3, indexing="ij"), -1).reshape(-1, 3)
    P = low + step * (at + 0.5)
    held = inside(P)
    if not held.any():
        return []
    from scipy import ndimage  # loads scipy.special, and few contents are taken apart

    labeled: Any = ndimage.label(held.reshape((LATTICE,) * 3))
    label = labeled[0].ravel()
    if label.max() == 1:
        away = P - P[held].mean(0)
        longest = np.linalg.svd(away[held], full_matrices=False)[2][0]
        label = np.where(held, 1 + (away @ longest > 0.0), 0)
    count = np.bincount(label)[1:]
    kept = np.flatnonzero(count >= LEAST_SHARE * count.sum()) + 1
    values = np.prod(P[:, None, :] ** POWERS[None], 2) * np.prod(step)
    values[:, 4:7] += np.prod(step) * step**2 / 12.0
    found = np.array([values[label == k].sum(0) for k in kept])
    found += (found[:, :1] / found[:, 0].sum()) * (moments - found.sum(0))
    # A correction that leaves no spread in some direction would lose what it is to keep.
    if len(kept) < 2 or (found[:, 0] <= 0.0).any() or (spreads(found) < 0.0).any():
        return []
    half = 0.5 * step
    spans = [(P[label == k].min(0) - half, P[label == k].max(0) + half) for k in kept]
    return list(zip(found, spans))


def flipped(moments: Floats, axis: int) -> NDArray[np.float64]:
    """Moments (n, 10) of the mirror images of contents."""
    return moments * np.where(POWERS[:, axis] % 2 == 1, -1.0, 1.0)


def moved(moments: Floats, by: Floats) -> NDArray[np.float64]:
    """Moments (10,) of a content shifted by (3,)."""
    f, m, x, y, z = moments[0], moments[1:4], *by
    dx, dy, dz = m
    return np.concatenate([
        [f], m + f * by,
        moments[4:7] + 2.0 * by * m + f * by**2,
        moments[7:] + [
            x * dy + y * dx + f * x * y, x * dz + z * dx + f * x * z, y * dz + z * dy + f * y * z,
        ],
    ])  # fmt: skip


def fold(content: Content, count: Ints, mirrored: Flags) -> Content:
    """The cells of the upper half across each mirrored axis: the mean of both halves."""
    for axis in np.flatnonzero(mirrored):
        other = content.ijk.copy()
        other[:, axis] = count[axis] - 1 - other[:, axis]
        faces = content.faces.copy()
        faces[:, :, axis] = faces[:, ::-1, axis]
        ijk = np.concatenate([content.ijk, other])
        kept = ijk[:, axis] >= count[axis] // 2
        ijk, which = np.unique(ijk[kept], axis=0, return_inverse=True)
        which = which.reshape(-1)
        moments, areas = np.zeros((len(ijk), 10)), np.zeros((len(ijk), 2, 3))
        both = np.concatenate([content.moments, flipped(content.moments, int(axis))])
        np.add.at(moments, which, 0.5 * both[kept])
        np.add.at(areas, which, 0.5 * np.concatenate([content.faces, faces])[kept])
        content = replace(content, ijk=ijk, moments=moments, faces=areas)
    return content


def merge_slivers(
    content: Content, grid: Grid, mirrored: Flags, own_image: Flags, thin: Flags
) -> tuple[Ints, Floats, tuple[Floats, Floats]]:
    """Rows that keep particles, their moments, and the lowest and highest place of their content.

    What holds less than `SLIVER`, or `THIN_SLIVER` where thin (n,), goes to the neighbor it shares
    the largest face with.  A sliver that has none stays.
    """
    n = len(content.ijk)
    moments = content.moments.copy()
    low, high = np.full((n, 3), -0.5), np.full((n, 3), 0.5)
    into = np.arange(n)
    least = np.where(thin, THIN_SLIVER, SLIVER)
    few = np.flatnonzero(moments[:, 0] < least)
    few = few[np.argsort(moments[few, 0], kind="stable")]
    area = np.where(own_image[few][:, None, :], 0.0, content.faces[few]).reshape(-1, 6)
    sides = np.argsort(-area, axis=1, kind="stable")
    near = _neighbors(content.ijk, few, grid, mirrored)
    near[area <= 0.0] = -1
    for row, rows in zip(few, np.take_along_axis(near, sides, 1).tolist()):
        if moments[row, 0] >= least[row]:
            continue
        alive = [t for t in rows if t >= 0 and t != row and into[t] == t]
        gone = [int(into[t]) for t in rows if t >= 0 and into[t] not in (t, row)]
        target = next(iter(alive + [t for t in gone if into[t] == t]), row)
        if target == row:
            continue
        by = content.ijk[row] - content.ijk[target]
        added = moved(moments[row], by)
        low[target] = np.minimum(low[target], low[row] + by)
        high[target] = np.maximum(high[target], high[row] + by)
        for axis in np.flatnonzero(own_image[target] & ~own_image[row]):
            # The image of the sliver goes to the same cell.
            added = added + flipped(added, int(axis))
            both = max(-low[target, axis], high[target, axis])
            low[target, axis], high[target, axis] = -both, both
        moments[target] += added
        into[row] = target
    kept = np.flatnonzero(into == np.arange(n))
    return kept, moments[kept], (low[kept], high[kept])


def _neighbors(ijk: Ints, rows: Ints, grid: Grid, mirrored: Flags) -> NDArray[np.int64]:
    """(m, 6) row of the cell, or of its image in this half, below and above each axis; -1: none."""
    axes = np.eye(3, dtype=np.int64)
    near = ijk[rows][:, None, :] + np.concatenate([-axes, axes])
    near = np.where(mirrored & (near < grid.count // 2), grid.count - 1 - near, near)
    beyond = ((near < 0) | (near >= grid.count)).any(2)
    key = grid.key(ijk)
    by_key = np.argsort(key)
    wanted = grid.key(near)
    at = np.minimum(np.searchsorted(key, wanted, sorter=by_key), len(key) - 1)
    found = by_key[at]
    return np.where(beyond | (key[found] != wanted), -1, found)

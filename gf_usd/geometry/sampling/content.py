"""Exact moments, up to second order, of the part of each grid cell that a solid fills.

In coordinates about the center of the cell, in units of its edge, over the part that is filled,

    M = integral of (1, x, y, z, x^2, y^2, z^2, xy, xz, yz) dV

By the divergence theorem, column by column along z: with F the antiderivative of f along z, the
integral of the winding number w times f over the column under z_k is

    sum over the pieces of surface under z_k of  integral of (F(z) - F(z_k)) n_z dA

so that only pieces of triangles in one cell (`pieces`) are needed, over which polynomials are
integrated exactly.  Where the winding number w is 0 or 1, these are the moments of the solid.  In a
cell that one shell cuts, w has two values that differ by 1, and the moments of the solid,
|w| > 1/2 (`Solid.inside`), follow from those of w.  Where several shells overlap in a cell, or a
surface is open, the moments are estimated from sample points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.units import length_text
from gf_usd.geometry.sampling.holes import capped
from gf_usd.geometry.sampling.pieces import POINTS, WEIGHTS, cut
from gf_usd.geometry.solid import INSIDE, Solid, spread_evenly
from gf_usd.geometry.winding import rows_of

# Powers of x, y, z, in the order of the moments.
POWERS = np.array(
    [
        (0, 0, 0),
        (1, 0, 0), (0, 1, 0), (0, 0, 1),
        (2, 0, 0), (0, 2, 0), (0, 0, 2),
        (1, 1, 0), (1, 0, 1), (0, 1, 1),
    ]
)  # fmt: skip
PLANE = [(0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1)]  # powers of x, y
FULL = np.where((POWERS == 2).any(1), 1.0 / 12.0, 0.0)  # moments of a full cell
FULL[0] = 1.0
ROUNDING = 1e-9  # [cells] rounding error of volumes
NOTHING = 1e-12  # [cells] volume below which a cell counts as empty
PROBES = (64, 512)  # least and greatest number of sample points per cell
MOST_PROBES = 200_000  # sample points in all cells
MOST_CELLS = 50_000_000  # as the limit on particles: with more, the spacing is a mistake
SPACING_PER_CELL = 0.5  # least spacing of particles in a grid of cells, in cells
BATCH = 1 << 18  # sample points at a time: bounds memory


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A grid of cells, in a frame whose axes are the world's, permuted and possibly reversed."""

    corner: Floats  # (3,) [m] lowest corner, in the frame
    h: float  # [m] edge of a cell
    count: Ints  # (3,) cells
    turn: Floats  # (3, 3) world to frame: a signed permutation

    def to_cells(self, X: Floats) -> Floats:
        """World positions (..., 3) [m] to cell coordinates."""
        return (X @ self.turn.T - self.corner) / self.h

    def to_world(self, cells: Floats) -> Floats:
        """The inverse of `to_cells`."""
        return (self.corner + self.h * cells) @ self.turn

    def key(self, ijk: Ints) -> Ints:
        """Flat index of each cell (..., 3)."""
        return (ijk[..., 0] * self.count[1] + ijk[..., 1]) * self.count[2] + ijk[..., 2]

    def ijk(self, key: Ints) -> NDArray[np.int64]:
        """The inverse of `key`."""
        return np.stack(np.unravel_index(key, tuple(self.count)), -1)


@dataclass(frozen=True, kw_only=True)
class Content:
    """The cells that intersect a solid, and the moments of the intersections."""

    ijk: Ints  # (n, 3)
    moments: Floats  # (n, 10) in units of cells, about the center of the cell
    faces: Floats  # (n, 2, 3) [cells^2] area of the solid in the lower and upper face of each axis
    counted: int = 0  # cells whose moments are estimated from sample points


def find_content(solid: Solid, grid: Grid) -> Content:
    """The content of all cells of a grid that covers a solid.

    Raises InputError for a solid with less volume than rounding errors, such as a grain that is
    filled at the spacing of a mountain.
    """
    found = [_of_surface(solid, k, grid) for k in range(len(solid.surfaces))]
    full = np.unique(np.concatenate([one.full for one in found]))
    key, which = np.unique(np.concatenate([one.part for one in found]), return_inverse=True)
    moments, faces = np.zeros((len(key), 10)), np.zeros((len(key), 2, 3))
    np.add.at(moments, which, np.concatenate([one.moments for one in found]))
    np.add.at(faces, which, np.concatenate([one.faces for one in found]))
    doubtful = np.zeros(len(key), bool)
    np.logical_or.at(doubtful, which, np.concatenate([one.doubtful for one in found]))
    several = np.bincount(which, minlength=len(key)) > 1
    open_ = ~np.isin(key, full)
    key, moments, faces = key[open_], moments[open_], faces[open_]
    doubtful = (doubtful | several)[open_]
    counted = 0
    if doubtful.any():
        moments[doubtful], counted = _count(solid, grid, key[doubtful], moments[doubtful])
    some = moments[:, 0] > NOTHING
    rest = moments[:, 0] > 1.0 - NOTHING
    moments[rest] = FULL
    if not len(full) and not some.any():
        wide = float((solid.high - solid.low).max())
        raise InputError(
            f"<{solid.surfaces[0].path}> is {length_text(wide)} wide, too small to fill with"
            f" cells of {length_text(grid.h)}, which the size of all bodies and the number of"
            " particles give",
            "leave it out, check its scale, or use more --particles",
        )
    return Content(
        ijk=grid.ijk(np.concatenate([full, key[some]])),
        moments=np.concatenate([np.tile(FULL, (len(full), 1)), moments[some]]),
        faces=np.concatenate([np.ones((len(full), 2, 3)), faces[some]]),
        counted=counted,
    )


@dataclass(frozen=True, kw_only=True)
class _SurfaceContent:
    """The content of the cells that one surface encloses or cuts."""

    full: Ints  # keys of the cells it encloses
    part: Ints  # (n,) keys of the cells it cuts
    moments: Floats  # (n, 10)
    faces: Floats  # (n, 2, 3)
    doubtful: NDArray[np.bool_]  # (n,) the winding number is not 0 or 1: moments are not exact


def _of_surface(solid: Solid, index: int, grid: Grid) -> _SurfaceContent:
    """The cells that a surface cuts, and the enclosed ones, which follow from these."""
    # cells that a cap cuts are filled in part
    points, triangles = capped(solid, index, np.array([index]), SPACING_PER_CELL * grid.h)
    pieces = cut(grid.to_cells(points)[triangles])
    if not len(pieces.source):  # all are too small to be seen
        none = np.zeros(0, np.int64)
        return _SurfaceContent(
            full=none, part=none, moments=np.zeros((0, 10)), faces=np.zeros((0, 2, 3)),
            doubtful=np.zeros(0, bool),
        )  # fmt: skip
    at = np.floor(pieces.middles).astype(np.int64)
    at = np.clip(at, 0, grid.count - 1)  # rounding may put a piece outside the grid
    vector = pieces.area_vectors
    integrals = _integrals(pieces.corners - (at + 0.5)[:, None, :], vector[:, 2])
    key, first, place = np.unique(grid.key(at), return_index=True, return_inverse=True)
    place = place.reshape(-1)
    w, gaps = _along_columns(grid, key, _summed(place, integrals, len(key)))
    faces = _face_areas(grid.ijk(key), -_summed(place, vector, len(key)))
    closed, shell = solid.surfaces[index].welded.balanced, solid.surfaces[index].welded.shell
    shell = np.pad(shell, (0, len(triangles) - len(shell)))  # any for caps: nothing is exact there
    of = shell[pieces.source]  # shell of each piece
    lowest = np.full(len(key), len(pieces.source))
    np.minimum.at(lowest, place, of)
    highest = np.zeros(len(key), np.int64)
    np.maximum.at(highest, place, of)
    doubtful = np.full(len(key), not closed) | (highest > lowest)
    if closed:
        one = not shell.any()  # whose triangles face outward
        facing = (
            np.ones(1)
            if one
            else np.sign([signed_volume(points, triangles[rows]) for rows in rows_of(shell)])
        )
        one_shell, wrong = _where_nonzero(w, facing[of[first]])
        moments = np.where(doubtful[:, None], w, one_shell)
        doubtful |= wrong
        full = _between(gaps, grid)
    else:
        moments = np.full_like(w, np.nan)
        full = _reached(solid, index, grid, key)
    return _SurfaceContent(full=full, part=key, moments=moments, faces=faces, doubtful=doubtful)


def _summed(place: Ints, values: Floats, count: int) -> Floats:
    """(count, k) sums of values (n, k) by index `place` (n,)."""
    return np.stack([np.bincount(place, v, minlength=count) for v in values.T], 1)


def _below(line: Ints, values: Floats) -> Floats:
    """(n, k) exclusive prefix sums of values (n, k) within each line; rows are sorted by line."""
    total = np.cumsum(values, axis=0)
    first = np.flatnonzero(np.diff(line, prepend=line[0] - 1))
    before = np.repeat(total[first] - values[first], np.diff(first, append=len(line)), axis=0)
    return total - values - before


@dataclass(frozen=True, kw_only=True)
class _Gaps:
    """Runs of cells in columns, each between two cells that the surface cuts."""

    start: Ints  # (n,) key of the cut cell below each run
    length: Ints  # (n,) cells
    w: Floats  # (n,) winding number


def _along_columns(grid: Grid, key: Ints, own: Floats) -> tuple[Floats, _Gaps]:
    """Moments (n, 10) of the winding number in cut cells, and the runs of cells between them.

    key : (n,) of the cells, ascending, so that each column is contiguous and sorted upward.
    own : (n, 16) sums of `_integrals`.
    """
    column = key // grid.count[2]
    below = _below(column, own[:, 10:])
    w = own[:, :10].copy()
    for k, (a, b, c) in enumerate(POWERS):
        if c != 1:  # the integral of an odd power of z over a cell is 0
            w[:, k] += below[:, PLANE.index((a, b))] * (1.0 if c == 0 else 1.0 / 12.0)
    length = np.where(np.diff(column) == 0, np.diff(key) - 1, 0)
    rows = np.flatnonzero(length > 0)
    return w, _Gaps(start=key[rows], length=length[rows], w=(below + own[:, 10:])[rows, 0])


def _between(gaps: _Gaps, grid: Grid) -> Ints:
    """Keys of the cells between cut ones that a closed surface encloses.

    Raises InputError where there are more than `MOST_CELLS`.
    """
    rows = np.flatnonzero(np.round(gaps.w) != 0.0)
    length = gaps.length[rows]
    _refuse_too_many(int(length.sum()), grid.h)
    start = np.cumsum(length) - length
    return np.repeat(gaps.start[rows] + 1 - start, length) + np.arange(int(length.sum()))


def _reached(solid: Solid, index: int, grid: Grid, key: Ints) -> Ints:
    """Keys of the cells that an open surface does not cut and whose centers it encloses.

    By flood fill from the cut cells (n,): the winding number is harmonic away from the surface, so
    that by the maximum principle each region where it exceeds a bound reaches the surface.  Only
    cells inside and their neighbors are tested.
    """
    known, front, found = key, key, [np.zeros(0, np.int64)]
    steps = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
    while len(front):
        near = (grid.ijk(front)[:, None, :] + steps).reshape(-1, 3)
        near = near[((near >= 0) & (near < grid.count)).all(1)]
        new = np.setdiff1d(grid.key(near), known)
        middle = grid.to_world(grid.ijk(new) + 0.5)
        front = new[_winding_near(solid, index, middle) > INSIDE]
        found.append(front)
        known = np.union1d(known, new)
        _refuse_too_many(len(known), grid.h)
    return np.concatenate(found)


def _refuse_too_many(cells: int, h: float) -> None:
    if cells > MOST_CELLS:
        raise InputError(
            f"the body extends over more than {MOST_CELLS} cells of {length_text(h)}",
            "lower --particles or raise --spacing",
        )


def _face_areas(ijk: Ints, own: Floats) -> Floats:
    """(n, 2, 3) [cells^2] area of the solid in the lower and upper face of cut cells, by axis.

    ijk : (n, 3); own : (n, 3) upper minus lower area, by the divergence theorem.
    """
    faces = np.empty((len(ijk), 2, 3))
    for axis in range(3):
        others = [ijk[:, d] for d in range(3) if d != axis]
        order = np.lexsort((ijk[:, axis], *others))
        _, line = np.unique(np.stack(others, 1)[order], axis=0, return_inverse=True)
        mine = own[order, axis : axis + 1]
        lower = _below(line.reshape(-1), mine)
        faces[order, 0, axis], faces[order, 1, axis] = lower[:, 0], (lower + mine)[:, 0]
    return faces


def _where_nonzero(w: Floats, facing: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Moments of the region w != 0 from the moments of w, for cells that one shell cuts.

    w is n outside the shell and n + facing inside it.  Second: where the moments contradict this.
    """
    sign = np.where(facing < 0.0, -1.0, 1.0)[:, None]
    outer = np.floor(sign[:, 0] * w[:, 0] + ROUNDING)[:, None] * sign
    within = sign * (w - outer * FULL)
    in_outer, in_inner = outer != 0.0, outer + sign != 0.0
    moments = np.where(in_outer, FULL, 0.0) + np.where(in_inner, 1.0, 0.0) * within
    moments -= np.where(in_outer, 1.0, 0.0) * within
    return moments, (within[:, 0] > 1.0 + ROUNDING) | (within[:, 0] < -ROUNDING)


def _integrals(local: Floats, nz: Floats) -> Floats:
    """(n, 16) integrals over each piece of F(z) - F(1/2), ten moments, and x^a y^b, times -n_z dA.

    local : (n, 3, 3) corners about the center of the cell; nz : (n,) z of the area vector.
    """
    out = np.zeros((16, len(local)))
    a, b, c = np.ascontiguousarray(np.moveaxis(local, 0, 2))  # (3, n) each
    for point, weight in zip(POINTS, WEIGHTS):
        x, y, z = point[0] * a + point[1] * b + point[2] * c
        share = -weight * nz
        depth = [(0.5 ** (k + 1) - z ** (k + 1)) / (k + 1) * share for k in range(3)]
        plane = {(1, 0): x, (0, 1): y, (2, 0): x * x, (0, 2): y * y, (1, 1): x * y}
        factors = [((i, j), depth[k]) for i, j, k in POWERS] + [(power, share) for power in PLANE]
        for row, (power, factor) in zip(out, factors):
            row += plane[power] * factor if any(power) else factor
    return out.T


def _winding(solid: Solid, index: int, X: Floats) -> Floats:
    """(n,) |w| of a surface at X (n, 3) [m]."""
    bounds = solid.bounds[index]
    parts = [bounds.winding_numbers(X[k : k + BATCH]) for k in range(0, len(X), BATCH)]
    return np.abs(np.concatenate(parts)) if parts else np.zeros(0)


def _count(solid: Solid, grid: Grid, key: Ints, exact: Floats) -> tuple[Floats, int]:
    """(n, 10) moments of cells from sample points, and the number of cells where they are used.

    `exact`, the moments of the sum of the winding numbers, is used where all surfaces are closed
    and no sample point lies in two of them.
    """
    probe = spread_evenly(int(np.clip(MOST_PROBES // len(key), *PROBES))) - 0.5
    values = np.prod(probe[:, None, :] ** POWERS[None], 2)
    out = exact.copy()
    counted = 0
    step = max(1, BATCH // len(probe))
    for k in range(0, len(key), step):
        some = slice(k, k + step)
        X = grid.to_world(grid.ijk(key[some])[:, None, :] + 0.5 + probe).reshape(-1, 3)
        w = np.array([_winding_near(solid, index, X) for index in range(len(solid.surfaces))])
        inside = (w > INSIDE).any(0).reshape(-1, len(probe))
        once = (w.sum(0) < 1.0 + INSIDE).reshape(-1, len(probe)).all(1)
        volume = exact[some, 0]
        sound = once & (volume > -ROUNDING) & (volume < 1.0 + ROUNDING)
        out[some] = np.where(sound[:, None], exact[some], inside @ values / len(probe))
        counted += int((~sound).sum())
    return out, counted


def _winding_near(solid: Solid, index: int, X: Floats) -> Floats:
    """(n,) |w| of a surface at X (n, 3) [m]; 0 outside its bounding box."""
    points = solid.surfaces[index].points
    near = ((points.min(0) <= X) & (points.max(0) >= X)).all(1)
    out = np.zeros(len(X))
    if near.any():
        out[near] = _winding(solid, index, X[near])
    return out

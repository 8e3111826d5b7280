"""The density of Gaussians on a grid, and the closed region that it shows.

    rho(x) = sum_p o_p exp(-(x - p)^T (Sigma_p + (h/2)^2 I)^-1 (x - p) / 2)

on cells of edge h: half a cell is added to every axis, so that a disc between two cells is still
seen by both.  Captures are hollow: their Gaussians lie on the surface.  So the cells where rho is
above a level are dilated until they close, what cannot be reached from outside is filled, and the
surface is taken back to where the Gaussians are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gf_usd.model import Floats, Ints

RESOLUTION = 96  # cells along the longest side
MARGIN = 12  # cells around: the widest dilation and the blur stay inside
REACH = 2.2  # [standard deviations] a Gaussian is cut off at exp(-2.4) = 0.09
LEVEL = 0.2  # rho of a solid cell: one opaque Gaussian at the corner of its cell has 0.22
PAIRS = 150_000_000  # Gaussians times cells looked at: about ten seconds
CHUNK = 4_000_000  # of them at once: bounds memory
PER_SPACING = 4.0  # cells between neighbours, at most
BRIDGES = (1.5, 3.0, 5.0, 8.0)  # [cells]
CLOSINGS = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0)  # [cells]
PATCHED = 2.0  # [cells] where none of them closes it: a side is missing, and that is closed flat
LEAK = 0.05  # share of the solid that may lie open and yet be blocked on all six sides
BLUR = 1.0  # [cells] takes the steps off
OUTER = 0.1  # share of the centres that end up outside


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Cells of a box; the centre of cell (0, 0, 0) is at low."""

    low: NDArray[np.float64]  # (3,) [m]
    h: float  # [m]
    shape: tuple[int, int, int]

    def cells(self, X: Floats) -> NDArray[np.float64]:
        """(n, 3) places of points (n, 3) [m] in cells."""
        return (np.asarray(X, float) - self.low) / self.h


@dataclass(frozen=True, kw_only=True)
class Region:
    """A closed region as a signed distance on a grid."""

    grid: Grid
    distance: NDArray[np.float64]  # [cells] positive inside, 0 on the surface
    closing: float  # [m] gaps up to twice this were closed
    capped: bool  # it was open below and was closed flat
    flat: bool  # a side was missing, and it was closed flat there


def field(
    points: Floats, axes: Floats, opacities: Floats, spacing: float
) -> tuple[Grid, NDArray[np.float64]]:
    """rho of Gaussians at points (n, 3) [m] with axes (n, 3, 3) [m] on a grid around them.

    spacing : [m] between neighbours; finer cells would see nothing but gaps.
    """
    low, high = points.min(0), points.max(0)
    h = max(float((high - low).max()) / RESOLUTION, spacing / PER_SPACING)
    covariance = axes @ np.swapaxes(axes, 1, 2)
    longest = np.sqrt(np.einsum("naa->na", covariance).max(1))
    while True:
        wide = np.sqrt(longest**2 + 0.25 * h * h)
        radius = np.ceil(REACH * wide / h).astype(int)
        if ((2.0 * radius + 1.0) ** 3).sum() <= PAIRS:
            break
        h *= 1.2
    room = max(MARGIN, int(radius.max()) + 1)
    n = np.ceil((high - low) / h).astype(int) + 1 + 2 * room
    grid = Grid(low=low - room * h, h=h, shape=(int(n[0]), int(n[1]), int(n[2])))
    inverse = np.linalg.inv(covariance / h**2 + 0.25 * np.eye(3))
    place = grid.cells(points)
    # In steps of a byte, as most files have them: a capture has one surface in every format.
    weight = np.rint(255.0 * np.asarray(opacities, float)) / 255.0
    rho = np.zeros(n.prod())
    for r in np.unique(radius):
        span = np.arange(-r, r + 1)
        offsets = np.stack(np.meshgrid(span, span, span, indexing="ij"), -1).reshape(-1, 3)
        mine = np.flatnonzero(radius == r)
        step = max(1, CHUNK // len(offsets))
        for start in range(0, len(mine), step):
            rows = mine[start : start + step]
            base = np.rint(place[rows]).astype(np.int64)
            x, y, z = ((base - place[rows])[:, None, :] + offsets).transpose(2, 0, 1)
            P = inverse[rows, :, :, None]
            q = P[:, 0, 0] * x * x + P[:, 1, 1] * y * y + P[:, 2, 2] * z * z
            q += 2.0 * (x * (P[:, 0, 1] * y + P[:, 0, 2] * z) + P[:, 1, 2] * y * z)
            at = np.ravel_multi_index(np.moveaxis(base[:, None, :] + offsets, -1, 0), grid.shape)
            value = weight[rows, None] * np.exp(-0.5 * q)
            rho += np.bincount(at.ravel(), value.ravel(), minlength=len(rho))
    return grid, rho.reshape(grid.shape)


def enclose(grid: Grid, rho: Floats, points: Floats, up: int) -> Region:
    """The region that Gaussians around points (n, 3) [m] bound; up is the index of the up axis."""
    away = _distance(rho < LEVEL)
    flat = False
    for closing in CLOSINGS:
        wall = away <= closing
        filled = _filled(wall)
        if (~filled & (_sides(wall) == 6)).sum() <= LEAK * filled.sum():
            break
    else:
        closing, flat = PATCHED, True
        wall = away <= closing
        filled = _filled(wall) | (_sides(wall) >= 5)
    above = np.logical_and.reduce([_blocked(wall, side) for side in range(6) if side != 2 * up])
    covered = filled | above
    capped = bool(covered.sum() > 2 * filled.sum())
    if capped:
        filled = covered
    signed = _distance(filled) - _distance(~filled)
    smooth = ndimage.gaussian_filter(signed, BLUR)
    at = ndimage.map_coordinates(smooth, grid.cells(points).T, order=1)
    # a surface that ate the whole body would be none: stay below the deepest cell
    level = min(float(np.quantile(at, OUTER)), 0.5 * float(smooth.max()))
    return Region(
        grid=grid, distance=smooth - level, closing=closing * grid.h, capped=capped, flat=flat
    )


def islands(rho: Floats, cells: tuple[Ints, ...]) -> NDArray[np.int64]:
    """Labels from 1 of the solid cells that hang together; 0 outside.

    cells : of each Gaussian.  Gaps are bridged until one of them has half of the Gaussians.
    """
    away = _distance(rho < LEVEL)
    for bridge in BRIDGES:
        labels = _labels(away <= bridge)
        if 2 * np.bincount(labels[cells]).max() > len(cells[0]):
            break
    return labels


def _labels(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Labels from 1 of the cells that hang together by faces; 0 outside the mask."""
    label: Any = ndimage.label  # its stub knows no pair
    return label(mask)[0]


def _filled(wall: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The wall and what cannot be reached from a corner of the grid, which lies outside."""
    outside = _labels(~wall)
    return outside != outside[0, 0, 0]


def _distance(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """[cells] from each cell of the mask to the nearest outside it."""
    return np.asarray(ndimage.distance_transform_edt(mask), float)


def _sides(wall: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Along how many of the six sides each cell sees the wall."""
    out = np.zeros(wall.shape, np.int8)
    for side in range(6):
        out += _blocked(wall, side)
    return out


def _blocked(wall: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """Cells that see the wall along a side: -x, +x, -y, +y, -z, +z (0 to 5)."""
    axis, ahead = divmod(side, 2)
    seen = np.flip(wall, axis) if ahead else wall
    seen = np.logical_or.accumulate(seen, axis=axis)
    return np.flip(seen, axis) if ahead else seen

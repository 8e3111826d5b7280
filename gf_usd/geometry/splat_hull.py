"""Surface reconstruction from captured Gaussians: a closed mesh, which is filled in their place.

Outliers are excluded from the reconstruction: Gaussians of low opacity, very large ones, isolated
ones and small clusters.  They are still animated with the body.

The others give a density on a grid with cells of edge h,

    rho(x) = sum_p o_p exp(-(x - p)^T (Sigma_p + (h/2)^2 I)^-1 (x - p) / 2)

with opacity o_p, center p and covariance Sigma_p; the added variance (h/2)^2 makes a disc between
two cell centers visible at both.  The Gaussians of a capture lie on the surface of the object, so
the cells with rho above a threshold form a hollow wall.  The wall is dilated until it is closed,
its interior is filled (cells not connected to the outside), and the surface is the level set of the
signed distance on which most Gaussians lie.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, Splats, Surface
from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import proper, weld
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.core.units import length_text, volume_text

FAINT = 0.1  # opacity below which a Gaussian is excluded
GIANT = 0.25  # of the body's diagonal: standard deviation above which it is excluded
NEIGHBORS = 8
STRAY = 10.0  # mean distance of the neighbors over the median, above which it is excluded
ISLAND = 0.02  # share of the Gaussians below which a connected component is excluded
LEAST = 50  # Gaussians needed for a reconstruction
FAR = 2.0  # [cells] from the surface: Gaussians outside beyond it are attached to its nearest point
TYPE = "ParticleField3DGaussianSplat"


def with_hulls(asset: Asset) -> Asset:
    """The asset with a reconstructed surface for each set of Gaussians, and notes.

    Raises InputError, as `hull`, with the asset's file.
    """
    if not asset.splats:
        return asset
    up = int(np.argmax(asset.facts.up))
    made = []
    for splats in asset.splats:
        try:
            made.append(hull(splats, up))
        except InputError as error:
            raise InputError(f"{asset.facts.path}: {error.message}", error.hint) from error
    notes = (*asset.facts.notes, *(f"<{s.path}>: {text}" for s, lines in made for text in lines))
    surfaces = (*asset.surfaces, *(surface for surface, _ in made))
    return replace(asset, surfaces=surfaces, splats=(), facts=replace(asset.facts, notes=notes))


def hull(splats: Splats, up: int) -> tuple[Surface, tuple[str, ...]]:
    """The surface around a set of Gaussians, and notes on what was excluded.

    up : index of the up axis.  Raises InputError where fewer than `LEAST` Gaussians are left, or
    where the surface is empty.
    """
    kept, spacing, notes = _of_the_body(splats)
    kept, grid, rho = _without_islands(splats, kept, spacing, notes)
    region = enclose(grid, rho, splats.points[kept], up)
    points, triangles = _contour(region)
    if len(triangles) == 0:
        raise InputError(
            f"<{splats.path}>: no surface could be constructed around its {len(splats)} Gaussians",
            "check that they belong to a single object, without its surroundings",
        )
    volume = signed_volume(points, triangles)
    if volume < 0.0:
        triangles = triangles[:, ::-1].copy()
    notes.append(
        f"a surface was constructed around {len(kept)} of {len(splats)} Gaussians, on cells of "
        f"{length_text(region.grid.h)}: volume {volume_text(abs(volume))}"
        + (
            f", gaps up to {length_text(2.0 * region.closing)} were closed"
            if region.closing
            else ""
        )
        + ("; its open bottom was closed with a flat face" if region.capped else "")
        + ("; a missing side was closed with a flat face" if region.flat else "")
    )
    _, near = cKDTree(splats.points[kept]).query(points, k=4)
    colors = srgb_to_linear(splats.colors[kept][near].mean(axis=1))
    surface = Surface(
        path=splats.path,
        type_name=TYPE,
        points=points,
        face_counts=np.full(len(triangles), 3),
        face_indices=triangles.ravel(),
        triangles=triangles,
        triangle_corners=np.arange(triangles.size).reshape(-1, 3),
        triangle_colors=colors[triangles],
        splats=replace(splats, anchors=_anchors(splats.points, points, triangles, FAR * grid.h)),
    )
    return surface, tuple(notes)


def _of_the_body(splats: Splats) -> tuple[Ints, float, list[str]]:
    """Rows of the Gaussians without outliers, their median distance [m] to neighbors, and notes."""
    rows = np.arange(len(splats))
    notes: list[str] = []

    def drop(bad: NDArray[np.bool_], why: str) -> None:
        nonlocal rows
        if bad.any():
            notes.append(
                f"{int(bad.sum())} of {len(splats)} Gaussians {why}:"
                " they move with it but fill nothing"
            )
            rows = rows[~bad]
        _require(splats, rows)

    drop(splats.opacities < FAINT, f"are faint (opacity below {FAINT:g})")
    near, _ = cKDTree(splats.points[rows]).query(splats.points[rows], k=NEIGHBORS + 1)
    mean = near[:, 1:].mean(axis=1)
    spacing = float(np.median(mean))
    drop(mean > STRAY * max(spacing, 1e-300), "are strays, far from all the others")
    low, high = np.quantile(splats.points[rows], (0.02, 0.98), axis=0)
    size = float(np.linalg.norm(high - low))
    longest = np.linalg.norm(splats.axes[rows], axis=1).max(axis=1)
    drop(longest > GIANT * size, f"are giants (above {GIANT:g} of the size)")
    return rows, spacing, notes


def _without_islands(
    splats: Splats, rows: Ints, spacing: float, notes: list[str]
) -> tuple[Ints, Grid, Floats]:
    """Rows without small connected components, and the grid and density of what is left."""
    grid, rho = _field(splats, rows, spacing)
    cell = np.rint(grid.cells(splats.points[rows])).astype(int)
    labels = islands(rho, tuple(cell.T))
    label = labels[tuple(cell.T)]
    count = np.bincount(label, minlength=labels.max() + 1)
    # label 0: cells below the threshold in spite of their own Gaussian
    small = (count < ISLAND * len(rows))[label] | (label == 0)
    if not small.any():
        return rows, grid, rho
    notes.append(
        f"{int(small.sum())} of {len(splats)} Gaussians are islands of fewer than"
        f" {100 * ISLAND:g} %: they move with it but fill nothing"
    )
    kept = rows[~small]
    _require(splats, kept)
    return kept, *_field(splats, kept, spacing)


def _field(splats: Splats, rows: Ints, spacing: float) -> tuple[Grid, Floats]:
    return field(splats.points[rows], splats.axes[rows], splats.opacities[rows], spacing)


def _require(splats: Splats, rows: Ints) -> None:
    if len(rows) < LEAST:
        raise InputError(
            f"<{splats.path}>: {len(rows)} of its {len(splats)} Gaussians can bound a body,"
            f" and at least {LEAST} are needed",
            "give a capture with more Gaussians, whose opacities are above"
            f" {FAINT:g} where the object is",
        )


def _anchors(X: Floats, points: Floats, triangles: Ints, far: float) -> NDArray[np.float64]:
    """(n, 3) [m] where Gaussians at X (n, 3) are attached.

    X itself inside the surface and within `far` [m] of it; elsewhere its nearest point.
    """
    center = points.mean(0)
    local = points - center
    found: Any = igl.point_mesh_squared_distance(X - center, local, triangles)
    squared, _, closest = found
    out = np.array(X, float)
    away = np.flatnonzero(squared > far * far)
    if len(away):
        w = igl.fast_winding_number(local, triangles, X[away] - center)
        away = away[np.abs(w) < 0.5]
        out[away] = closest[away] + center
    return out


def _contour(region: Region) -> tuple[NDArray[np.float64], Ints]:
    """Points (V, 3) [m] and triangles (T, 3) of the zero level set, by marching cubes."""
    n = region.grid.shape
    # igl expects x to vary fastest
    z, y, x = np.meshgrid(*(np.arange(n[d]) for d in (2, 1, 0)), indexing="ij")
    where = np.stack([x.ravel(), y.ravel(), z.ravel()], -1).astype(float)
    values = np.ascontiguousarray(region.distance.transpose(2, 1, 0)).ravel()
    march: Any = igl.marching_cubes  # its stub rejects unpacked sizes
    made = march(values, region.grid.low + region.grid.h * where, *map(int, n), 0.0)
    points = np.asarray(made[0])
    # triangles are degenerate where the surface passes through a grid point
    one, _ = weld(points)
    triangles = one[np.asarray(made[1], np.int64)]
    triangles = triangles[proper(triangles)]
    used, inner = np.unique(triangles, return_inverse=True)
    return points[used], inner.reshape(-1, 3)


RESOLUTION = 96  # cells along the longest side
MARGIN = 12  # cells around the box, for the widest dilation and the blur
REACH = 2.2  # [standard deviations] a Gaussian is truncated at exp(-2.4) = 0.09
LEVEL = 0.2  # threshold of rho: one opaque Gaussian at the corner of its cell has 0.22
PAIRS = 150_000_000  # pairs of a Gaussian and a cell that are evaluated: about ten seconds
CHUNK = 4_000_000  # pairs at a time: bounds memory
PER_SPACING = 4.0  # cells between neighbors, at most
BRIDGES = (1.5, 3.0, 5.0, 8.0)  # [cells] dilations tried to connect components
CLOSINGS = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0)  # [cells] dilations tried to close the wall
PATCHED = 2.0  # [cells] dilation where none of these closes it: one side is missing
LEAK = 0.05  # share of cells outside, yet blocked on all six sides, up to which the wall is closed
BLUR = 1.0  # [cells] standard deviation that smooths the steps between cells
OUTER = 0.1  # quantile of the signed distance at the centers, which is the level of the surface


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Cells of a box; the center of cell (0, 0, 0) is at low."""

    low: NDArray[np.float64]  # (3,) [m]
    h: float  # [m]
    shape: tuple[int, int, int]

    def cells(self, X: Floats) -> NDArray[np.float64]:
        """(n, 3) cell coordinates of points (n, 3) [m]."""
        return (np.asarray(X, float) - self.low) / self.h


@dataclass(frozen=True, kw_only=True)
class Region:
    """A closed region, as a signed distance field on a grid."""

    grid: Grid
    distance: NDArray[np.float64]  # [cells] positive inside, 0 on the surface
    closing: float  # [m] dilation: gaps up to twice as wide were closed
    capped: bool  # an open bottom was closed by a plane
    flat: bool  # a missing side was closed by a plane


def field(
    points: Floats, axes: Floats, opacities: Floats, spacing: float
) -> tuple[Grid, NDArray[np.float64]]:
    """A grid around Gaussians at points (n, 3) [m] with axes (n, 3, 3) [m], and rho on it.

    spacing : [m] median distance of neighbors, which bounds the cell size from below.
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
    margin = max(MARGIN, int(radius.max()) + 1)
    n = np.ceil((high - low) / h).astype(int) + 1 + 2 * margin
    grid = Grid(low=low - margin * h, h=h, shape=(int(n[0]), int(n[1]), int(n[2])))
    inverse = np.linalg.inv(covariance / h**2 + 0.25 * np.eye(3))
    place = grid.cells(points)
    # Quantized to 8 bits as in most files, so that every format gives the same surface.
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
    """The region that Gaussians at points (n, 3) [m] enclose; up : index of the up axis."""
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
    # at most half of the greatest depth, so that the level set is not empty
    level = min(float(np.quantile(at, OUTER)), 0.5 * float(smooth.max()))
    return Region(
        grid=grid, distance=smooth - level, closing=closing * grid.h, capped=capped, flat=flat
    )


def islands(rho: Floats, cells: tuple[Ints, ...]) -> NDArray[np.int64]:
    """Labels from 1 of the connected components of the cells with rho >= LEVEL; 0 elsewhere.

    cells : of each Gaussian.  Cells are dilated until one component has half of the Gaussians.
    """
    away = _distance(rho < LEVEL)
    for bridge in BRIDGES:
        labels = _labels(away <= bridge)
        if 2 * np.bincount(labels[cells]).max() > len(cells[0]):
            break
    return labels


def _labels(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Labels from 1 of the face-connected components of a mask; 0 outside it."""
    label: Any = ndimage.label  # its stub returns no pair
    return label(mask)[0]


def _filled(wall: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The wall and its interior: all cells not connected to a corner of the grid."""
    outside = _labels(~wall)
    return outside != outside[0, 0, 0]


def _distance(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """[cells] Euclidean distance of each cell of the mask to the nearest cell outside it."""
    return np.asarray(ndimage.distance_transform_edt(mask), float)


def _sides(wall: NDArray[np.bool_]) -> NDArray[np.int8]:
    """In how many of the six axis directions a ray from each cell hits the wall."""
    out = np.zeros(wall.shape, np.int8)
    for side in range(6):
        out += _blocked(wall, side)
    return out


def _blocked(wall: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """Cells whose ray hits the wall in one direction: -x, +x, -y, +y, -z, +z (0 to 5)."""
    axis, ahead = divmod(side, 2)
    seen = np.flip(wall, axis) if ahead else wall
    seen = np.logical_or.accumulate(seen, axis=axis)
    return np.flip(seen, axis) if ahead else seen

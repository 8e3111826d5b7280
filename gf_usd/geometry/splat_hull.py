"""A closed surface around captured Gaussians, which is filled in their place.

Gaussians that say nothing of the body are set aside: faint ones, giants, strays far from all
others and small islands.  They still ride along.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gf_usd.colour import srgb_to_linear
from gf_usd.errors import InputError
from gf_usd.geometry.splat_field import Grid, Region, enclose, field, islands
from gf_usd.model import Asset, Floats, Ints, Surface
from gf_usd.splats import Splats
from gf_usd.topology import proper, signed_volume, weld

FAINT = 0.1  # opacity below which a Gaussian is haze
GIANT = 0.25  # of the body's size: a longer standard deviation is background
NEIGHBOURS = 8
STRAY = 10.0  # mean distance of the neighbours over the median of all
ISLAND = 0.02  # share of the Gaussians below which what hangs together is no body
LEAST = 50  # Gaussians that can bound a body
FAR = 2.0  # [cells] beyond the surface: what lies farther hangs on it
TYPE = "ParticleField3DGaussianSplat"


def with_hulls(asset: Asset) -> Asset:
    """The asset with a surface for each set of Gaussians; notes say what was done.

    Raises InputError for a set that bounds no body.
    """
    if not asset.splats:
        return asset
    up = int(np.argmax(asset.facts.up))
    made = [hull(splats, up) for splats in asset.splats]
    notes = (*asset.facts.notes, *(f"{s.path}: {text}" for s, lines in made for text in lines))
    surfaces = (*asset.surfaces, *(surface for surface, _ in made))
    return replace(asset, surfaces=surfaces, splats=(), facts=replace(asset.facts, notes=notes))


def hull(splats: Splats, up: int) -> tuple[Surface, tuple[str, ...]]:
    """The surface around a set of Gaussians, and what was set aside, in words.

    Raises InputError where too few are left, or where they bound nothing.
    """
    kept, spacing, notes = _of_the_body(splats)
    kept, grid, rho = _without_islands(splats, kept, spacing, notes)
    region = enclose(grid, rho, splats.points[kept], up)
    points, triangles = _contour(region)
    if len(triangles) == 0:
        raise InputError(
            f"<{splats.path}>: no surface could be put around its {len(splats)} Gaussians",
            "check that they are those of one object, without its surroundings",
        )
    volume = signed_volume(points, triangles)
    if volume < 0.0:
        triangles = triangles[:, ::-1].copy()
    notes.append(
        f"a surface was put around {len(kept)} of {len(splats)} Gaussians, on cells of "
        f"{region.grid.h:.3g} m: volume {abs(volume):.3g} m^3"
        + (f", gaps up to {2.0 * region.closing:.3g} m closed" if region.closing else "")
        + ("; it was open below and is closed flat there" if region.capped else "")
        + ("; a side of it is missing and is closed flat" if region.flat else "")
    )
    _, near = cKDTree(splats.points[kept]).query(points, k=4)
    colours = srgb_to_linear(splats.colours[kept][near].mean(axis=1))
    surface = Surface(
        path=splats.path,
        type_name=TYPE,
        points=points,
        face_counts=np.full(len(triangles), 3),
        face_indices=triangles.ravel(),
        triangles=triangles,
        triangle_corners=np.arange(triangles.size).reshape(-1, 3),
        triangle_colours=colours[triangles],
        splats=replace(splats, anchors=_anchors(splats.points, points, triangles, FAR * grid.h)),
    )
    return surface, tuple(notes)


def _of_the_body(splats: Splats) -> tuple[Ints, float, list[str]]:
    """Rows of the Gaussians that may bound the body, their mean distance [m] from neighbours, and
    how many of the others there are.
    """
    rows = np.arange(len(splats))
    notes: list[str] = []

    def drop(bad: NDArray[np.bool_], why: str) -> None:
        nonlocal rows
        if bad.any():
            notes.append(f"{int(bad.sum())} of {len(splats)} Gaussians {why}: they only ride along")
            rows = rows[~bad]
        _require(splats, rows)

    drop(splats.opacities < FAINT, f"are faint (opacity below {FAINT:g})")
    near, _ = cKDTree(splats.points[rows]).query(splats.points[rows], k=NEIGHBOURS + 1)
    mean = near[:, 1:].mean(axis=1)
    spacing = float(np.median(mean))
    drop(mean > STRAY * max(spacing, 1e-300), "are strays, far from all others")
    low, high = np.quantile(splats.points[rows], (0.02, 0.98), axis=0)
    size = float(np.linalg.norm(high - low))
    longest = np.linalg.norm(splats.axes[rows], axis=1).max(axis=1)
    drop(longest > GIANT * size, f"are giants (above {GIANT:g} of the size)")
    return rows, spacing, notes


def _without_islands(
    splats: Splats, rows: Ints, spacing: float, notes: list[str]
) -> tuple[Ints, Grid, Floats]:
    """What is left without the small islands, and its field."""
    grid, rho = _field(splats, rows, spacing)
    cell = np.rint(grid.cells(splats.points[rows])).astype(int)
    labels = islands(rho, tuple(cell.T))
    label = labels[tuple(cell.T)]
    count = np.bincount(label, minlength=labels.max() + 1)
    # 0 are cells that even their own Gaussian hardly fills
    small = (count < ISLAND * len(rows))[label] | (label == 0)
    if not small.any():
        return rows, grid, rho
    notes.append(
        f"{int(small.sum())} of {len(splats)} Gaussians are islands of fewer than"
        f" {100 * ISLAND:g} %: they only ride along"
    )
    kept = rows[~small]
    _require(splats, kept)
    return kept, *_field(splats, kept, spacing)


def _field(splats: Splats, rows: Ints, spacing: float) -> tuple[Grid, Floats]:
    return field(splats.points[rows], splats.axes[rows], splats.opacities[rows], spacing)


def _require(splats: Splats, rows: Ints) -> None:
    if len(rows) < LEAST:
        raise InputError(
            f"<{splats.path}>: {len(rows)} of its {len(splats)} Gaussians could bound a body"
            f" (at least {LEAST})",
            "give a capture with more Gaussians, whose opacities are above"
            f" {FAINT:g} where the object is",
        )


def _anchors(X: Floats, points: Floats, triangles: Ints, far: float) -> NDArray[np.float64]:
    """(n, 3) [m] X itself inside the surface and near it; elsewhere the nearest point of it."""
    centre = points.mean(0)
    local = points - centre
    found: Any = igl.point_mesh_squared_distance(X - centre, local, triangles)
    squared, _, closest = found
    out = np.array(X, float)
    away = np.flatnonzero(squared > far * far)
    if len(away):
        w = igl.fast_winding_number(local, triangles, X[away] - centre)
        away = away[np.abs(w) < 0.5]
        out[away] = closest[away] + centre
    return out


def _contour(region: Region) -> tuple[NDArray[np.float64], Ints]:
    """Points (V, 3) [m] and triangles (T, 3) of distance 0, by marching cubes."""
    n = region.grid.shape
    # igl wants x to run fastest
    z, y, x = np.meshgrid(*(np.arange(n[d]) for d in (2, 1, 0)), indexing="ij")
    where = np.stack([x.ravel(), y.ravel(), z.ravel()], -1).astype(float)
    values = np.ascontiguousarray(region.distance.transpose(2, 1, 0)).ravel()
    march: Any = igl.marching_cubes  # its stub knows no unpacked sizes
    made = march(values, region.grid.low + region.grid.h * where, *map(int, n), 0.0)
    points = np.asarray(made[0])
    # where the surface goes through a corner of the grid, triangles have no size
    one, _ = weld(points)
    triangles = one[np.asarray(made[1], np.int64)]
    triangles = triangles[proper(triangles)]
    used, inner = np.unique(triangles, return_inverse=True)
    return points[used], inner.reshape(-1, 3)

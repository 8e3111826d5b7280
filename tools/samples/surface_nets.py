"""Quads around an implicit surface: one vertex in each lattice cell that the surface cuts.

Naive surface nets (Gibson 1998, Constrained Elastic Surface Nets): a cell's vertex is the mean of
the crossings on its edges, and each lattice edge that crosses the surface makes the quad of its
four cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tools.samples.implicit import Field
from tools.samples.quads import Quads
from tools.samples.relax import MIRROR

Floats = NDArray[np.float64]
Ints = tuple[int, int]

BLOCK = 200_000  # points of one evaluation of the field
CORNERS = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, 8).T


def surface_nets(field: Field, half: int, lo: Ints, hi: Ints, step: float) -> Quads:
    """The surface f = 0 of a field that is even in x; the mesh is exactly symmetric in x.

    Lattice samples lie at x = (k + 1/2) step, -half <= k < half, so that the middle cells and
    their vertices are on x = 0, and at y, z = k step, lo <= k <= hi.
    Raises ValueError where an edge has more than two quads: the lattice is too coarse there.
    """
    y, z = (step * np.arange(a, b + 1, dtype=np.float64) for a, b in zip(lo, hi))
    x = step * (np.arange(-half, half, dtype=np.float64) + 0.5)
    places = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1)
    blocks = np.array_split(places.reshape(-1, 3), -(-places[..., 0].size // BLOCK))
    values = np.concatenate([field(block) for block in blocks]).reshape(places.shape[:3])
    inside = values < 0.0

    total = np.zeros((*np.subtract(values.shape, 1), 3))
    count = np.zeros(total.shape[:3])
    for axis in range(3):
        at = np.argwhere(np.diff(inside, axis=axis))
        end = at + np.eye(3, dtype=int)[axis]
        f0, f1 = values[tuple(at.T)], values[tuple(end.T)]
        share = (f0 / (f0 - f1))[:, None]
        crossing = (1.0 - share) * places[tuple(at.T)] + share * places[tuple(end.T)]
        for corner in CORNERS[CORNERS[:, axis] == 0]:
            cell = tuple((at - corner).T)
            np.add.at(total, cell, crossing)
            np.add.at(count, cell, 1.0)
    cut = np.argwhere(count > 0)
    index = np.full(count.shape, -1)
    index[tuple(cut.T)] = np.arange(len(cut))
    points = total[tuple(cut.T)] / count[tuple(cut.T)][:, None]
    mirrored = index[2 * half - 2 - cut[:, 0], cut[:, 1], cut[:, 2]]
    points = 0.5 * (points + points[mirrored] * MIRROR)

    faces = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        at = np.argwhere(np.diff(inside, axis=axis))
        ring = np.stack([index[tuple((at - d).T)] for d in (u + v, v, 0 * u, u)], axis=1)
        outward = inside[tuple(at.T)]
        faces.append(np.where(outward[:, None], ring, ring[:, ::-1]))
    quads = np.concatenate(faces)
    ends = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], -1).reshape(-1, 2), axis=1)
    edges, sharing = np.unique(ends, axis=0, return_counts=True)
    if np.any(sharing != 2):
        spot = points[edges[sharing != 2][0, 0]]
        raise ValueError(f"edges with more than two quads, one near {np.round(spot, 2)}")
    return Quads(points=points, faces=quads, parts=np.full(len(quads), "body"))

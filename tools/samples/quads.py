"""All-quad meshes: the surface of a union of lattice boxes, and the gnomonic cube-sphere.

A union of boxes is the coarse topology an artist would block out: each box becomes a limb whose
edge loops run around it, box corners become the mesh's few irregular vertices, and the loop where
two boxes meet is a clean border between parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Quads:
    """A closed quad mesh, counter-clockwise seen from outside."""

    points: Floats  # (V, 3)
    faces: Ints  # (F, 4) into points
    parts: NDArray[np.str_]  # (F,) name of the part each face belongs to


@dataclass(frozen=True, kw_only=True)
class Box:
    """Lattice cells lo <= cell < hi, all of one part; a later box does not overwrite an earlier."""

    part: str
    lo: tuple[int, int, int]
    hi: tuple[int, int, int]


def box_surface(boxes: Sequence[Box]) -> Quads:
    """Boundary quads of the union of ``boxes``; points are integer lattice coordinates."""
    origin = np.min([box.lo for box in boxes], axis=0) - 1
    shape = np.max([box.hi for box in boxes], axis=0) + 1 - origin
    names = sorted({box.part for box in boxes})
    cells = np.full(shape, -1)
    for box in boxes:
        where = tuple(slice(a, b) for a, b in zip(box.lo - origin, box.hi - origin))
        block = cells[where]
        cells[where] = np.where(block < 0, names.index(box.part), block)

    corners, owners = [], []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        square = np.array([0 * u, u, u + v, v])
        for side in (0, 1):
            neighbor = np.roll(cells, 1 - 2 * side, axis=axis)
            cell = np.argwhere((cells >= 0) & (neighbor < 0))
            ring = square if side else square[::-1]
            corners.append((cell + side * np.eye(3, dtype=int)[axis])[:, None] + ring)
            owners.append(cells[tuple(cell.T)])
    flat = np.concatenate(corners).reshape(-1, 3)
    points, index = np.unique(flat, axis=0, return_inverse=True)
    return Quads(
        points=(points + origin).astype(float),
        faces=index.reshape(-1, 4),
        parts=np.array(names)[np.concatenate(owners)],
    )


def warp(lattice: Floats, planes: Sequence[Mapping[int, float]]) -> Floats:
    """Lattice coordinates to space: per axis, piecewise linear through {lattice: position}."""
    columns = [
        np.interp(lattice[:, k], list(planes[k].keys()), list(planes[k].values())) for k in range(3)
    ]
    return np.stack(columns, axis=1)


def cube_sphere(cells: int) -> Quads:
    """Unit sphere of 6 cells^2 quads; equiangular, so areas differ by less than 1.5."""
    cube = box_surface([Box(part="body", lo=(0, 0, 0), hi=(cells, cells, cells))])
    direction = np.tan((cube.points / cells - 0.5) * (np.pi / 2))
    points = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return Quads(points=points, faces=cube.faces, parts=cube.parts)

"""Tetrahedral lattice of the cells that a body fills, for solvers that need a volume mesh.

Each cell of the particles, of edge h, is split into six tetrahedra around its diagonal from
(0, 0, 0) to (1, 1, 1) (Kuhn 1960), each of volume h^3 / 6.  The same split in all cells makes the
mesh conforming.  The surface of the body is embedded in the cells, which extend beyond it by less
than one cell.

Cells that share only an edge or a corner are connected by an additional cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import CellCopies, Particles, SurfaceSamples, TetLattice
from gf_usd.core.neighbors import components

CELL = 2.0  # edge of a cell over the particle spacing
BELOW = 0.05  # [cells] depth below a surface sample at which its cell is looked up
CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def _kuhn() -> NDArray[np.int64]:
    """(6, 4) corners of the tetrahedra, each of positive volume."""
    tets = []
    for axes in permutations(range(3)):
        path = [0]
        for axis in axes:
            path.append(path[-1] + (4, 2, 1)[axis])
        even = np.linalg.det(np.diff(CORNERS[path], axis=0)) > 0.0
        tets.append(path if even else [path[0], path[2], path[1], path[3]])
    return np.array(tets)


KUHN = _kuhn()


def tet_lattices(particles: Particles, samples: SurfaceSamples) -> tuple[TetLattice, ...]:
    """The tetrahedral lattice of each body that has particles."""
    h = CELL * particles.lattice
    body = particles.body_of
    corners = particles.corner if particles.corners is None else particles.corners
    corners = np.broadcast_to(np.asarray(corners, float), (int(body.max()) + 1, 3))
    made = []
    for k in np.unique(body):
        corner = corners[k]
        copies = particles.copies
        if copies is not None:
            mine = np.flatnonzero(copies.body == k)
            cells, node = copies.cell[mine], _copied_nodes(copies, mine)
            of = mine
        else:
            places = [particles.X[body == k], _below(samples, int(k), h)]
            at = np.floor((np.concatenate(places) - corner) / h).astype(np.int64)
            cells = without_hinges(np.unique(at, axis=0))
            node = _nodes(cells)
            of = None
        made.append(_lattice(int(k), corner, h, cells, node, of))
    return tuple(made)


def _lattice(
    body: int, corner: Floats, h: float, cells: Ints, node: Ints, of: Ints | None
) -> TetLattice:
    """The lattice of one body.

    node : (K, 8) node of each corner of each cell; of : (K,) copy of each cell, or None.
    """
    count = int(node.max()) + 1
    X, copy = np.empty((count, 3)), np.zeros(count, np.int64)
    X[node] = corner + h * (cells[:, None, :] + CORNERS)
    if of is not None:
        copy[node] = of[:, None]
    tets = node[:, KUHN].reshape(-1, 4)
    return TetLattice(body=body, X=X, tets=tets, copy=None if of is None else copy)


def _below(samples: SurfaceSamples, body: int, h: float) -> Floats:
    """Points (n, 3) [m] just below the surface samples of a body."""
    if samples.normal is None:
        return np.zeros((0, 3))
    mine = slice(None) if samples.body is None else samples.body == body
    return samples.X[mine] - BELOW * h * samples.normal[mine]


def _nodes(cells: Ints) -> NDArray[np.int64]:
    """(K, 8) node of each corner of cells (K, 3), one per grid position."""
    at = (cells[:, None, :] + CORNERS).reshape(-1, 3)
    return np.unique(at, axis=0, return_inverse=True)[1].reshape(-1, 8)


def _copied_nodes(copies: CellCopies, mine: Ints) -> NDArray[np.int64]:
    """(K, 8) as `_nodes`, but cells share nodes only where they are connected by faces."""
    from scipy.sparse import coo_matrix

    row = np.full(len(copies.cell), -1)
    row[mine] = np.arange(len(mine))
    links = row[copies.links[(row[copies.links] >= 0).all(axis=1)]]
    cells = copies.cell[mine]
    step = cells[links[:, 1]] - cells[links[:, 0]]
    ends = []
    for axis in range(3):
        for way in (-1, 1):
            d = way * np.eye(3, dtype=np.int64)[axis]
            some = links[(step == d).all(axis=1)]
            first = np.flatnonzero(CORNERS[:, axis] == (way + 1) // 2)
            second = np.flatnonzero(CORNERS[:, axis] == (1 - way) // 2)
            ends.append(np.stack([8 * some[:, :1] + first, 8 * some[:, 1:] + second], -1))
    a, b = np.concatenate([pair.reshape(-1, 2) for pair in ends]).T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(8 * len(cells),) * 2)
    return np.unique(components(graph)[1], return_inverse=True)[1].reshape(-1, 8)


def without_hinges(cells: Ints) -> NDArray[np.int64]:
    """Cells (K, 3), with additional ones between any two that share only an edge or a corner."""
    there = {tuple(cell) for cell in cells.tolist()}
    steps = (*_diagonals(2), *_diagonals(3))
    known = 0
    while len(there) > known:  # a new cell may itself share only an edge with others
        known = len(there)
        for cell in sorted(there):
            for step in steps:
                other = tuple(c + s for c, s in zip(cell, step))
                if other in there and not _joined(cell, step, there):
                    there.update(_ways(cell, step)[0])
    return np.array(sorted(there), dtype=np.int64)


def _diagonals(axes: int) -> Sequence[tuple[int, ...]]:
    """The diagonal steps along a number of axes, one of each pair of opposite ones."""
    every = (tuple(s - 1 for s in index) for index in np.ndindex(3, 3, 3))
    return [step for step in every if np.count_nonzero(step) == axes and step > (0, 0, 0)]


def _joined(cell: tuple[int, ...], step: tuple[int, ...], there: set[tuple[int, ...]]) -> bool:
    """Whether a cell and the one a step away are face-connected within their common block."""
    return any(all(on in there for on in way) for way in _ways(cell, step))


def _ways(cell: tuple[int, ...], step: tuple[int, ...]) -> list[list[tuple[int, ...]]]:
    """The cells of each shortest face-connected path of a step, without its ends."""
    axes = [axis for axis in range(3) if step[axis]]
    ways = []
    for order in permutations(axes):
        at, way = list(cell), []
        for axis in order[:-1]:
            at[axis] += step[axis]
            way.append(tuple(at))
        ways.append(way)
    return ways

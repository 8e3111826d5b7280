"""Nearest neighbors, connected components and derivatives at scattered points.

Importing `scipy.sparse` takes 0.2 CPU seconds, its graphs and `scipy.spatial` 0.15 more, which is
as long as a small body takes to read, fill and set up.  They are therefore imported where they are
used, and small problems are solved without them, with identical results to the bit.

Derivatives at scattered points by least squares over neighbors, as one sparse operator.

    da/dX = [sum_j w_j (a_j - a) d_j] M^+,   M = sum_j w_j d_j d_j^T,   d_j = X_j - X

exact for affine a if the neighbors fill space.  In a direction without neighbors M is singular,
and the derivative of least norm is used, which is 0 in that direction.
"""

from __future__ import annotations

import importlib
import os
import sys
import threading
from functools import cache
from importlib.machinery import ExtensionFileLoader, PathFinder
from importlib.util import module_from_spec
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gf_usd.core import FAST_START
from gf_usd.core.arrays import Floats, Ints

if TYPE_CHECKING:
    from scipy.sparse import coo_matrix, csr_matrix
    from scipy.spatial import cKDTree


FEW = 200_000  # pairs of points of which a table of distances is made
SMALL = 50_000  # nodes of a graph, beyond which SciPy is three times as fast as libigl
SWEEPS = 8  # neighbors along a line that are searched before a tree is built
WAY = np.array([0.532, 0.311, 0.788])  # of that line: oblique, since meshes are often axis-aligned


def kd_tree(points: Floats) -> cKDTree:
    """SciPy's k-d tree of points (n, 3)."""
    return _tree()(points)


TREE = "scipy.spatial._ckdtree"


@cache
def _tree() -> type[cKDTree]:
    """The k-d tree, imported without the rest of `scipy.spatial` if SciPy has it in its own module.

    The rest are transforms and distances, which import linear algebra and special functions.
    If other threads are running, one of them could find the module partly loaded: then all of
    `scipy.spatial` is imported.
    """
    if threading.active_count() > 1 or os.environ.get(FAST_START) == "0":
        return importlib.import_module("scipy.spatial").cKDTree
    folders = [
        os.path.join(folder, "spatial") for folder in importlib.import_module("scipy").__path__
    ]
    spec = None if TREE in sys.modules else PathFinder.find_spec(TREE, folders)
    if spec is None or not isinstance(spec.loader, ExtensionFileLoader):
        return importlib.import_module("scipy.spatial").cKDTree
    module = sys.modules[TREE] = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    finally:
        if not hasattr(module, "cKDTree"):
            del sys.modules[TREE]
    return module.cKDTree


def nearest(points: Floats, at: Floats, k: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distances and indices (m, k) of the k of points (n, 3) that are nearest to each at (m, 3).

    k is at most n.  As ``kd_tree(points).query`` finds them.
    """
    if len(points) * len(at) > FEW:
        distance, index = kd_tree(points).query(at, k=list(range(1, k + 1)))
        return distance, index
    squared = squared_distances(at, points)
    index = np.argsort(squared, axis=1, kind="stable")[:, :k]
    return np.sqrt(np.take_along_axis(squared, index, 1)), index


def squared_distances(a: Floats, b: Floats) -> NDArray[np.float64]:
    """|a_i - b_j|^2, (m, n) of a (m, 3) and b (n, 3)."""
    x, y, z = zip(np.asarray(a, float).T[:, :, None], np.ascontiguousarray(np.asarray(b, float).T))
    out = np.subtract(*x)
    out *= out
    difference = np.subtract(*y)
    difference *= difference
    out += difference
    np.subtract(*z, out=difference)
    difference *= difference
    out += difference
    return out


def pairs_within(points: Floats, reach: float) -> Ints:
    """(p, 2) pairs of points (n, 3) at most `reach` apart.

    Such points are at most as far apart along any line.  Points sorted along an oblique line have
    few others within reach, and most of these are pairs.
    """
    along = points @ (WAY / np.linalg.norm(WAY))
    order = np.argsort(along)
    along, found = along[order], [np.zeros((0, 2), np.int64)]
    # Rounding of the positions along the line must not separate a pair.
    slack = reach * (1.0 + 1e-6) + 8.0 * np.finfo(float).eps * np.abs(along).max(initial=0.0)
    for step in range(1, min(SWEEPS, len(points) - 1) + 1):
        close = np.flatnonzero(along[step:] - along[:-step] <= slack)
        if not len(close):
            return np.concatenate(found)
        a, b = order[close], order[close + step]
        gap = points[a] - points[b]
        near = np.sqrt((gap * gap).sum(1)) <= reach
        found.append(np.stack([a[near], b[near]], 1))
    if len(points) <= SWEEPS + 1:
        return np.concatenate(found)
    return kd_tree(points).query_pairs(reach, output_type="ndarray")


def components(graph: coo_matrix) -> tuple[int, Ints]:
    """How many parts of an undirected graph hang together, and the part of each node (n,)."""
    count = graph.shape[0]
    if not graph.nnz:
        return count, np.arange(count)
    if count > SMALL:
        from scipy.sparse.csgraph import connected_components

        parts, part = connected_components(graph, directed=False)
        return int(parts), np.asarray(part, np.int64)
    import igl
    from scipy.sparse import csc_matrix

    ends = np.concatenate([graph.row, graph.col]), np.concatenate([graph.col, graph.row])
    both = csc_matrix((np.ones(2 * graph.nnz, np.int64), ends), shape=graph.shape)
    parts, part, _ = igl.connected_components(both)
    return int(parts), np.asarray(part, np.int64)


FLAT = 1e-9  # eigenvalue of M, next to the largest, of a direction without neighbors


def operator(near: Ints, d: Floats, w: Floats) -> csr_matrix:
    """(3 N, N) [1/m], row 3 p + b of da/dX_b at point p.

    near : (N, k) points next to each; d : (N, k, 3) [m] from it to them; w : (N, k) weights.
    """
    from scipy.sparse import csr_matrix

    n, k = near.shape
    M = np.einsum("nk,nka,nkb->nab", w, d, d)
    B = np.einsum("nk,nka,nab->nbk", w, d, np.linalg.pinv(M, rcond=FLAT, hermitian=True))
    own = np.repeat(np.arange(n, dtype=np.int32), 3)
    columns = np.concatenate([np.repeat(near.astype(np.int32), 3, axis=0), own[:, None]], 1)
    values = np.concatenate([B.reshape(3 * n, k), -B.sum(2).reshape(3 * n, 1)], 1)
    start = np.arange(0, columns.size + 1, k + 1)
    D = csr_matrix((values.ravel(), columns.ravel(), start), shape=(3 * n, n))
    D.sum_duplicates()
    return D


def slopes(D: csr_matrix, values: Floats) -> NDArray[np.float64]:
    """(N, c, 3) of values (N, c): derivative by X_b of component a in place [:, a, b]."""
    n, c = values.shape
    return np.ascontiguousarray((D @ values).reshape(n, 3, c).swapaxes(1, 2))


STENCIL = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(27, 3)


def node_copies(cell: Ints, links: Ints, loose: Ints) -> tuple[Ints, Ints]:
    """The nodes of copied cells: copies of a node are one where the solid connects their cells.

    A cell at c has the 27 nodes c + `STENCIL`.  A node of two cells with a common face is one if
    the cells are linked, and so on from cell to cell; else it has a copy for each, so that there
    are as many as the solid has connected parts within the node's support.

    cell : (K, 3); links : (E, 2) cells with a common face; loose : (K,) label: a node of cells with
    different labels, which nothing links anywhere, has one copy only.
    Returns node (K, 27) from 0, in the order of place and then of copies; and the number of copies
    of the place of each node.
    """
    from scipy.sparse import coo_matrix

    low = cell.min(0)
    dims = cell.max(0) - low + 3
    at = cell[:, None, :] - low + STENCIL
    key = ((at[..., 0] * dims[1] + at[..., 1]) * dims[2] + at[..., 2]).ravel()
    step = cell[links[:, 1]] - cell[links[:, 0]]
    ends: list[Ints] = []
    for axis in range(3):
        for way in (-1, 1):
            d = way * np.eye(3, dtype=np.int64)[axis]
            mine = links[(step == d).all(1)]
            first = np.flatnonzero(((STENCIL - d >= 0) & (STENCIL - d <= 2)).all(1))
            second = (STENCIL[first] - d) @ [9, 3, 1]
            ends.append(
                np.stack([27 * mine[:, :1] + first, 27 * mine[:, 1:] + second], -1).reshape(-1, 2)
            )
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.diff(key[order], prepend=-1))
    label = np.repeat(loose, 27)[order]
    several = np.minimum.reduceat(label, start) != np.maximum.reduceat(label, start)
    place = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(key))))
    same = np.flatnonzero((place[1:] == place[:-1]) & several[place[1:]])
    ends.append(np.stack([order[same], order[same + 1]], 1))
    a, b = np.concatenate(ends).T
    part = components(coo_matrix((np.ones(len(a)), (a, b)), shape=(len(key),) * 2))[1]
    # Nodes in the order of their places, copies of one in the order of their first slots.
    _, first, part = np.unique(part, return_index=True, return_inverse=True)
    rank = np.argsort(np.lexsort([first, key[first]]))
    copies = np.bincount(place[np.argsort(order)][first])
    node = rank[part.ravel()]
    count = np.empty(len(first), np.int64)
    count[rank] = copies[place[np.argsort(order)][first]]
    return node.reshape(-1, 27), count

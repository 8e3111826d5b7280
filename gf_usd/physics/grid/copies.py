"""Virtual nodes: copies of nodes for separate parts of the solid within their support
(docs/physics.md).

A node in the support of two separate limbs is duplicated, once for each (Molino, Bao and Fedkiw
2004; Teran et al. 2005; Mitchell et al. 2015). A cell has a copy for each connected part of the
solid in it (`CellCopies`), and a copy of a cell has its own 27 nodes, shared with those copies of
neighboring cells to which the solid connects it.

Where nodes have copies, distance does not determine connectivity. Fits for dependent nodes (light
ones, points in cells without particles) therefore search for nodes from cell to cell through the
solid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import CellCopies
from gf_usd.core.neighbors import STENCIL, components, kd_tree, node_copies

ZONE = 4.0  # [cells] distance from a node with copies beyond which no fit uses it
RINGS = 2  # steps from cell to cell, more where they reach fewer than ENOUGH nodes
ENOUGH = 24  # nodes in a fit
PAIRS = 1 << 15  # pairs of nodes processed at once: bounds memory
SLACK = 1e-4  # [cells] tolerance for a point outside of its cell
# From points (n, 3) [cells] and nodes (m, 3) to rows (n, m); None or the largest distance [cells].
Fit = Callable[[Floats, Ints, float | None], sparse.csr_matrix]


@dataclass(frozen=True, kw_only=True)
class NodeCopies:
    """The copies of cells on the grid, and the nodes of each."""

    cell: Ints  # (K, 3) base node of each
    nodes: Ints  # (K, 27) node; -1: outside of the particles' support
    cell_of: Ints  # (K,) row of `Stencil.cell_nodes` of each; -1: without particles
    steps: sparse.csr_matrix  # (K, K) adjacency of cell copies, with the diagonal
    near: NDArray[np.bool_]  # (K,) whether nodes with copies are nearby

    def renumbered(self, number: Ints) -> NodeCopies:
        """The same with other node numbers (M,)."""
        return replace(self, nodes=np.where(self.nodes < 0, -1, number[self.nodes]))

    @cached_property
    def home(self) -> Ints:
        """(M,) a cell copy that contains each node, where nodes with copies are nearby; otherwise
        -1.
        """
        out = np.full(int(self.nodes.max()) + 1, -1)
        mine = np.flatnonzero(self.near & (self.cell_of >= 0))
        out[self.nodes[mine[::-1]]] = mine[::-1, None]
        return out

    def _at(self, copy: Ints) -> sparse.csr_matrix:
        """(n, K) 1 at each of some cell copies (n,)."""
        ends = np.arange(len(copy)), copy
        shape = len(copy), len(self.cell)
        return sparse.csr_matrix((np.ones(len(copy), np.float32), ends), shape=shape)

    def base(self, cells: Floats, copy: Ints) -> Ints:
        """Base node (n, 3) of points at `cells` (n, 3), which belong to cell copies (n,).

        A point on the face of a cell is assigned to the cell of its copy.
        """
        own = self.cell[copy]
        inside: Any = (np.abs(cells - own - 1.0) <= 0.5 + SLACK).all(1)
        return np.where(inside[:, None], own, np.floor(cells - 0.5).astype(np.int64))

    def locate(self, base: Ints, copy: Ints) -> Ints:
        """Nodes (n, 27) of cells with these base nodes (n, 3), connected to cell copies (n,).

        -1 where the solid does not connect to one.
        """
        out = self.nodes[copy]
        away = np.flatnonzero((base != self.cell[copy]).any(1))
        if not len(away):
            return out
        home, group = np.unique(copy[away], return_inverse=True)
        group = group.ravel()
        ijk = base[away][:, None, :] + STENCIL
        low = self.cell.min(0) - 2
        dims = np.maximum(self.cell.max(0), base[away].max(0)) + 5 - low
        ijk = np.maximum(ijk - low, 0)
        wanted = ((group[:, None] * dims[0] + ijk[..., 0]) * dims[1] + ijk[..., 1]) * dims[2] + ijk[
            ..., 2
        ]
        # Breadth first from the given copies through the solid; the first node found is used.
        reach = self._at(home)
        keys, nodes = [], []
        for _ in range(RINGS + 1):
            at = reach.tocoo()
            place = self.cell[at.col][:, None, :] + STENCIL - low
            key = ((at.row[:, None] * dims[0] + place[..., 0]) * dims[1] + place[..., 1]) * dims[
                2
            ] + place[..., 2]
            reached = self.nodes[at.col]
            order = np.lexsort([reached[reached >= 0], key[reached >= 0]])
            keys.append(key[reached >= 0][order])
            nodes.append(reached[reached >= 0][order])
            reach = sparse.csr_matrix(reach @ self.steps)
        known, first = np.unique(np.concatenate(keys), return_index=True)
        found = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
        out[away] = np.where(known[found] == wanted, np.concatenate(nodes)[first][found], -1)
        return out

    def around(self, copy: Ints, counts: NDArray[np.bool_]) -> tuple[Ints, Ints]:
        """Pairs (index in `copy`, node) of the nodes that are connected to cell copies (n,) by the
        solid.

        counts : (M,) the nodes to be considered.
        """
        left = np.arange(len(copy))
        groups, found = [], []
        reach, rings = self._at(copy), RINGS
        while len(left):
            before = reach.nnz
            for _ in range(rings):
                reach = sparse.csr_matrix(reach @ self.steps)
                reach.data = np.ones_like(reach.data)
            rings = 1
            at = reach.tocoo()
            nodes = self.nodes[at.col]
            use = (nodes >= 0) & counts[nodes]
            row = np.repeat(at.row.astype(np.int64), 27)[use.ravel()]
            pairs = np.stack(divmod(np.unique(row * len(counts) + nodes[use]), len(counts)), 1)
            full = np.bincount(pairs[:, 0], minlength=len(left)) >= ENOUGH
            if reach.nnz == before:  # the whole connected component
                full[:] = True
            take = full[pairs[:, 0]]
            groups.append(left[pairs[take, 0]])
            found.append(pairs[take, 1])
            reach, left = reach[~full], left[~full]
        return np.concatenate(groups), np.concatenate(found)

    def through_solid(
        self, fit: Fit, at: Floats, copy: Ints, node_ijk: Ints, counts: NDArray[np.bool_]
    ) -> sparse.csr_matrix:
        """Rows (n, M) of a fit at points `at` (n, 3) [cells] that uses only nodes connected by the
        solid.

        copy : (n,) the cell copy of each; node_ijk : (M, 3); counts : (M,) the nodes to be
        considered. A row is empty where no node is connected.
        """
        home, group = np.unique(copy, return_inverse=True)
        group = group.ravel()
        of, node = self.around(home, counts)
        # The groups are placed far apart, each relative to its own cell.
        some = np.flatnonzero(np.bincount(of, minlength=len(home))[group])
        if not len(some):
            return sparse.csr_matrix((len(at), len(node_ijk)))
        group = group[some]
        local, nodes = at[some] - self.cell[home][group], node_ijk[node] - self.cell[home][of]
        span = 8.0 * (1.0 + max(np.abs(local).max(initial=0.0), np.abs(nodes).max(initial=0.0)))
        aside = np.array([np.ceil(span), 0.0, 0.0])
        rows = fit(
            local + group[:, None] * aside, nodes + of[:, None] * aside, 0.5 * float(aside[0])
        )
        put = sparse.csr_matrix(
            (np.ones(len(node)), (np.arange(len(node)), node)), shape=(len(node), len(node_ijk))
        )
        back = sparse.csr_matrix(
            (np.ones(len(some)), (some, np.arange(len(some)))), shape=(len(at), len(some))
        )
        return sparse.csr_matrix(back @ (rows @ put))


def number_nodes(copies: CellCopies, shift: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Nodes of the cell copies that contain particles, and of all copies.

    shift : (bodies, 3) [cells] that separates the bodies.

    Returns order : (C,) copies with particles, in grid order; nodes (K, 27), -1 outside of the
    particles' support; node_ijk (M, 3), in grid order; count (M,) copies of each.
    """
    cell = copies.cell + shift[copies.body]
    whole = components(
        sparse.coo_matrix(
            (np.ones(len(copies.links)), tuple(copies.links.T)), shape=(len(cell),) * 2
        )
    )[1]
    node, _ = node_copies(cell, copies.links, whole)
    full = np.unique(copies.of)
    order = full[np.lexsort([full, *cell[full].T[::-1]])]
    used = np.unique(node[full])
    number = np.full(int(node.max()) + 1, -1)
    number[used] = np.arange(len(used))
    nodes = number[node]
    ijk = np.empty((len(used), 3), np.int64)
    ijk[nodes[full]] = cell[full][:, None, :] + STENCIL
    _, place = np.unique(ijk, axis=0, return_inverse=True)
    return order, nodes, ijk, np.bincount(place.ravel())[place.ravel()]


def link_copies(
    copies: CellCopies, shift: Ints, order: Ints, nodes: Ints, node_ijk: Ints, count: Ints
) -> NodeCopies:
    """The result of `number_nodes` with the links between cell copies; nodes as the stencil numbers
    them.

    node_ijk : (M, 3), count : (M,) in that numbering.
    """
    cell = copies.cell + shift[copies.body]
    k = len(cell)
    a, b = copies.links.T
    ends = np.concatenate([a, b, np.arange(k)]), np.concatenate([b, a, np.arange(k)])
    steps = sparse.csr_matrix((np.ones(len(ends[0]), np.float32), ends), shape=(k, k))
    steps.data = np.ones_like(steps.data)
    several = node_ijk[count > 1]
    gap = kd_tree(several).query(cell + 1.0, p=np.inf)[0] if len(several) else np.full(k, np.inf)
    cell_of = np.full(k, -1)
    cell_of[order] = np.arange(len(order))
    return NodeCopies(cell=cell, nodes=nodes, cell_of=cell_of, steps=steps, near=gap <= ZONE)


class SharedNodes:
    """Connectivity of nodes by cells: nodes of one cell, and of cells that share a node.

    It separates limbs that share no node, where the nodes nearest to a point may belong to a limb
    across a gap.

    ijk : (M, 3) nodes; cells : (K, 27) nodes of each cell.
    """

    def __init__(self, ijk: Ints, cells: Ints) -> None:
        self.ijk, self.cells = ijk, cells
        start = np.arange(0, cells.size + 1, 27)
        ones = np.ones(cells.size, np.float32)
        shape = len(cells), len(ijk)
        self._in = sparse.csr_matrix((ones, cells.ravel(), start), shape=shape)
        self._of = self._in.T.tocsr()

    def unconnected_fits(self, rows: sparse.csr_matrix, nodes: Ints, seed: Ints) -> Ints:
        """Rows (n, m) over nodes (m,) that contain a node not connected to the seed of the row.

        seed : (n,) node. Two nodes are connected if a third node shares a cell with both.
        """
        at = rows.tocoo()
        row, one, other = at.row, seed[at.row], nodes[at.col]
        left = np.flatnonzero(~self._share(one, other))
        # Usually the node halfway between shares a cell with both.
        halfway = self._find((self.ijk[one[left]] + self.ijk[other[left]]) // 2)
        known = halfway >= 0
        ok = np.zeros(len(left), bool)
        ok[known] = self._share(one[left[known]], halfway[known]) & self._share(
            other[left[known]], halfway[known]
        )
        left = left[~ok]
        ok = np.zeros(len(left), bool)
        for k in range(0, len(left), PAIRS):
            some = left[k : k + PAIRS]
            a, b = (self._of[end[some]] @ self._in for end in (one, other))
            ok[k : k + PAIRS] = np.diff(sparse.csr_matrix(a.multiply(b)).indptr) > 0
        return np.unique(row[left[~ok]])

    def _share(self, one: Ints, other: Ints) -> NDArray[np.bool_]:
        """(n,) whether two nodes share a cell."""
        out = np.zeros(len(one), bool)
        near = np.flatnonzero((np.abs(self.ijk[one] - self.ijk[other]) <= 2).all(1))
        rows, at = np.unique(one[near], return_inverse=True)
        if len(rows):
            together = sparse.csr_matrix(self._of[rows] @ self._in)
            together.sort_indices()
            out[near] = np.asarray(together[at.ravel(), other[near]]).ravel() > 0
        return out

    def _find(self, ijk: Ints) -> Ints:
        """(n,) the node at each grid position; -1 where there is none."""
        low, high = self.ijk.min(0), self.ijk.max(0)
        dims = high - low + 1

        def key(at: Ints) -> Ints:
            at = np.clip(at, low, high) - low
            return (at[:, 0] * dims[1] + at[:, 1]) * dims[2] + at[:, 2]

        keys = key(self.ijk)
        order = np.argsort(keys, kind="stable")
        at = np.minimum(np.searchsorted(keys[order], key(ijk)), len(order) - 1)
        return np.where((self.ijk[order[at]] == ijk).all(1), order[at], -1)

    @cached_property
    def as_copies(self) -> NodeCopies:
        """The cells, linked where they share a node."""
        count = len(self.cells)
        return NodeCopies(
            cell=self.ijk[self.cells[:, 0]],
            nodes=self.cells,
            cell_of=np.arange(count),
            steps=sparse.csr_matrix(self._in @ self._of),
            near=np.ones(count, bool),
        )

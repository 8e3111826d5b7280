"""The reference grid: cells, nodes, and the constant interpolation operators W and G.

Quadratic B-splines on a fixed grid of spacing h (GaussianFlesh section 3.2; docs/physics.md). A
point at X is in the support of the 27 nodes of its cell, with

    w_ip = N(xi_x) N(xi_y) N(xi_z),     G_ip = dw_ip / dX,     sum_i w_ip = 1,  sum_i w_ip X_i = X_p

Dependent nodes are combinations of free ones (`dependent_nodes`, `pins`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.neighbors import STENCIL as OFFSETS
from gf_usd.physics.grid.copies import NodeCopies
from gf_usd.physics.grid.dependent_nodes import Fits
from gf_usd.physics.grid.pins import PinnedPoints

CHUNK = 1 << 16  # points processed at once: temporary arrays are many times the result


def bspline(f: Floats) -> tuple[Floats, Floats]:
    """Weights and slopes of the three quadratic B-splines around each coordinate.

    f : (..., 3) distance from the base node in cells, in [0.5, 1.5).
    Returns w, dw : (..., 3, 3), second to last axis the node 0..2, last the coordinate; dw is per
    cell (divide by h for per meter).
    """
    w = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2], -2)
    dw = np.stack([f - 1.5, -2.0 * (f - 1.0), f - 0.5], -2)
    return w, dw


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Rows of W and G for a set of points: x = X + W u, F = I + sum_b (G_b u) e_b.

    u stacks the free nodes' displacement and, where there are pins, the constants c of the
    dependent nodes.
    """

    X: Floats  # (n, 3) [m]
    W: sparse.csr_matrix  # (n, M)
    G: tuple[sparse.csr_matrix, ...]  # three, (n, M) [1/m] each; (): without gradients

    @cached_property
    def slopes(self) -> sparse.csr_matrix:
        """The three G stacked, (3 n, M): one product instead of three, for few points."""
        return sparse.csr_matrix(sparse.vstack(self.G, format="csr"))

    def nodes(self, u: Floats) -> Floats:
        """The vector (M, 3) that W and G apply to, from a stacked u (or v): see
        `embedding.SplineRows`.
        """
        return u


@dataclass(frozen=True, kw_only=True)
class Stencil:
    """Particles sorted by cell, and the nodes in their support."""

    origin: Floats  # (3,) [m] position of grid node (0, 0, 0)
    h: float  # [m]
    order: Ints  # (N,) particle indices, cell by cell
    cell_start: Ints  # (K + 1,) ranges of `order`
    cell_nodes: Ints  # (K, 27) nodes of each cell
    fx: Floats  # (N, 3) distance from the base node in cells, in `order`
    node_ijk: Ints  # (M, 3); the free nodes come first
    mass: Floats  # (free,) [kg] sum_p w_ip m_p, with the contributions of dependent nodes
    node_mass: Floats  # (M,) [kg] sum_p w_ip m_p of every node
    follow: sparse.csr_matrix  # (M - free, free) e: displacement of the dependent nodes
    shift: Floats  # (bodies, 3) [m] that separates the bodies on the grid: they share no node
    node_body: Ints  # (M,) the body of each node
    held: PinnedPoints  # pins of all nodes
    mirror: Floats  # (M, 3) [m] mirror points of pinned nodes; nan elsewhere
    mirror_share: Floats  # (M,) e, factor on the field there: see `pins`
    sorted_keys: Ints = field(repr=False)  # (M,) linear keys, ascending
    sorted_node: Ints = field(repr=False)  # (M,) the node of each sorted key
    dims: Ints = field(repr=False)  # (3,) of the key space
    corner: Ints = field(repr=False)  # (3,) ijk of key 0
    copies: NodeCopies | None = None  # of nodes near several limbs; None: no copies
    factors: Floats | None = None  # (M - free, 3) of `follow` along each axis; None: 1
    region: Ints | None = None  # (M,) rigid region (pin) of each node, -1: none; None: no regions

    @property
    def node_count(self) -> int:
        """M, the number of all nodes."""
        return len(self.node_ijk)

    @property
    def free_count(self) -> int:
        """The number of free nodes, which come first."""
        return len(self.mass)

    @cached_property
    def node_X(self) -> Floats:
        """(M, 3) [m] node positions."""
        return self.origin + self.h * self.node_ijk - self.shift[self.node_body]

    @property
    def free_X(self) -> Floats:
        """(free, 3) [m] positions of the free nodes."""
        return self.node_X[: self.free_count]

    def along(self, axis: int) -> Stencil:
        """The stencil with `follow` for one axis, where pins slide."""
        return self if self.factors is None else self._scaled(self.factors[:, axis])

    @property
    def across(self) -> Stencil:
        """The stencil with `follow` for the free axes of sliding pins."""
        return self if self.factors is None else self._scaled(self.factors.min(1))

    def _scaled(self, factors: Floats) -> Stencil:
        rows = sparse.csr_matrix(sparse.diags_array(factors) @ self.follow)
        return replace(self, follow=rows, factors=None)

    def slid(self, u: Floats) -> Floats:
        """(M - free, 3) contribution of sliding pins to c of dependent nodes, for u (free, 3) of
        the free nodes.
        """
        assert self.factors is not None
        return (self.factors - 1.0) * (self.follow @ u)

    def locate(self, ijk: Ints) -> Ints:
        """Compact index of grid nodes (..., 3), of the first copy; -1: outside of the particles'
        support.
        """
        shifted = ijk - self.corner
        inside = np.all((shifted >= 0) & (shifted < self.dims), axis=-1)
        keys = linear(np.where(inside[..., None], shifted, 0), self.dims)
        at = np.minimum(np.searchsorted(self.sorted_keys, keys), len(self.sorted_keys) - 1)
        return np.where(inside & (self.sorted_keys[at] == keys), self.sorted_node[at], -1)

    def rows(
        self,
        X: Floats,
        body: Ints | None = None,
        cell_copy: Ints | None = None,
        *,
        gradients: bool = True,
    ) -> Rows:
        """W and G of any points (n, 3) on the free nodes; with pins, also on c of dependent
        nodes.

        body : (n,) the body of each; None: the first.
        cell_copy : (n,) the cell copy of each, see `Particles.copies`; None: any.
        gradients : compute G, which takes three times the memory of W.
        """
        body = np.zeros(len(X), int) if body is None else body
        parts = [
            self._operators(
                X[k : k + CHUNK],
                body[k : k + CHUNK],
                None if cell_copy is None else cell_copy[k : k + CHUNK],
                gradients=gradients,
            )
            for k in range(0, max(len(X), 1), CHUNK)
        ]
        W, *G = (stacked([part.pop(0) for part in parts]) for _ in range(len(parts[0])))
        for one in G:
            # The node indices are shared by all four, and take as much memory as the weights.
            if np.array_equal(one.indices, W.indices):
                one.indices, one.indptr = W.indices, W.indptr
        return Rows(X=X, W=W, G=tuple(G))

    def extension(self, beyond: Ints, nodes: Ints | None = None) -> sparse.csr_matrix:
        """Rows from the stacked vector of `Rows` to nodes (k,), and to nodes (n, 3 or 4) without
        particles.

        beyond : ijk, and with `copies` the cell copy of each, or -1; nodes : None: all.
        """
        within = self._extend if nodes is None else self._extend[nodes]
        if not len(beyond):
            return sparse.csr_matrix(within)
        fitted = self._fits.affine(beyond[:, :3], self._moving, beyond[:, 3:].ravel())
        fitted = fitted @ self._extend_moving
        return sparse.csr_matrix(sparse.vstack([within, fitted], format="csr"))

    @cached_property
    def _moving(self) -> Ints:
        """(M,) nodes to which fields are fitted: free ones, those of rigid regions, and those deep
        in a pin.

        What is embedded in a pinned limb follows the limb, not the nearest nodes outside of it.
        """
        moving = np.arange(self.node_count) < self.free_count
        moving |= ~self.held.free.any(1) & np.isnan(self.mirror).any(1)
        return moving if self.region is None else moving | (self.region >= 0)

    @cached_property
    def _extend(self) -> sparse.csr_matrix:
        """`extension` to all nodes with particles."""
        free = sparse.identity(self.free_count, format="csr")
        extend = sparse.csr_matrix(sparse.vstack([free, self.follow], format="csr"))
        if not self.held.any:
            return extend
        constants = sparse.eye(self.node_count, self.node_count - self.free_count, -self.free_count)
        return sparse.csr_matrix(sparse.hstack([extend, constants], format="csr"))

    @cached_property
    def _extend_moving(self) -> sparse.csr_matrix:
        """`extension` to the nodes to which fields are fitted."""
        return sparse.csr_matrix(self._extend[np.flatnonzero(self._moving)])

    @cached_property
    def _fits(self) -> Fits:
        return Fits(self.node_ijk, self.copies, self.cell_nodes)

    def reach(
        self, X: Floats, body: Ints, cell_copy: Ints | None = None
    ) -> tuple[Ints, Floats, Ints]:
        """Nodes (n, 27) of points, -1 outside of the particles' support, and distances (n, 3) in
        cells.

        The third result is the nodes outside of the support as arguments of `extension`, (n, 27, 3
        or 4).
        """
        base, fx = self.base(X + self.shift[body])
        ijk = base[:, None, :] + OFFSETS
        if self.copies is None or cell_copy is None:
            return self.locate(ijk), fx, ijk
        near = np.flatnonzero(self.copies.near[cell_copy])
        cells = base[near] + fx[near]
        base[near] = self.copies.base(cells, cell_copy[near])
        fx[near] = cells - base[near]
        ijk = base[:, None, :] + OFFSETS
        at = self.locate(ijk)
        at[near] = self.copies.locate(base[near], cell_copy[near])
        home = np.full((len(X), 27, 1), -1)
        home[near] = cell_copy[near, None, None]
        return at, fx, np.concatenate([ijk, home], -1)

    def _operators(
        self, X: Floats, body: Ints, cell_copy: Ints | None, *, gradients: bool
    ) -> list[sparse.csr_matrix]:
        """W and optionally the three G of some points, yielded one at a time to bound memory."""
        at, fx, ijk = self.reach(X, body, cell_copy)
        missing = at < 0
        keys, inverse = np.unique(ijk[missing], axis=0, return_inverse=True)
        at[missing] = self.node_count + inverse.ravel()
        nodes, at = renumbered(at, self.node_count + len(keys))
        extend = self.extension(keys, nodes[nodes < self.node_count])
        shape = (len(X), extend.shape[0])
        index = (np.repeat(np.arange(len(X)), 27), at.ravel())
        w, g = weights(fx, self.h)

        def operator(values: Floats) -> sparse.csr_matrix:
            out = sparse.csr_matrix((values.ravel(), index), shape=shape) @ extend
            out.sort_indices()
            return out

        return [operator(w), *(operator(g[..., axis]) for axis in range(3 if gradients else 0))]

    def base(self, X: Floats) -> tuple[Ints, Floats]:
        """Base node (n, 3) and distance from it in cells (n, 3), in [0.5, 1.5)."""
        return base_node((X - self.origin) / self.h)


def base_node(cells: Floats) -> tuple[Ints, Floats]:
    """Base node and remainder of positions measured in cells."""
    base = np.floor(cells - 0.5).astype(np.int64)
    return base, cells - base


def renumbered(at: Ints, count: int) -> tuple[Ints, Ints]:
    """The numbers (m,) below `count` that occur in `at`, ascending, and `at` by their places.

    Arrays of a few points then take neither memory nor time for the nodes of all bodies.
    """
    occurs = np.zeros(count, bool)
    occurs[at] = True
    place = np.cumsum(occurs) - 1
    return np.flatnonzero(occurs), place[at].astype(at.dtype)


def stacked(parts: list[sparse.csr_matrix]) -> sparse.csr_matrix:
    """Vertically stacked sparse matrices."""
    return parts[0] if len(parts) == 1 else sparse.csr_matrix(sparse.vstack(parts, format="csr"))


def weights(fx: Floats, h: float) -> tuple[Floats, Floats]:
    """w (n, 27) and its reference gradient (n, 27, 3) [1/m], in the order of OFFSETS."""
    w, dw = bspline(fx)
    a, b, c = OFFSETS.T
    wx, wy, wz = w[:, a, 0], w[:, b, 1], w[:, c, 2]
    dx, dy, dz = dw[:, a, 0], dw[:, b, 1], dw[:, c, 2]
    return wx * wy * wz, np.stack([dx * wy * wz, wx * dy * wz, wx * wy * dz], -1) / h


def linear(ijk: Ints, dims: Ints) -> Ints:
    """Linear key of grid indices (..., 3)."""
    return (ijk[..., 0] * dims[1] + ijk[..., 1]) * dims[2] + ijk[..., 2]

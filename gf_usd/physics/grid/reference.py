"""The reference grid: cells, nodes, and the constant interpolation operators W and G.

Quadratic B-splines on a fixed grid of spacing h (GaussianFlesh section 3.2; docs/physics.md). A
point at X is in the support of the 27 nodes of its cell, with

    w_ip = N(xi_x) N(xi_y) N(xi_z),     G_ip = dw_ip / dX,     sum_i w_ip = 1,  sum_i w_ip X_i = X_p

Dependent nodes are combinations of free ones (`dependent_nodes`, `pins`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import CellCopies
from gf_usd.core.neighbors import STENCIL as OFFSETS
from gf_usd.core.stage import Pin
from gf_usd.physics.grid.copies import NodeCopies, link_copies, number_nodes
from gf_usd.physics.grid.dependent_nodes import (
    FREE_MASS,
    Fits,
    affine_fit,
    replaced,
    split_nodes,
)
from gf_usd.physics.grid.pins import (
    PinConstraint,
    PinnedPoints,
    axis_factors,
    fully_prescribed,
    mirror_points,
    pinned_by,
    prescribed_nearby,
    region_of_nodes,
    weight_on,
)

APART = 40  # [cells] between bodies on the grid: beyond the reach of a fit
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


def nodal_mass(fx: Floats, m: Floats, nodes: Ints, cell: Ints, count: int) -> Floats:
    """sum_p w_ip m_p [kg] of each of `count` nodes.

    fx (N, 3) and m (N,) by particle, in the order of cells; nodes (K, 27); cell (N,) of each.
    """
    out = np.zeros(count)
    for k in range(0, len(m), CHUNK):
        some = slice(k, k + CHUNK)
        (wx, wy, wz), (a, b, c) = np.moveaxis(bspline(fx[some])[0], 2, 0), OFFSETS.T
        w = wx[:, a] * wy[:, b] * wz[:, c]
        np.add.at(out, nodes[cell[some]].ravel(), (w * m[some, None]).ravel())
    return out


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


def apart(X: Floats, body: Ints, h: float, corners: Floats) -> Floats:
    """Shifts (bodies, 3) [m], along x, after which no two bodies share a node.

    The distance between bodies is then beyond the reach of a fit for dependent nodes, and the
    corners (bodies, 3) [m] of their cells are whole cells from the first one's.
    """
    count = int(body.max()) + 1
    if count == 1:
        return np.zeros((1, 3))
    aligned = np.remainder(corners[0] - corners, h)
    X = X + aligned[body]
    low = np.array([X[body == k, 0].min() for k in range(count)])
    high = np.array([X[body == k, 0].max() for k in range(count)])
    # body k begins APART cells after body k - 1 ends
    end = np.cumsum(high - low + APART * h) - (high - low + APART * h)
    cells = np.ceil((low[0] + end - low) / h)
    return aligned + h * cells[:, None] * (1.0, 0.0, 0.0)


def build_stencil(
    X: Floats,
    m: Floats,
    h: float,
    corner_at: Floats,
    *,
    free_mass: float = FREE_MASS,
    pin_constraint: PinConstraint | None = None,
    body: Ints | None = None,
    copies: CellCopies | None = None,
) -> Stencil:
    """Sort particles by cell and number the nodes in their support.

    X : (N, 3) [m]; m : (N,) [kg], 0 for pinned particles; h : [m].
    corner_at : (3,) [m] a corner of cells, or (bodies, 3) one per body, so that the cells are those
    for which the particles were sampled.
    free_mass : a node lighter than this fraction of the median is dependent; 0: none.
    pin_constraint : the pins; body : (N,) the body of each particle; None: there is one.
    copies : of cells that several limbs share; None: without copies.
    """
    body = np.zeros(len(X), np.int64) if body is None else body
    corners = np.broadcast_to(np.asarray(corner_at, float), (int(body.max()) + 1, 3))
    shift = apart(X, body, h, corners)
    X = X + shift[body]
    # Cells of the quadratic stencil are centered on nodes: their corners are half a cell off.
    origin = corners[0] - 0.5 * h
    base, fx = base_node((X - origin) / h)
    if copies is None:
        cells = _sorted_by_cell(base, fx)
    else:
        body_shift = np.rint((corners + shift - corners[0]) / h).astype(np.int64)
        cells = _sorted_by_copy(base + fx, copies, body_shift)
    node_ijk, mass = cells.node_ijk, cells.nodal_mass(m)
    node_body = np.empty(len(mass), np.int64)
    node_body[cells.nodes] = body[cells.order[cells.start[:-1]]][:, None]
    offset = shift[node_body]
    node_X = origin + h * node_ijk - offset
    rest = X - shift[body]
    pins = pin_constraint.pins if pin_constraint else ()
    held = pinned_by(pins, node_X, node_body)
    held = prescribed_nearby(pins, held, node_X, h, node_body)
    if pin_constraint:
        held = fully_prescribed(held, mass, node_body, node_X, pin_constraint.particles, rest, body)
    held = _without_other_limbs(held, pins, cells, rest, body)
    region = _rigid_regions(pins, cells, rest, m, held, body)
    if region is not None:
        held = PinnedPoints(axes=np.where(region[:, None] >= 0, region[:, None], held.axes))
    solid = node_ijk[held.pin >= 0]
    mirror, share = mirror_points(
        pins, held, node_X, h,
        lambda rows, X: weight_on((X + offset[rows] - origin) / h, solid),
    )  # fmt: skip
    free, follow, lumped = split_nodes(
        node_ijk,
        mass,
        free_mass,
        held=held.pin >= 0,
        mirror=(mirror + offset - origin) / h,
        share=share,
        body=node_body,
        copies=cells.copies,
        cells=cells.nodes,
    )
    ordered = np.concatenate([np.flatnonzero(free), np.flatnonzero(~free)])
    renumber = np.empty(len(mass), np.int64)
    renumber[ordered] = np.arange(len(mass))
    mirror, share = mirror[ordered], share[ordered]
    mirror[int(free.sum()) :][np.diff(follow.indptr) == 0] = np.nan  # no free node to mirror
    held = held.at(ordered)
    after = slice(int(free.sum()), None)
    factors = axis_factors(held.at(after), mirror[after])
    if factors is not None:
        deep = np.flatnonzero(held.at(after).slide & (np.diff(follow.indptr) == 0))
        at = node_ijk[ordered][after][deep]
        follow = replaced(follow, deep, -affine_fit(at, node_ijk[free]))
    corner = node_ijk.min(0)
    dims = node_ijk.max(0) + 1 - corner
    return Stencil(
        origin=origin,
        h=h,
        order=cells.order,
        cell_start=cells.start,
        cell_nodes=renumber[cells.nodes],
        fx=cells.fx,
        node_ijk=node_ijk[ordered],
        mass=lumped,
        node_mass=mass[ordered],
        follow=follow,
        shift=shift,
        node_body=node_body[ordered],
        held=held,
        mirror=mirror,
        mirror_share=share,
        sorted_keys=linear(node_ijk - corner, dims),
        sorted_node=renumber,
        dims=dims,
        corner=corner,
        copies=cells.copies.renumbered(renumber) if cells.copies else None,
        factors=factors,
        region=None if region is None else region[ordered],
    )


@dataclass(frozen=True, kw_only=True)
class _Cells:
    """Particles sorted by cell, and the nodes of the cells."""

    order: Ints  # (N,) particle of each sorted one
    start: Ints  # (K + 1,) first sorted particle of each cell
    nodes: Ints  # (K, 27) of each cell
    node_ijk: Ints  # (M, 3)
    fx: Floats  # (N, 3) from the base node to each sorted particle, in cells
    copies: NodeCopies | None = None  # of cells that several limbs share
    count: Ints | None = None  # (M,) copies of each node

    @cached_property
    def cell(self) -> Ints:
        """(N,) cell of each sorted particle."""
        return np.repeat(np.arange(len(self.nodes)), np.diff(self.start))

    def nodal_mass(self, m: Floats) -> Floats:
        """(M,) [kg] from the masses m (N,) [kg] of particles in their own order."""
        return nodal_mass(self.fx, m[self.order], self.nodes, self.cell, len(self.node_ijk))


def _sorted_by_cell(base: Ints, fx: Floats) -> _Cells:
    """Cells from the base nodes (N, 3) of particles, and fx (N, 3) from these."""
    order, start, nodes, node_ijk = number_cells(base)
    return _Cells(order=order, start=start, nodes=nodes, node_ijk=node_ijk, fx=fx[order])


def _sorted_by_copy(at: Floats, copies: CellCopies, shift: Ints) -> _Cells:
    """Cells, with copies, from the positions (N, 3) [cells] of particles.

    shift : (bodies, 3) [cells] that separates the bodies.
    """
    full, nodes, node_ijk, count = number_nodes(copies, shift)
    fx = at - (copies.cell + shift[copies.body])[copies.of]
    rank = np.empty(len(copies.cell), np.int64)
    rank[full] = np.arange(len(full))
    order = np.argsort(rank[copies.of], kind="stable")
    return _Cells(
        order=order,
        start=np.append(0, np.cumsum(np.bincount(rank[copies.of]))),
        nodes=nodes[full],
        node_ijk=node_ijk,
        fx=fx[order],
        copies=link_copies(copies, shift, full, nodes, node_ijk, count),
        count=count,
    )


def _without_other_limbs(
    held: PinnedPoints, pins: Sequence[Pin], cells: _Cells, X: Floats, body: Ints
) -> PinnedPoints:
    """Of the copies of a pinned node, only those of the limb inside the region of the pin.

    X : (N, 3) [m] particles at rest; body : (N,).
    """
    if cells.count is None or not held.any:
        return held
    inside = np.zeros(len(cells.node_ijk), bool)
    pinned = pinned_by(pins, X, body)
    inside[cells.nodes[cells.cell[pinned.pin[cells.order] >= 0]]] = True
    return PinnedPoints(axes=np.where(((cells.count > 1) & ~inside)[:, None], -1, held.axes))


def _rigid_regions(
    pins: Sequence[Pin], cells: _Cells, X: Floats, m: Floats, held: PinnedPoints, body: Ints
) -> Ints | None:
    """(M,) rigid pin of each node, -1: none; None without rigid pins.

    X : (N, 3) [m] particles at rest; m : (N,) [kg]; body : (N,).
    """
    rigid = [k for k, pin in enumerate(pins) if pin.rigid]
    if not rigid:
        return None
    masses = [cells.nodal_mass(m * pins[k].holds(X, body)) for k in rigid]
    return region_of_nodes(masses, cells.nodal_mass(m), held.pin >= 0, rigid)


def number_cells(base: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Particles sorted by cell and the nodes of the cells, from the base nodes (N, 3).

    Returns order (N,), cell_start (K + 1,), cell_nodes (K, 27) and node_ijk (M, 3).
    """
    corner = base.min(0)
    dims = base.max(0) - corner + 3
    keys = linear(base - corner, dims)
    order = np.argsort(keys, kind="stable")
    cell_keys, first = np.unique(keys[order], return_index=True)
    cell_ijk = np.stack(np.unravel_index(cell_keys, tuple(dims)), -1)
    reached = linear(cell_ijk[:, None, :] + OFFSETS, dims)
    sorted_keys, at = np.unique(reached, return_inverse=True)
    node_ijk = np.stack(np.unravel_index(sorted_keys, tuple(dims)), -1) + corner
    return order, np.append(first, len(base)), at.reshape(reached.shape), node_ijk

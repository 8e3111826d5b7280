"""Lays the reference grid around particles: sorts them by cell, numbers and classifies nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import CellCopies
from gf_usd.core.neighbors import STENCIL as OFFSETS
from gf_usd.core.stage import Pin
from gf_usd.physics.grid.copies import NodeCopies, link_copies, number_nodes
from gf_usd.physics.grid.dependent_nodes import (
    FREE_MASS,
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
from gf_usd.physics.grid.reference.stencil import CHUNK, Stencil, base_node, bspline, linear

APART = 40  # [cells] between bodies on the grid: beyond the reach of a fit


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

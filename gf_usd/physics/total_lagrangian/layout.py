"""Memory layout of a body for the kernels.

Cells are stored in groups of eight, one per SIMD lane. A batch holds one particle of each cell of a
group, all of one law. Where a cell has fewer particles than there are batches, its lane repeats a
particle with zero volume and mass (a filler). The cells of a group have similar particle counts.

`Singles` is the layout of the reference kernels (`kernels.scalar`): the particles sorted by cell,
with cells and particles instead of groups of eight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.floor import FLOOR_ROW, GIVEN_ROW, HEIGHT, NO_FLOOR, FloorContact
from gf_usd.physics.grid.mass import NodalMass
from gf_usd.physics.grid.reference.stencil import Stencil

LANES = 8
WINDOW = 4096  # cells sorted by particle count at a time, so that a group is local


@dataclass(frozen=True, kw_only=True)
class Batches:
    """Positions of the cells and particles in the kernels' arrays."""

    cells: Ints  # (G, 8) cell of each lane of a group; the last group may repeat its last cell
    batch: Ints  # (G + 1,) range of batches of each group
    source: Ints  # (B, 8) particle index of each lane; fillers repeat one
    filled: Floats  # (B, 8) 1 for a particle, 0 for a filler
    owner: Ints  # (B, 8) particle whose law a lane has; for fillers, another one of the batch

    @property
    def groups(self) -> int:
        """Number of groups."""
        return len(self.cells)

    def arrays(self, stencil: Stencil) -> dict[str, Any]:
        """The connectivity of cells and nodes, and the storage of nodal forces."""
        slot_start, slot = node_slots(stencil, self)
        return {
            "block": np.zeros((81 * self.groups, LANES)),
            "group_batch": self.batch,
            "group_nodes": group_nodes(stencil, self),
            "node_slot_start": slot_start,
            "node_slot": slot,
        }


def batch_particles(stencil: Stencil, law: Ints | None = None) -> Batches:
    """Group the cells, and split the particles of each group into batches of one law.

    law : (N,) number of each particle's law; None: all have the same.
    """
    cells = len(stencil.cell_nodes)
    cell = np.repeat(np.arange(cells), np.diff(stencil.cell_start))
    key = np.zeros(len(cell), np.int64) if law is None else law[stencil.order]
    laws = int(key.max(initial=0)) + 1
    key = cell * laws + key
    sorted_, start = np.argsort(key, kind="stable"), np.zeros(cells * laws + 1, np.int64)
    np.cumsum(np.bincount(key, minlength=cells * laws), out=start[1:])
    counts = np.diff(start).reshape(cells, laws)
    order = np.lexsort((np.arange(cells), -counts.sum(1), np.arange(cells) // WINDOW))
    missing = -len(order) % LANES
    lanes = np.append(order, np.full(missing, order[-1])).reshape(-1, LANES)
    held = counts[lanes]  # (G, 8, laws)
    held.reshape(-1, laws)[len(order) :] = 0
    runs = held.max(1)  # (G, laws) batches
    run = np.repeat(np.arange(runs.size), runs.ravel())
    group, which = np.divmod(run, laws)
    turn = np.arange(len(run)) - np.append(0, np.cumsum(runs))[run]
    mine = held[group, :, which]
    filled = turn[:, None] < mine
    # A lane without a particle of this law repeats one of its cell, with the law of another lane.
    first = np.where(mine > 0, lanes[group] * laws + which[:, None], lanes[group] * laws)
    source = stencil.order[sorted_[start[first] + np.where(filled, turn[:, None], 0)]]
    some = source[np.arange(len(run)), filled.argmax(1)]
    return Batches(
        cells=lanes,
        batch=np.append(0, np.cumsum(runs.sum(1))),
        source=source,
        filled=filled.astype(float),
        owner=np.where(mine > 0, source, some[:, None]),
    )


def lanes(batches: Batches, values: Floats, *, fill: bool = False) -> Floats:
    """Per-particle values (N,) or (N, k) as lane vectors (B k, 8); fill : keep the values of
    fillers.
    """
    out = np.asarray(values, float)[batches.source]
    if not fill:
        out = out * batches.filled.reshape(batches.filled.shape + (1,) * (out.ndim - 2))
    return np.moveaxis(out, 1, -1).reshape(-1, LANES)


def from_lanes(batches: Batches, values: Floats) -> Floats:
    """Per-particle values (N, k) of lane vectors (B k, 8); the reverse of `lanes`."""
    rows = len(batches.source)
    by_lane = np.moveaxis(values.reshape(rows, -1, LANES), 1, -1).reshape(rows * LANES, -1)
    filled = batches.filled.ravel() > 0.0
    out = np.empty((int(filled.sum()), by_lane.shape[1]), values.dtype)
    out[batches.source.ravel()[filled]] = by_lane[filled]
    return out


def law_lanes(batches: Batches, values: Floats) -> Floats:
    """`lanes` of values (N, k) of a particle's law: fillers have those of their batch.

    One lane vector of zeros where k is 0.
    """
    if not values.shape[1]:
        return np.zeros((1, LANES))
    return np.moveaxis(np.asarray(values, float)[batches.owner], 1, -1).reshape(-1, LANES)


def group_nodes(stencil: Stencil, batches: Batches) -> Ints:
    """First component, 3 x node, of the nodes of each group: (G, 27, 8), flat."""
    return 3 * np.moveaxis(stencil.cell_nodes[batches.cells], 1, -1).ravel()


def node_slots(stencil: Stencil, batches: Batches) -> tuple[Ints, Ints]:
    """For each node, the indices in the force block of the contributions of its cells.

    The block of all groups is (G, 27, 3, 8), and a slot is 8 * (81 g + 3 n) + lane.
    """
    count = len(stencil.cell_nodes)
    g, lane = np.divmod(np.arange(count), LANES)
    material_parts = LANES * (81 * g[:, None] + 3 * np.arange(27)) + lane[:, None]
    flat = stencil.cell_nodes[batches.cells.ravel()[:count]].ravel()
    order = np.argsort(flat, kind="stable")
    start = np.searchsorted(flat[order], np.arange(stencil.node_count + 1))
    return start, material_parts.ravel()[order]


# Layout of a dependent node in `anchor`: c, its rate, and the work of its pin.
ANCHOR, PIN_RATE, PIN_WORK = 7, 3, 6
MASS, GROUND, INVERSE = 3, 1, 2  # stride of `node_mass`, and the indices of two of its values


def node_arrays(stencil: Stencil, mass: NodalMass) -> dict[str, Any]:
    """Couplings between nodes as sparse rows (never empty), and nodal masses.

    A row of `follow` is of a node: for a free node its springs of the mass matrix, for a dependent
    node the free nodes it depends on. `share` is a node's contribution to others within a stage;
    `node_mass` has sum w m, the spring to the ground, and 1 / M.
    """
    up = stencil.follow.T.tocsr()
    up.sort_indices()
    down = sparse.vstack([mass.springs, stencil.follow], format="csr")
    down.sort_indices()
    none_i, none_f = np.zeros(1, int), np.zeros(1)
    ground = np.zeros(stencil.node_count)
    ground[: stencil.free_count] = mass.ground
    inverse = np.zeros(stencil.node_count)
    inverse[: stencil.free_count] = 1.0 / mass.lumped
    return {
        "follow_start": down.indptr,
        "follow_node": down.indices if down.nnz else none_i,
        "follow_weight": down.data if down.nnz else none_f,
        "leader_start": up.indptr,
        "leader_dependent": stencil.free_count + up.indices if up.nnz else none_i,
        "leader_weight": up.data if up.nnz else none_f,
        "share": np.zeros(3 * stencil.node_count),
        "node_mass": np.stack([stencil.node_mass, ground, inverse], 1).ravel(),
        **sliding_arrays(stencil, mass),
    }


def sliding_arrays(stencil: Stencil, mass: NodalMass) -> dict[str, Any]:
    """Values per axis, for a body with sliding pins: for nodes the ground springs or the factors of
    dependent nodes; for the springs of the mass matrix their strengths, in the order of `follow`.
    """
    if stencil.factors is None:
        return {"slide": np.zeros(1), "springs": np.zeros(1)}
    slide = np.ones((stencil.node_count, 3))
    slide[stencil.free_count :] = stencil.factors
    slide[: stencil.free_count] = mass.grounds
    springs = mass.strengths if mass.springs.nnz else np.zeros((1, 3))
    return {"slide": slide.ravel(), "springs": springs.ravel()}


def contact_arrays(contact: FloorContact | None, height: Floats, nodes: int) -> dict[str, Any]:
    """The arrays of contact; without contact, one sample that is never active."""
    if contact is None:
        return {
            "sample_given": np.zeros(GIVEN_ROW),
            "sample_constants": np.zeros(FLOOR_ROW),
            "sample_start": np.zeros(2, int),
            "sample_node": np.zeros(1, int),
            "sample_weight": np.zeros(1),
            "sample_force": np.zeros(3),
            "sample_spring": np.zeros(3),
            "sample_depth": np.zeros(1),
            "sample_active": np.zeros(2, int),
            "sample_capped": np.zeros(1, int),
            "node_sample_start": np.zeros(nodes + 1, int),
            "node_sample": np.zeros(1, int),
            "node_sample_weight": np.zeros(1),
        }
    W = contact.nodes
    transposed = W.T.tocsr()
    transposed.sort_indices()
    n = W.shape[0]
    given = np.zeros((n, GIVEN_ROW))
    given[:, HEIGHT] = -NO_FLOOR  # points of obstacles do not meet it
    given[: len(height), HEIGHT] = height
    return {
        "sample_given": given.ravel(),
        "sample_constants": contact.law.ravel(),
        "sample_start": W.indptr,
        "sample_node": W.indices,
        "sample_weight": W.data,
        "sample_force": np.zeros(3 * n),
        "sample_spring": np.zeros(3 * n),
        "sample_depth": np.zeros(n),
        "sample_active": np.zeros(1 + n, int),  # count of paired samples; those, then the others
        "sample_capped": np.zeros(n, int),
        "node_sample_start": transposed.indptr,
        "node_sample": transposed.indices,
        "node_sample_weight": transposed.data,
    }


@dataclass(frozen=True, kw_only=True)
class Singles(Batches):
    """Eight particles per batch regardless of their cells; the last batch is padded."""

    @property
    def groups(self) -> int:
        """Number of particles."""
        return int(self.filled.sum())

    def arrays(self, stencil: Stencil) -> dict[str, Any]:
        """See `Batches`: ranges of particles and nodes by cell, and of (cell, node) by node."""
        nodes = -(-stencil.node_count // LANES)
        order = np.argsort(stencil.cell_nodes.ravel(), kind="stable")  # 27 cell + n, by node
        counts = np.bincount(stencil.cell_nodes.ravel(), minlength=stencil.node_count)
        return {
            "block": np.zeros((3 * nodes + 12 * len(self.source), LANES)),
            "group_batch": self.batch,
            # start of the nodes of each particle's cell, followed by the nodes of the cells
            "group_nodes": np.append(
                self.groups + 27 * self.cells.ravel()[: self.groups], 3 * stencil.cell_nodes
            ),
            "node_slot_start": np.append(0, np.cumsum(counts)),
            "node_slot": order,
        }


def single_particles(stencil: Stencil) -> Singles:
    """The particles in the order of the stencil."""
    count = len(stencil.order)
    place = np.minimum(np.arange(-(-count // LANES) * LANES), count - 1)
    cell = np.repeat(np.arange(len(stencil.cell_nodes)), np.diff(stencil.cell_start))
    source = stencil.order[place].reshape(-1, LANES)
    return Singles(
        cells=cell[place].reshape(-1, LANES),
        batch=stencil.cell_start,
        source=source,
        owner=source,
        filled=(np.arange(len(place)) < count).astype(float).reshape(-1, LANES),
    )

"""Arrays of a body in the order the kernels walk them.

Particles lie cell by cell in batches of eight lanes; a batch never crosses cells and its empty
lanes repeat a neighbour with no volume and no mass, so that they add nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.model import Floats, Ints
from gf_usd.physics.contact import FloorContact
from gf_usd.physics.stencil import Stencil

LANES = 8


@dataclass(frozen=True, kw_only=True)
class Batches:
    """Where each particle went."""

    cell_batch: Ints  # (K + 1,) batches of each cell
    source: Ints  # (B, 8) particle of each lane, in the user's order; fillers repeat one
    filled: Floats  # (B, 8) 1 for a particle, 0 for a filler


def batch_particles(stencil: Stencil) -> Batches:
    """Split each cell's particles into batches of eight."""
    counts = np.diff(stencil.cell_start)
    per_cell = -(-counts // LANES)
    cell_batch = np.append(0, np.cumsum(per_cell))
    cell_of = np.repeat(np.arange(len(counts)), per_cell)
    within = np.arange(cell_batch[-1]) - cell_batch[cell_of]
    at = within[:, None] * LANES + np.arange(LANES)
    filled = at < counts[cell_of, None]
    position = stencil.cell_start[cell_of, None] + np.where(filled, at, 0)
    return Batches(
        cell_batch=cell_batch, source=stencil.order[position], filled=filled.astype(float)
    )


def lanes(batches: Batches, values: Floats, *, fill: bool = False) -> Floats:
    """Per-particle values (N,) or (N, k) laid out as flat lanes; fill keeps fillers' values."""
    out = np.asarray(values, float)[batches.source]
    if not fill:
        out = out * batches.filled.reshape(batches.filled.shape + (1,) * (out.ndim - 2))
    return np.moveaxis(out, 1, -1).ravel()


def node_slots(stencil: Stencil) -> tuple[Ints, Ints]:
    """For each node the slots (27 * cell + local) of the cells that hold a force for it."""
    flat = stencil.cell_nodes.ravel()
    slot = np.argsort(flat, kind="stable")
    start = np.searchsorted(flat[slot], np.arange(stencil.node_count + 1))
    return start, slot


def follower_arrays(stencil: Stencil) -> dict[str, Any]:
    """Both directions of `Stencil.follow`, as compressed rows; never empty."""
    down, up = stencil.follow.tocsr(), stencil.follow.T.tocsr()
    for matrix in (down, up):
        matrix.sort_indices()
    none_i, none_f = np.zeros(1, int), np.zeros(1)
    return {
        "follow_start": down.indptr,
        "follow_node": down.indices if down.nnz else none_i,
        "follow_weight": down.data if down.nnz else none_f,
        "leader_start": up.indptr,
        "leader_follower": up.indices if up.nnz else none_i,
        "leader_weight": up.data if up.nnz else none_f,
    }


def contact_arrays(contact: FloorContact | None, height: Floats, nodes: int) -> dict[str, Any]:
    """The contact part of the pack; without a floor, one sample that is never active."""
    if contact is None:
        none = {
            name: np.zeros(1) for name in ("height", "stiffness", "damping", "friction", "mass")
        }
        return {f"sample_{name}": value for name, value in none.items()} | {
            "sample_start": np.zeros(2, int),
            "sample_node": np.zeros(1, int),
            "sample_weight": np.zeros(1),
            "sample_force": np.zeros(3),
            "sample_depth": np.zeros(1),
            "sample_active": np.zeros(1, int),
            "sample_capped": np.zeros(1, int),
            "node_sample_start": np.zeros(nodes + 1, int),
            "node_sample": np.zeros(1, int),
            "node_sample_weight": np.zeros(1),
        }
    W = contact.rows.W
    transposed = W.T.tocsr()
    transposed.sort_indices()
    n = W.shape[0]
    return {
        "sample_height": height,
        "sample_stiffness": contact.stiffness,
        "sample_damping": contact.damping,
        "sample_friction": contact.friction,
        "sample_mass": contact.mass,
        "sample_start": W.indptr,
        "sample_node": W.indices,
        "sample_weight": W.data,
        "sample_force": np.zeros(3 * n),
        "sample_depth": np.zeros(n),
        "sample_active": np.zeros(n, int),
        "sample_capped": np.zeros(n, int),
        "node_sample_start": transposed.indptr,
        "node_sample": transposed.indices,
        "node_sample_weight": transposed.data,
    }

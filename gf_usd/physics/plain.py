"""Arrays of a body for the plain kernels: particles in the order of their cells, one after another.

Where the fast kernels keep groups of eight cells, these keep cells and particles: `plain_kernel`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.physics.body import LANES, Batches
from gf_usd.physics.stencil import Stencil


@dataclass(frozen=True, kw_only=True)
class Singles(Batches):
    """Eight particles in a batch, whichever cells they are in; the last batch is filled up."""

    @property
    def groups(self) -> int:
        """Particles."""
        return int(self.filled.sum())

    def arrays(self, stencil: Stencil) -> dict[str, Any]:
        """See `Batches`: ranges of particles and nodes by cell, and of (cell, node) by node."""
        nodes = -(-stencil.node_count // LANES)
        order = np.argsort(stencil.cell_nodes.ravel(), kind="stable")  # 27 cell + n, by node
        counts = np.bincount(stencil.cell_nodes.ravel(), minlength=stencil.node_count)
        return {
            "block": np.zeros((3 * nodes + 12 * len(self.source), LANES)),
            "group_batch": self.batch,
            # where the nodes of each particle's cell begin, and behind that the nodes of the cells
            "group_nodes": np.append(
                self.groups + 27 * self.cells.ravel()[: self.groups], 3 * stencil.cell_nodes
            ),
            "node_slot_start": np.append(0, np.cumsum(counts)),
            "node_slot": order,
        }


def single_particles(stencil: Stencil) -> Singles:
    """The particles of a stencil in its order."""
    count = len(stencil.order)
    place = np.minimum(np.arange(-(-count // LANES) * LANES), count - 1)
    cell = np.repeat(np.arange(len(stencil.cell_nodes)), np.diff(stencil.cell_start))
    return Singles(
        cells=cell[place].reshape(-1, LANES),
        batch=stencil.cell_start,
        source=stencil.order[place].reshape(-1, LANES),
        filled=(np.arange(len(place)) < count).astype(float).reshape(-1, LANES),
    )

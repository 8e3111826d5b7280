"""Which contact samples may meet the floor before the next frame: only those are looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Ints
from gf_usd.physics import taichi_arrays
from gf_usd.physics.total_lagrangian.setup import floor_height
from gf_usd.physics.total_lagrangian.state import constants

if TYPE_CHECKING:
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


def watch(solver: TotalLagrangian, lift: float) -> Ints:
    """The samples within reach of the floor; clears what all of them noticed.

    lift : [m] of the moving frame of u along the floor's normal.
    """
    if solver.contact is None:
        return np.zeros(0, np.int64)
    rows, normal, span = solver.contact.rows, solver.normal, solver.frame_time
    u, v = solver.state()
    speed = float(np.abs(v @ normal).max())
    g = abs(float(np.dot(solver.settings.gravity, normal)))
    reach = 2.0 * span * (speed + g * span) + solver.particles.spacing
    height = rows.X @ normal - floor_height(solver.settings)
    if solver.contact.constants is not None:
        c, rate = constants(solver)
        height = height + solver.contact.constants @ ((c + 0.5 * span * rate) @ normal)
        taichi_arrays.put(solver.arrays["sample_height"], height.astype(solver.real))
    height = height + lift + rows.W @ (u @ normal)
    for name in ("sample_force", "sample_depth", "sample_capped"):
        taichi_arrays.clear(solver.arrays[name])
    return np.flatnonzero(height < reach)


def attend(solver: TotalLagrangian, samples: Ints) -> int:
    """Have the kernels look at these samples and no others; returns how many there are.

    The nodes' side is W^T of these samples alone: the others would be summed as zeros, substep by
    substep.
    """
    if solver.contact is None:
        return 0
    taichi_arrays.clear(solver.arrays["sample_force"])
    if np.array_equal(samples, solver.attended):
        return len(samples)
    solver.attended = samples
    of_nodes = solver.contact.rows.W[samples].T.tocsr()  # in order: it is sorted by counting
    _head(solver, "sample_active", samples)
    _head(solver, "node_sample", samples[of_nodes.indices])
    _head(solver, "node_sample_weight", of_nodes.data)
    taichi_arrays.put(solver.arrays["node_sample_start"], of_nodes.indptr)
    return len(samples)


def _head(solver: TotalLagrangian, name: str, values: NDArray[Any]) -> None:
    """Put values at the beginning of an array; what follows them is not read."""
    array = solver.arrays[name]
    whole = np.zeros(array.shape, np.int32 if values.dtype.kind == "i" else solver.real)
    whole[: len(values)] = values
    taichi_arrays.put(array, whole)

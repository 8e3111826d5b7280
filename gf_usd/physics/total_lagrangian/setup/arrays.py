"""The initial values of the arrays of the kernels."""

from __future__ import annotations

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.planes.layout import pack_arrays
from gf_usd.physics.grid.goals import GOAL
from gf_usd.physics.total_lagrangian import layout, limits
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.setup.contact import floor_height
from gf_usd.physics.total_lagrangian.setup.values import viscosities
from gf_usd.physics.total_lagrangian.stages import QUEUE


def arrays(body: Body, acceleration: Floats) -> dict[str, Floats]:
    """The initial values of all arrays of the kernels, flat.

    acceleration : (free, 3) [m/s^2] body force besides gravity.
    """
    stencil, batches, per, contact = body.stencil, body.layout, body.per, body.contact
    law = body.law_at(0)
    height = np.zeros(1)
    if contact:
        height = contact.rows.X @ body.settings.normal - floor_height(body.settings)
    dependent = max(1, stencil.node_count - stencil.free_count)
    return {
        "fx": layout.lanes(batches, body.rows.fx, fill=True),
        "V0": layout.lanes(batches, per["V0"]),
        "m": layout.lanes(batches, per["density"] * per["V0"]),
        "constants": layout.law_lanes(batches, law.constants),
        "history": layout.law_lanes(batches, body.law.history),
        "viscosity": layout.lanes(batches, viscosities(body.values_at(0), body.h)),
        "u": np.zeros(3 * stencil.node_count),
        "v": body.start.ravel(),
        "acceleration": acceleration.ravel(),
        "anchor": np.zeros(layout.ANCHOR * dependent),
        "goal": np.zeros(GOAL * stencil.free_count if body.goals else 1),
        **batches.arrays(stencil),
        **layout.node_arrays(stencil, body.mass),
        **(
            body.regions.arrays(body.start[stencil.free_count :])
            if body.regions
            else {"rigid": np.zeros(1), "rigid_nodes": np.zeros(1, int)}
        ),
        **layout.contact_arrays(contact, height, stencil.node_count),
        "queue": np.zeros(QUEUE, int),
        **limits.arrays(
            batches,
            body.settings,
            stencil.h,
            body.converged,
            max(stencil.node_count, contact.count if contact else 0),
        ),
        **pack_arrays(contact.count if contact and body.options.pair_contact else 0),
    }

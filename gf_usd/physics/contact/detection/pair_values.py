"""Stiffness, mass, friction and damping of contact samples with what they touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.floor import FloorContact, damping_coefficient
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes


def pair_values(
    planes: ContactPlanes,
    contact: FloorContact,
    walls: Sequence[tuple[float | None, float | None]],
) -> dict[str, Floats]:
    """k, m, friction and damping c of each sample, and point of an obstacle, with its partner.

    Two bodies have the softer one's stiffness, their reduced mass, the geometric mean of their
    friction coefficients and the lower restitution.

    walls : (friction, restitution) of each obstacle, None: those of the sample. A point of an
    obstacle has the values of the surface that it presses.
    """
    mass, friction, restitution = contact.mass, contact.friction, contact.restitution
    n = len(mass)
    of = np.append(np.arange(n), np.maximum(planes.partner[n:], 0))
    k, m, mu, e = (
        np.array(v[of], float) for v in (contact.pair_stiffness, mass, friction, restitution)
    )
    a = planes.on_bodies
    a = a[a < n]
    b = planes.partner[a]
    k[a] = np.minimum(contact.pair_stiffness[a], contact.pair_stiffness[b])
    m[a] = mass[a] * mass[b] / (mass[a] + mass[b])
    mu[a], e[a] = np.sqrt(friction[a] * friction[b]), np.minimum(restitution[a], restitution[b])
    for number, (wall_friction, wall_restitution) in enumerate(walls):
        at = planes.obstacle == number
        if wall_friction is not None:
            mu[at] = wall_friction
        if wall_restitution is not None:
            e[at] = wall_restitution
    layer = np.array(contact.layer[of], float)
    layer[a] = layer[a] * layer[b] / (layer[a] + layer[b])
    damping = damping_coefficient(k, m, e)
    return {"stiffness": k, "mass": m, "layer": layer, "friction": mu, "damping": damping}

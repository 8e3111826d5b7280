"""The highest rates of a body at rest, for its stable step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.physics.contact.floor import FloorContact
from gf_usd.physics.grid.embedding import (
    SplineRows,
    gathered,
    stretches,
)
from gf_usd.physics.grid.mass import NodalMass
from gf_usd.physics.grid.reference.stencil import Stencil
from gf_usd.physics.grid.rigid import RigidRegions
from gf_usd.physics.grid.spectrum import largest_eigenvalue
from gf_usd.physics.time_step import StableStep, per_cell, stable_step


def largest_step(
    particles: Particles,
    h: float,
    contact: FloorContact | None,
    settings: Settings,
    per: Mapping[str, Floats],
    frequency: float | None = None,
    viscous_time: float | None = None,
) -> StableStep:
    """The stable step of the stiffest material with this contact.

    frequency : see `stable_step`; viscous_time : [s] see there, of particles that differ; at most,
        and where it is None, the longest of a particle, which may not be one of the stiffest.
    """
    share = 2.0 * per["mu"] / (per["lam"] + 2.0 * per["mu"])
    longest = float((per["damping_time"] * share).max())
    return stable_step(
        wave_speed=float(per["wave_speed"].max()),
        h=h,
        per_cell=per_cell(particles, h),
        viscous_time=longest if viscous_time is None else min(longest, viscous_time),
        contact_omega2=contact.omega2 if contact else 0.0,
        contact_damping=contact.damping_rate if contact else 0.0,
        safety=settings.safety,
        frequency=frequency,
    )


def axis_spreads(stencil: Stencil) -> list[sparse.csr_matrix]:
    """`SplineRows.spread` for each axis of u, where pins slide."""
    return [stencil.along(axis).extension(np.zeros((0, 3), int)) for axis in range(3)]


def largest_rate(
    rows: SplineRows,
    spreads: Sequence[sparse.csr_matrix],
    mass: NodalMass,
    V0: Floats,
    mu: Floats,
    lam: Floats | float,
    regions: RigidRegions | None = None,
) -> float:
    """Largest eigenvalue of M~^-1 and the forces f = -sum_p V0_p (lam tr(e) I + 2 mu e) G_ip, with
    e the symmetric part of sum_i u_i (x) G_ip.

    Of the moduli: w^2 of the fastest vibration of the body at rest. Of mu tau in place of mu, and
    lam = 0: the rate [1/s] at which Kelvin-Voigt damping stops the motion that it damps most.

    rows : of the particles; spreads : S of `SplineRows`, one for all axes of u or one for each.
    regions : the rigid regions: u has two rows for each, its translation and its rotation.
    """
    n = len(mass.lumped)
    columns = spreads[0].shape[1] if regions else n
    onto = [one[:, :columns] for one in spreads]
    back = [one.T.tocsr() for one in onto]
    shear, bulk = V0 * mu, V0 * lam

    def over(operators: list[sparse.csr_matrix], u: Floats) -> Floats:
        if len(operators) == 1:
            return operators[0] @ u
        return np.stack([one @ u[:, a] for a, one in enumerate(operators)], 1)

    def stiffness(u: Floats) -> Floats:
        if regions:
            u = np.concatenate([u[:n], regions.spread(u[n:], columns - n)])
        D = stretches(rows, over(onto, u))
        P = shear[:, None, None] * (D + D.swapaxes(1, 2))
        P[:, range(3), range(3)] += (bulk * np.einsum("naa->n", D))[:, None]
        f = over(back, gathered(rows, P))
        return np.concatenate([f[:n], regions.gathered(f[n:])]) if regions else f

    def acceleration(f: Floats) -> Floats:
        if regions is None:
            return mass.acceleration(f)
        return np.concatenate([mass.acceleration(f[:n]), regions.accelerated(f[n:])])

    start = np.random.default_rng(0).normal(size=(n + 2 * regions.count if regions else n, 3))
    return largest_eigenvalue(acceleration, stiffness, start)

"""From particles and materials to the numbers and arrays of the Updated Lagrangian solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.frames import Particles, Settings, SurfaceSamples
from gf_usd.core.stage import Pin
from gf_usd.physics.contact.floor import FloorContact, largest_eigenvalue
from gf_usd.physics.grid.reference import Rows, Stencil
from gf_usd.physics.laws.registry import ParticleLaws
from gf_usd.physics.total_lagrangian import setup
from gf_usd.physics.updated_lagrangian.riding import CARRIERS, Ride, board


def refuse(settings: Settings, pins: Sequence[Pin]) -> None:
    """Raise UsageError for what this solver does not know."""
    asked = {
        "--pin": bool(pins),
        "the WLS recomputation of F": settings.wls,
        "the Procrustes correction": settings.procrustes > 0.0,
    }
    for what, wanted in asked.items():
        if wanted:
            raise UsageError(
                f"--solver ul does not know {what}: its grid has no rest state",
                "leave it out, or use --solver tl",
            )


def start_motion(velocity: Any, rows: Rows, stencil: Stencil) -> dict[str, Floats]:
    """v (N, 3), C and L (N, 3, 3) of the particles: what the nodes of the grid at rest hand back.

    velocity : (3,) [m/s] or a callable X (n, 3) -> (n, 3).
    """
    X = stencil.node_X
    nodes = velocity(X) if callable(velocity) else velocity
    nodes = np.broadcast_to(np.asarray(nodes, float), X.shape)
    v = np.asarray(rows.W @ nodes)
    # sum_i w v_i (x) (X_i - X_p), taken about each particle's own place.
    first = np.stack([rows.W @ (nodes * X[:, b : b + 1]) for b in range(3)], -1)
    return {
        "v": v,
        "C": 4.0 / stencil.h**2 * (first - v[:, :, None] * rows.X[:, None, :]),
        "L": np.stack([G @ nodes for G in rows.G], -1),
    }


def floor_contact(
    samples: SurfaceSamples | None,
    particles: Particles,
    stencil: Stencil,
    rows: Rows,
    settings: Settings,
    per: dict[str, Floats],
) -> tuple[FloorContact | None, Ride | None]:
    """Stiffness and damping as for the Total Lagrangian solver, on samples carried by particles."""
    contact = setup.surface_contact(samples, particles, stencil, settings, per)
    if contact is None or samples is None:
        return None, None
    ride = board(samples.X, particles.X)
    B = ride.rows(rows)
    return replace(
        contact,
        omega2=largest_eigenvalue(B, contact.stiffness, stencil.mass),
        damping_rate=largest_eigenvalue(B, contact.damping, stencil.mass),
    ), ride


def arrays(
    X: Floats,
    motion: dict[str, Floats],
    per: dict[str, Floats],
    law: ParticleLaws,
    contact: FloorContact | None,
    ride: Ride | None,
) -> dict[str, Floats]:
    """Every array of the kernels' pack but those of the grid, flat.  X (N, 3) [m] local."""
    n = len(X)
    whole = {
        name: np.zeros(n, int) for name in ("key", "rank", "order", "clamped", "stress_capped")
    }
    return {
        "x": X.ravel(),
        **{name: value.ravel() for name, value in motion.items()},
        "F": np.tile(np.eye(3).ravel(), n),
        "m": per["density"] * per["V0"],
        "V0": per["V0"],
        "constants": law.constants.ravel(),
        "history": law.history.ravel() if law.set.flows else np.zeros(1),
        "viscosity": 2.0 * per["mu"] * per["damping_time"],
        "push": np.zeros(12 * n),
        "box": np.zeros(9, int),
        **whole,
        **_contact_arrays(contact, ride, n),
    }


def _contact_arrays(contact: FloorContact | None, ride: Ride | None, n: int) -> dict[str, Floats]:
    """The contact part; without a floor, one sample that is never active."""
    if contact is None or ride is None:
        carrier, weight, arm = (
            np.zeros((1, CARRIERS), int),
            np.zeros((1, CARRIERS)),
            np.zeros((1, CARRIERS, 3)),
        )
        springs = dict.fromkeys(("stiffness", "damping", "friction", "mass"), np.zeros(1))
    else:
        carrier, weight, arm = ride.particle, ride.weight, ride.arm
        springs = {
            "stiffness": contact.stiffness,
            "damping": contact.damping,
            "friction": contact.friction,
            "mass": contact.mass,
        }
    count = len(carrier)
    order = np.argsort(carrier.ravel(), kind="stable")
    return {
        **{f"sample_{name}": value for name, value in springs.items()},
        "sample_force": np.zeros(3 * count),
        "sample_depth": np.zeros(count),
        "sample_active": np.zeros(count, int),
        "sample_capped": np.zeros(count, int),
        "ride_particle": carrier.ravel(),
        "ride_weight": weight.ravel(),
        "ride_arm": arm.ravel(),
        "particle_ride_start": np.searchsorted(carrier.ravel()[order], np.arange(n + 1)),
        "particle_ride": order,
    }


def grid_arrays(nodes: int, cells: int) -> dict[str, Floats]:
    """Room for a box of so many nodes, of whose cells so many hold particles."""
    return {
        "slot": np.zeros(nodes, int),
        "node_v": np.zeros(3 * nodes),
        "block": np.zeros(108 * cells),
        "cell_key": np.zeros(cells, int),
        "cell_start": np.zeros(cells + 1, int),
    }

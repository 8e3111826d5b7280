"""The contact samples of bodies, with the material that they contact with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import Collider, Pin
from gf_usd.physics.contact.floor import (
    NO_FLOOR,
    FloorContact,
    build_contact,
    hertz_pressure,
    plane_modulus,
)
from gf_usd.physics.contact.obstacles.edge_points import capacity
from gf_usd.physics.grid.bodies import bodies_of
from gf_usd.physics.grid.mass import NodalMass
from gf_usd.physics.grid.pins import boundary_held
from gf_usd.physics.grid.reference.stencil import Stencil

PILE = 8.0  # number of bodies on top of one for which the contact stiffness is designed


def surface_contact(
    samples: SurfaceSamples | None,
    particles: Particles,
    stencil: Stencil,
    settings: Settings,
    per: Mapping[str, Floats],
    pins: Sequence[Pin] = (),
    *,
    pair_contact: bool = False,
    datum: float = np.inf,
    speed: float = 0.0,
    mass: NodalMass | None = None,
    colliders: Sequence[Collider] = (),
    carried: sparse.csr_matrix | None = None,
) -> FloorContact | None:
    """Contact samples with the material of the nearest particle; None where there is no contact.

    Samples inside a pin are left out.

    pair_contact : there is contact besides that with the floor.
    datum : [m] lowest point of the obstacles along the floor's normal.
    speed : [m/s] of the fastest body at the start; mass : of the nodes, None: lumped.
    colliders : obstacles whose edges and corners are contact samples, too.
    carried : see `build_contact`.
    """
    if samples is None or (settings.floor is None and not pair_contact):
        return None
    free = boundary_held(pins, samples.X, samples.body).pin < 0
    if not free.any():
        return None
    samples = samples.subset(free)
    bodies = bodies_of(particles, per["density"])
    body = np.zeros(len(samples.X), np.int64) if samples.body is None else samples.body
    near = bodies.nearest(samples.X, particles.X, body)
    up = settings.normal
    heights = samples.X @ up + np.dot(settings.lift, up)
    lowest = np.array([heights[body == k].min(initial=np.inf) for k in range(bodies.count)])
    ground = min(datum, lowest.min()) if settings.floor is None else settings.floor
    g = max(0.0, -float(np.dot(settings.gravity, up)))
    fall = np.maximum(0.0, lowest - ground)[body]
    # Bodies on top of a body add to its weight.
    weight = g * np.minimum(bodies.mass.sum(), PILE * bodies.mass)[body]
    modulus = plane_modulus(per["youngs_modulus"][near], per["poissons_ratio"][near])
    return build_contact(
        samples,
        stencil,
        spacing=particles.spacing,
        density=per["density"][near],
        modulus=modulus,
        friction=per["friction"][near],
        restitution=per["restitution"][near],
        pressure=hertz_pressure(
            weight=weight,
            radius=bodies.radius[body],
            modulus=modulus,
        ),
        impact_speed=np.sqrt(speed**2 + 2.0 * g * fall),
        rate=settings.contact_rate,
        mass=mass,
        points=capacity(colliders, len(samples.X), particles.spacing),
        carried=carried,
    )


def floor_height(settings: Settings) -> float:
    """[m] height of the floor along its normal; far below the bodies where there is none."""
    return NO_FLOOR if settings.floor is None else settings.floor

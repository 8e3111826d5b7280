"""From particles and materials to the numbers and arrays of a solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import Particles, Settings, SurfaceSamples, spread
from gf_usd.core.materials import Material
from gf_usd.core.stage import Pin
from gf_usd.physics import taichi_arrays
from gf_usd.physics.bodies import bodies_of
from gf_usd.physics.contact.floor import FloorContact, build_contact, hertz_pressure
from gf_usd.physics.grid.pins import held_by
from gf_usd.physics.grid.reference import Stencil
from gf_usd.physics.laws.registry import ParticleLaws
from gf_usd.physics.time_step import StableStep, per_cell, stable_step
from gf_usd.physics.total_lagrangian import layout, limits
from gf_usd.physics.total_lagrangian.stages import GATE

NO_FLOOR = -1e9  # [m] where no sample ever comes
PILE = 8.0  # bodies on top of one that its contact is laid out to carry


def per_particle(
    particles: Particles, materials: Sequence[Material], held: Ints | None = None
) -> dict[str, Floats]:
    """Material values spread over particles, (N,) each, and the rest volume that is simulated.

    held : (N,) pin of each particle, -1 for none; what a pin holds has no volume for the solver.
    """
    per = spread(particles, materials)
    free = np.ones(len(particles)) if held is None else (held < 0).astype(float)
    return {**per, "V0": particles.V0 * free}


def surface_contact(
    samples: SurfaceSamples | None,
    particles: Particles,
    stencil: Stencil,
    settings: Settings,
    per: dict[str, Floats],
    pins: Sequence[Pin] = (),
    *,
    meets: bool = False,
    datum: float = np.inf,
    speed: float = 0.0,
) -> FloorContact | None:
    """Contact samples with the material of the nearest particle; None where there is no contact.

    What a pin holds feels none.
    meets : there is more to meet than the floor; datum : [m] of the lowest of it along the floor's
    normal; speed : [m/s] of the fastest body at the start.
    """
    if samples is None or (settings.floor is None and not meets):
        return None
    free = held_by(pins, samples.X).pin < 0
    if not free.any():
        return None
    samples = SurfaceSamples(
        X=samples.X[free],
        area=samples.area[free],
        normal=None if samples.normal is None else samples.normal[free],
        body=None if samples.body is None else samples.body[free],
    )
    bodies = bodies_of(particles, per["density"])
    body = np.zeros(len(samples.X), np.int64) if samples.body is None else samples.body
    near = bodies.nearest(samples.X, particles.X, body)
    up = settings.normal
    heights = samples.X @ up + np.dot(settings.lift, up)
    lowest = np.array([heights[body == k].min(initial=np.inf) for k in range(bodies.count)])
    ground = min(datum, lowest.min()) if settings.floor is None else settings.floor
    g = max(0.0, -float(np.dot(settings.gravity, up)))
    fall = np.maximum(0.0, lowest - ground)[body]
    # What lies on top of a body presses as its own weight does.
    weight = g * np.minimum(bodies.mass.sum(), PILE * bodies.mass)[body]
    return build_contact(
        samples,
        stencil,
        spacing=particles.spacing,
        density=per["density"][near],
        wave_speed=per["wave_speed"][near],
        friction=per["friction"][near],
        restitution=per["restitution"][near],
        pressure=hertz_pressure(
            weight=weight,
            radius=bodies.radius[body],
            youngs=per["youngs_modulus"][near],
            poisson=per["poissons_ratio"][near],
        ),
        impact_speed=np.sqrt(speed**2 + 2.0 * g * fall),
        rate=settings.contact_rate,
    )


def floor_height(settings: Settings) -> float:
    """[m] of the floor along its normal; far below where there is none."""
    return NO_FLOOR if settings.floor is None else settings.floor


def largest_step(
    particles: Particles,
    h: float,
    contact: FloorContact | None,
    settings: Settings,
    per: dict[str, Floats],
) -> StableStep:
    """The stable step of the stiffest material with this contact."""
    share = 2.0 * per["mu"] / (per["lam"] + 2.0 * per["mu"])
    return stable_step(
        wave_speed=float(per["wave_speed"].max()),
        h=h,
        per_cell=per_cell(particles, h),
        viscous_time=float((per["damping_time"] * share).max()),
        contact_omega2=contact.omega2 if contact else 0.0,
        contact_damping=contact.damping_rate if contact else 0.0,
        safety=settings.safety,
    )


def arrays(
    particles: Particles,
    stencil: Stencil,
    batches: layout.Batches,
    contact: FloorContact | None,
    settings: Settings,
    per: dict[str, Floats],
    law: ParticleLaws,
    velocity: Floats,
    acceleration: Floats,
    converged: float,
) -> dict[str, Floats]:
    """Every array of the kernels' pack, flat.

    velocity (M, 3) [m/s] on the nodes; acceleration (free, 3) [m/s^2] of a body force.
    """
    fx = np.empty_like(stencil.fx)
    fx[stencil.order] = stencil.fx
    height = np.zeros(1)
    if contact:
        height = contact.rows.X @ settings.normal - floor_height(settings)
    followers = max(1, stencil.node_count - stencil.free_count)
    return {
        "fx": layout.lanes(batches, fx, fill=True),
        "V0": layout.lanes(batches, per["V0"]),
        "m": layout.lanes(batches, per["density"] * per["V0"]),
        "constants": layout.law_lanes(batches, law.constants),
        "history": layout.law_lanes(batches, law.history),
        "viscosity": layout.lanes(batches, 2.0 * per["mu"] * per["damping_time"]),
        "u": np.zeros(3 * stencil.node_count),
        "v": velocity.ravel(),
        "inverse_mass": 1.0 / stencil.mass,
        "node_mass": stencil.node_mass,
        "acceleration": acceleration.ravel(),
        "share": np.zeros(3 * followers),
        "anchor": np.zeros(3 * followers),
        "anchor_rate": np.zeros(3 * followers),
        "work": np.zeros(followers),
        **batches.arrays(stencil),
        **layout.follower_arrays(stencil),
        **layout.contact_arrays(contact, height, stencil.free_count),
        "gate": np.zeros(GATE, int),
        **limits.arrays(batches, settings, stencil.h, converged),
    }


def to_device(values: dict[str, Floats], real: type) -> dict[str, Any]:
    """Taichi ndarrays: int32 for whole numbers, else `real` (numpy float32 or float64).

    Rows of lanes become vectors.
    """
    import taichi as ti

    kind = ti.f64 if real is np.float64 else ti.f32
    out = {}
    for name, value in values.items():
        whole = np.issubdtype(value.dtype, np.integer)
        value = np.ascontiguousarray(value, dtype=np.int32 if whole else real)
        made = ti.i32 if whole else kind
        if value.ndim > 1:
            made = ti.types.vector(value.shape[1], made)
        out[name] = ti.ndarray(made, value.shape[:1])
        taichi_arrays.put(out[name], value)
    return out

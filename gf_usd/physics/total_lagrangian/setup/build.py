"""Builds the constant data of a Total Lagrangian body from particles and materials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import CellCopies, Particles, SurfaceSamples
from gf_usd.core.frames.settings import LUMPED, Settings
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import ContactSetup, Goals, Pin
from gf_usd.physics.grid.bodies import fastest, start_velocity
from gf_usd.physics.grid.dependent_nodes import FREE_MASS
from gf_usd.physics.grid.embedding import (
    SplineRows,
    embedded_rows,
    particle_rows,
)
from gf_usd.physics.grid.goals import NodeGoals, NodeSprings
from gf_usd.physics.grid.mass import NodalMass, consistent_mass, lumped_mass
from gf_usd.physics.grid.pins import PinConstraint, PinnedPoints, surface_held
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.grid.reference.stencil import Stencil
from gf_usd.physics.grid.rigid import rigid_regions
from gf_usd.physics.laws.registry import particle_laws
from gf_usd.physics.time_step import StableStep, wave_speed
from gf_usd.physics.total_lagrangian import layout, limits
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.setup.contact import surface_contact
from gf_usd.physics.total_lagrangian.setup.rates import axis_spreads, largest_rate, largest_step
from gf_usd.physics.total_lagrangian.setup.values import (
    at_largest_moduli,
    per_particle,
    with_soft_material,
)

if TYPE_CHECKING:
    pass


CELL_PER_LATTICE = 2.0  # h over the lattice spacing: eight particles in a full cell


def build_body(
    particles: Particles,
    materials: Sequence[Material],
    settings: Settings,
    *,
    samples: SurfaceSamples | None,
    embedded: Mapping[str, Floats] | None,
    velocity: Any,
    pins: Sequence[Pin],
    contact_setup: ContactSetup | None,
    goals: Goals | None,
    embedded_body: Mapping[str, int] | None,
    embedded_copy: Mapping[str, Ints] | None,
    h: float | None,
    real: type,
    plain: bool,
    cells: bool | None,
) -> Body:
    """Build a body; parameters as for `TotalLagrangian`. Taichi must be initialized.

    Raises InputError for pins that hold nothing, or everything.
    """
    import taichi as ti

    from gf_usd.physics.total_lagrangian.kernels.substep import build, pack_type
    from gf_usd.system.taichi_runtime import epoch, resident_blocks

    particles = with_soft_material(particles, materials, [pin for pin in pins if pin.rigid])
    pin_constraint = PinConstraint(pins, particles.X, particles.body) if pins else None
    per = per_particle(
        particles, materials, pin_constraint.particles.pin if pin_constraint else None
    )
    stiffest = at_largest_moduli(per, particles.keys, settings)
    m = per["density"] * per["V0"]
    h = h or settings.cell or CELL_PER_LATTICE * particles.lattice
    copies = _copies(particles, h)
    stencil = build_stencil(
        particles.X,
        m,
        h,
        particles.corner if particles.corners is None else particles.corners,
        free_mass=FREE_MASS if settings.followers else 0.0,
        pin_constraint=pin_constraint,
        body=particles.body,
        copies=copies,
    )
    held, regions = {}, None
    if pin_constraint:
        pin_constraint.check(stencil.held)
        held = _held_points(pin_constraint, pins, embedded or {}, embedded_body or {})
        regions = rigid_regions(stencil, m, pin_constraint.pins)
    lumped = settings.mass == LUMPED
    mass = lumped_mass(stencil) if lumped else consistent_mass(stencil, m)
    rows = particle_rows(stencil, particles.X)
    frequency = strained = viscous_time = None
    damped = stiffest["damping_time"] > 0.0
    if not lumped:
        ways = (rows.spread,) if stencil.factors is None else axis_spreads(stencil)
        V0, mu, lam, tau = (stiffest[name] for name in ("V0", "mu", "lam", "damping_time"))
        density = stiffest["density"]
        w2 = largest_rate(rows, ways, mass, V0, mu, lam, regions)
        frequency = float(np.sqrt(w2) * h / stiffest["wave_speed"].max())
        strained = float(np.sqrt(w2) * h) / wave_speed(
            lam + 2.0 * mu, density, stencil.order, stencil.cell_start
        )
        if w2 and damped.any() and any(np.ptp(one) > 0.0 for one in (tau, mu, lam, density)):
            viscous_time = largest_rate(rows, ways, mass, V0, mu * tau, 0.0, regions) / w2
    start = start_velocity(velocity, stencil.node_X, stencil.node_body)
    pair_contact = contact_setup is not None and contact_setup.any
    contact = surface_contact(
        samples, particles, stencil, settings, stiffest, pins,
        pair_contact=pair_contact,
        datum=contact_setup.lowest(settings.normal) if contact_setup else np.inf,
        speed=fastest(start), mass=mass,
        colliders=contact_setup.colliders if contact_setup else (),
    )  # fmt: skip
    if not (pair_contact and contact):
        contact_setup = None
    cells = not plain and (settings.device != "cpu" if cells is None else cells)
    springs = limits.LIMITED if goals and goals.limits else limits.SPRINGS
    options = limits.options_of(
        settings, contact_setup is not None, plain, cells, stencil.factors is not None,
        springs if goals else limits.NO_GOALS,
        driven=contact is not None and pin_constraint is not None and pin_constraint.moving,
        rigid=regions.count if regions else 0,
    )  # fmt: skip
    step = largest_step(particles, h, contact, settings, stiffest, frequency, viscous_time)
    law = particle_laws(materials, particles.material, per)
    kind = ti.f64 if real is np.float64 else ti.f32
    return Body(
        particles=particles,
        settings=settings,
        real=real,
        per=per,
        m=m,
        h=h,
        stencil=stencil,
        mass=mass,
        rows=rows,
        embedded=_embedded(stencil, embedded or {}, embedded_body or {}, embedded_copy or {}),
        pin_constraint=pin_constraint,
        regions=regions,
        goals=_node_goals(goals, stencil, mass, step) if goals else None,
        held=held,
        contact=contact,
        contact_setup=contact_setup,
        start=start,
        step=step,
        frequency=strained,
        damped=None if viscous_time is None else damped,
        layout=(
            layout.single_particles(stencil)
            if plain
            else layout.batch_particles(stencil, law.of if law.set.several else None)
        ),
        options=options,
        law=law,
        kernels=build(law.set, bool(damped.any()), kind, epoch(), options, resident_blocks()),
        pack_type=pack_type(kind, epoch()),
    )


def _held_points(
    constraint: PinConstraint,
    pins: Sequence[Pin],
    embedded: Mapping[str, Floats],
    body: Mapping[str, int],
) -> dict[str, PinnedPoints]:
    """The pinned points of each embedded set, by name, and those of the particles, "".

    body : that each set belongs to, by name.
    """
    held = {
        name: surface_held(pins, X, np.full(len(X), body.get(name, 0)))
        for name, X in embedded.items()
    }
    for index, pin in enumerate(pins):
        for name in pin.meshes & held.keys():
            held[name] = PinnedPoints(axes=np.full(held[name].axes.shape, index))
    return {**held, "": constraint.particles}


def _embedded(
    stencil: Stencil,
    embedded: Mapping[str, Floats],
    body: Mapping[str, int],
    copies: Mapping[str, Ints],
) -> dict[str, SplineRows]:
    """The rows of each embedded set; body, copies : those that it belongs to, by name."""
    return {
        name: embedded_rows(stencil, X, np.full(len(X), body.get(name, 0)), copies.get(name))
        for name, X in embedded.items()
    }


def _node_goals(goals: Goals, stencil: Stencil, mass: NodalMass, step: StableStep) -> NodeGoals:
    """The goals of the free nodes."""
    return NodeGoals(
        goals,
        stencil.free_X,
        step.dt,
        mass.lightest,
        node_springs(goals, stencil, mass),
        stencil.node_body[: stencil.free_count],
    )


def node_springs(goals: Goals, stencil: Stencil, mass: NodalMass) -> NodeSprings | None:
    """The springs of single attached points, distributed to the free nodes; None without such
    points.
    """
    attached = goals.attached
    if attached is None:
        return None
    rows = embedded_rows(stencil, attached.X, attached.body, attached.cell_copy)
    W = rows.combined[:, : stencil.free_count]
    return NodeSprings(attached, sparse.csr_matrix(W), mass.lumped)


def _copies(particles: Particles, h: float) -> CellCopies | None:
    """The cell copies of the particles. Raises ValueError where they were made for another cell
    size.
    """
    if particles.copies is not None and not np.isclose(particles.copies.h, h, rtol=1e-9):
        raise ValueError(f"cells are copied at an edge of {particles.copies.h} m, not {h} m")
    return particles.copies

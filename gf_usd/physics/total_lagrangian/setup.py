"""Builds the constant data of a Total Lagrangian body from particles and materials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.frames import LUMPED, CellCopies, Particles, Pose, Settings, SurfaceSamples
from gf_usd.core.materials.keys import ValueKeys
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import spread, with_derived
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Collider, ContactSetup, Goals, Pin
from gf_usd.physics.contact.floor import (
    NO_FLOOR,
    FloorContact,
    build_contact,
    hertz_pressure,
    plane_modulus,
)
from gf_usd.physics.contact.obstacles.edge_points import capacity
from gf_usd.physics.contact.planes.layout import pack_arrays
from gf_usd.physics.grid.bodies import bodies_of, fastest, start_velocity
from gf_usd.physics.grid.dependent_nodes import FREE_MASS
from gf_usd.physics.grid.embedding import (
    SplineRows,
    embedded_rows,
    gathered,
    particle_rows,
    stretches,
)
from gf_usd.physics.grid.goals import GOAL, NodeGoals, NodeSprings
from gf_usd.physics.grid.mass import NodalMass, consistent_mass, lumped_mass
from gf_usd.physics.grid.pins import PinConstraint, PinnedPoints, boundary_held, surface_held
from gf_usd.physics.grid.reference import Stencil, build_stencil
from gf_usd.physics.grid.rigid import RigidRegions, rigid_regions
from gf_usd.physics.grid.spectrum import largest_eigenvalue
from gf_usd.physics.laws.registry import MODULI, ParticleLaws, convergence, particle_laws
from gf_usd.physics.time_step import StableStep, per_cell, stable_step, wave_speed
from gf_usd.physics.total_lagrangian import layout, limits
from gf_usd.physics.total_lagrangian.stages import QUEUE

if TYPE_CHECKING:
    from types import SimpleNamespace


CELL_PER_LATTICE = 2.0  # h over the lattice spacing: eight particles in a full cell
PILE = 8.0  # number of bodies on top of one for which the contact stiffness is designed


@dataclass(frozen=True, kw_only=True)
class Body:
    """The constant data of one or several bodies on one grid."""

    particles: Particles
    settings: Settings
    real: type  # numpy dtype of the kernels
    per: Mapping[str, Floats]  # material values of the particles, (N,) each: `per_particle`
    m: Floats  # (N,) [kg]; 0 for pinned particles
    h: float  # [m] edge of a cell
    stencil: Stencil
    mass: NodalMass  # of the free nodes
    rows: SplineRows  # of the particles on the nodes
    embedded: Mapping[str, SplineRows]  # of each set of embedded points
    pin_constraint: PinConstraint | None  # the pins
    regions: RigidRegions | None  # the rigid regions
    goals: NodeGoals | None  # springs that pull the free nodes to a pose
    held: Mapping[str, PinnedPoints]  # embedded points that a pin holds; "": particles
    contact: FloorContact | None
    contact_setup: ContactSetup | None  # contact besides that with the floor; None: there is none
    start: Floats  # (M, 3) [m/s] velocity of the nodes at the start
    step: StableStep
    frequency: float | None  # [c/h] highest at rest, c by `wave_speed`; None: by `grid_frequency`
    damped: Ints | None  # (N,) whether particles are damped; None: all alike
    layout: layout.Batches  # order of cells and particles in the kernels' arrays
    options: limits.Options
    law: ParticleLaws
    kernels: SimpleNamespace
    pack_type: Any  # of the kernels' arguments

    @property
    def in_place(self) -> bool:
        """Whether pins or goals determine the position of the body, so that it cannot fall as a
        whole.
        """
        pins = self.pin_constraint
        return (pins is not None and pins.prescribed) or self.goals is not None

    @property
    def driven(self) -> bool:
        """Whether pins or goals are animated."""
        pins, goals = self.pin_constraint, self.goals
        return (pins is not None and pins.moving) or (goals is not None and goals.moving)

    @property
    def converged(self) -> float:
        """See `convergence`."""
        return convergence(self.real)

    def law_at(self, index: int) -> ParticleLaws:
        """The constitutive laws between frames `index` - 1 and `index`, with the moduli at the
        middle.
        """
        if self.particles.keys is None:
            return self.law
        values, q = self.values_at(index), np.array(self.law.q)
        q[:MODULI] = values["mu"], values["lam"]
        return replace(self.law, q=q)

    def values_at(self, index: int) -> Mapping[str, Floats]:
        """`per` with animated values as they are in the middle between frames `index` - 1 and
        `index`.
        """
        keys = self.particles.keys
        if keys is None:
            return self.per
        return {**self.per, **keys.at(self.settings.time_code(max(index - 0.5, 0.0)))}

    @property
    def internal(self) -> tuple[str, ...]:
        """Names of the per-particle arrays that are part of the state besides u and v."""
        anchored = ("F0",) if self.options.anchored else ()
        return (*anchored, "history") if self.law.set.flows else anchored

    def constrained(
        self, name: str, rows: SplineRows, free: Pose, index: int, offset: Floats
    ) -> Pose:
        """The pose of embedded points (or "", the particles) at a frame, with pinned points as
        prescribed.

        rows, free : of the embedded points; offset : (3,) [m] of the moving frame.
        """
        if self.pin_constraint is None:
            return free
        time = self.settings.frame_time
        return self.pin_constraint.override(self.held[name], rows.X, free, index, time, offset)


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


def per_particle(
    particles: Particles, materials: Sequence[Material], held: Ints | None = None
) -> dict[str, Floats]:
    """Material values per particle, (N,) each, and the rest volume V0 [m^3] that is simulated.

    held : (N,) pin of each particle, -1 for none; a pinned particle has V0 = 0.
    """
    per = spread(particles, materials)
    free = np.ones(len(particles)) if held is None else (held < 0).astype(float)
    return {**per, "V0": particles.V0 * free}


def at_largest_moduli(
    per: dict[str, Floats], keys: ValueKeys | None, settings: Settings
) -> dict[str, Floats]:
    """Material values per particle, with the largest moduli and damping of all frames.

    The damping rate of the stiffest vibration is proportional to mu tau, so the maxima of mu and
    tau bound it at all times.
    """
    if keys is None:
        return per
    most = keys.most(settings.time_code(max(k - 0.5, 0.0)) for k in range(settings.frames))
    return with_derived({**per, **{name: most[name] for name in ("mu", "lam", "damping_time")}})


def with_soft_material(
    particles: Particles, materials: Sequence[Material], regions: Sequence[Pin]
) -> Particles:
    """Particles of rigid regions with the material of the nearest soft particle, but their own
    density.

    Strain in a region occurs only in its outermost cells, between its nodes and free ones.

    Raises InputError where all particles are in rigid regions.
    """
    if not regions:
        return particles
    inside = np.any([pin.holds(particles.X, particles.body) for pin in regions], axis=0)
    flesh, stone = np.flatnonzero(~inside), np.flatnonzero(inside)
    if not len(flesh):
        raise InputError(
            f"--rigid {', '.join(pin.name for pin in regions)} holds all {len(inside)} particles",
            "leave some of the body soft",
        )
    if not len(stone):
        return particles
    nearest = flesh[kd_tree(particles.X[flesh]).query(particles.X[stone])[1]]
    of = np.arange(len(inside))
    of[stone] = nearest
    own = {name: values[of] for name, values in (particles.own or {}).items()}
    own["density"] = spread(particles, materials)["density"]
    keys = particles.keys
    return replace(
        particles,
        material=np.asarray(particles.material)[of],
        own=own,
        keys=replace(keys, of=keys.of[of]) if keys else None,
    )


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


def viscosities(per: Mapping[str, Floats], h: float) -> Floats:
    """(N, 2) 2 mu tau [Pa s] of Kelvin-Voigt damping and c2 rho0 h^2 [Pa s^2] of the shock
    viscosity.

    Both are 0 for a material without damping, which conserves energy.

    per : of `Body.values_at`; h : [m] edge of a cell.
    """
    from gf_usd.physics.laws.stress import SHOCK

    tau, mu = per["damping_time"], per["mu"]
    return np.column_stack([2.0 * mu * tau, (tau > 0.0) * SHOCK * per["density"] * h * h])


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

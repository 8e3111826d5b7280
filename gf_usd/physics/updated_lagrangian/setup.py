"""Builds the constant data of an Updated Lagrangian body, and its arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import stiffest_by_conversion
from gf_usd.core.stage import ContactSetup, Pin
from gf_usd.physics.contact.floor import FLOOR_ROW, FloorContact
from gf_usd.physics.grid.bodies import fastest
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.grid.reference.stencil import CHUNK, Stencil
from gf_usd.physics.laws.registry import ParticleLaws, convergence, particle_laws
from gf_usd.physics.time_step import StableStep
from gf_usd.physics.total_lagrangian.setup.build import CELL_PER_LATTICE
from gf_usd.physics.total_lagrangian.setup.contact import surface_contact
from gf_usd.physics.total_lagrangian.setup.rates import largest_step
from gf_usd.physics.total_lagrangian.setup.values import per_particle, viscosities
from gf_usd.physics.total_lagrangian.stages import QUEUE
from gf_usd.physics.updated_lagrangian.embedded_points import (
    SUPPORT,
    EmbeddedPoints,
    attach,
    embed,
)
from gf_usd.physics.updated_lagrangian.planes import ROW
from gf_usd.physics.updated_lagrangian.walls import PARTS, Planes, Wall, planes
from gf_usd.system.taichi_runtime import epoch, resident_blocks

if TYPE_CHECKING:
    from types import SimpleNamespace


@dataclass(frozen=True, kw_only=True)
class Body:
    """The constant data of a body."""

    particles: Particles
    settings: Settings
    real: type  # numpy dtype of the kernels
    per: Mapping[str, Floats]  # material values of the particles, (N,) each
    m: Floats  # (N,) [kg]
    h: float  # [m] edge of a cell
    center: Floats  # (3,) [m] of mass
    phase: Floats  # (3,) [cells] position of the grid's node 0 relative to the offset
    start: Mapping[str, Floats]  # v (N, 3), C and L (N, 3, 3): `start_motion`
    embedded: Mapping[str, EmbeddedPoints]
    contact: FloorContact | None
    embedding: EmbeddedPoints | None  # of the contact samples
    step: StableStep
    law: ParticleLaws
    walls: Planes | None
    pair_contact: bool  # samples may have contact planes of obstacles and of solid bodies
    kernels: SimpleNamespace
    pack_type: Any  # of the kernels' arguments

    @property
    def converged(self) -> float:
        """See `convergence`."""
        return convergence(self.real)


def build_body(
    particles: Particles,
    materials: Sequence[Material],
    settings: Settings,
    *,
    samples: SurfaceSamples | None,
    embedded: Mapping[str, Floats] | None,
    velocity: Any,
    walls: Sequence[Wall],
    h: float | None,
    real: type,
    contact_setup: ContactSetup | None = None,
) -> Body:
    """Build a body; parameters as for `UpdatedLagrangian`. Taichi must be initialized."""
    import taichi as ti

    from gf_usd.physics.updated_lagrangian.kernels.substep import build, pack_type

    per = per_particle(particles, materials)
    m = per["density"] * per["V0"]
    h = h or settings.cell or CELL_PER_LATTICE * particles.lattice
    at_rest = build_stencil(particles.X, m, h, particles.corner, free_mass=0.0)
    law = particle_laws(materials, particles.material, per)
    embed_samples = attach if law.unbounded.any() or particles.conversions else embed
    stiffest = stiffest_by_conversion(per, particles, materials)
    start = start_motion(velocity, particles.X, at_rest, particles.body)
    # all flowing particles are one body, whichever body they belonged to
    particles = replace(particles, body=None)
    samples = None if samples is None else replace(samples, body=None)
    setup = contact_setup
    contact, embedding = floor_contact(
        samples, particles, at_rest, settings, stiffest, embed_samples,
        pair_contact=setup is not None and (setup.flows or bool(setup.colliders)),
        datum=setup.lowest(settings.normal) if setup is not None else np.inf,
        speed=fastest(start["v"]),
    )  # fmt: skip
    pair_contact = (
        contact is not None and setup is not None and (setup.flows or bool(setup.colliders))
    )
    center = m @ particles.X / m.sum()
    damped = bool((stiffest["damping_time"] > 0).any())
    clamp, cap = settings.clamp is not None, settings.stress_cap is not None
    kind = ti.f64 if real is np.float64 else ti.f32
    lift = np.asarray(settings.lift, float)
    return Body(
        particles=particles,
        settings=settings,
        real=real,
        per=per,
        m=m,
        h=h,
        center=center,
        phase=(at_rest.origin - center) / h,
        start=start,
        embedded={name: embed(X, particles.X) for name, X in (embedded or {}).items()},
        contact=contact,
        embedding=embedding,
        step=largest_step(particles, h, contact, settings, stiffest),
        law=law,
        walls=planes(walls, particles.X + lift, at_rest.origin + lift, h) if walls else None,
        pair_contact=pair_contact,
        kernels=build(
            law.set, damped, clamp, cap, bool(walls), kind, epoch(), pair_contact, resident_blocks()
        ),
        pack_type=pack_type(kind, epoch()),
    )


def refuse(settings: Settings, pins: Sequence[Pin]) -> None:
    """Raise UsageError for options that this solver does not support."""
    unsupported = {
        "--pin": bool(pins),
        "the WLS recomputation of F": settings.wls,
        "the Procrustes correction": settings.procrustes > 0.0,
    }
    for what, wanted in unsupported.items():
        if wanted:
            raise UsageError(
                f"--solver ul does not support {what}: its grid has no rest state",
                "leave it out, or use --solver tl",
            )


def start_motion(
    velocity: Any, X: Floats, stencil: Stencil, body: Ints | None = None
) -> dict[str, Floats]:
    """v (N, 3), C and L (N, 3, 3) of particles at X: one P2G and G2P of the initial velocity.

    velocity : (3,) [m/s] or a callable X (n, 3) -> (n, 3), or a list of these, one for each body.
    body : (N,) of the particles.
    """
    out = {"v": np.zeros((len(X), 3)), "C": np.zeros((len(X), 3, 3)), "L": np.zeros((len(X), 3, 3))}
    of = np.zeros(len(X), np.int64) if body is None else np.asarray(body)
    several = isinstance(velocity, list)
    for number, one in enumerate(velocity if several else [velocity]):
        mine = np.flatnonzero(of == number) if several else np.arange(len(X))
        if not callable(one):
            out["v"][mine] = one
            continue
        nodes = np.broadcast_to(np.asarray(one(stencil.node_X), float), stencil.node_X.shape)
        for k in range(0, len(mine), CHUNK):
            _grid_to_particles(out, mine[k : k + CHUNK], X, nodes, stencil)
    return out


def _grid_to_particles(
    out: dict[str, Floats], some: Ints, X: Floats, nodes: Floats, stencil: Stencil
) -> None:
    """Set v, C and L of some particles from velocities (M, 3) of the nodes (G2P)."""
    rows = stencil.rows(X[some])
    v = np.asarray(rows.W @ nodes)
    # sum_i w v_i (x) (X_i - X_p), relative to each particle's position
    first = np.stack([rows.W @ (nodes * stencil.node_X[:, b : b + 1]) for b in range(3)], -1)
    out["v"][some] = v
    out["C"][some] = 4.0 / stencil.h**2 * (first - v[:, :, None] * X[some][:, None, :])
    out["L"][some] = np.stack([G @ nodes for G in rows.G], -1)


def floor_contact(
    samples: SurfaceSamples | None,
    particles: Particles,
    stencil: Stencil,
    settings: Settings,
    per: dict[str, Floats],
    embed_samples: Callable[[Floats, Floats], EmbeddedPoints] = embed,
    *,
    pair_contact: bool = False,
    datum: float = np.inf,
    speed: float = 0.0,
) -> tuple[FloorContact | None, EmbeddedPoints | None]:
    """Contact with stiffness and damping as for the Total Lagrangian solver, on embedded samples.

    embed_samples : how the samples are embedded in the particles at rest, `embed` or `attach`.
    pair_contact, datum, speed : as for `surface_contact`; without contact, only the fall speed
        matters.
    """
    if samples is None or (settings.floor is None and not pair_contact):
        return None, None
    embedding = embed_samples(samples.X, particles.X)
    used, within = np.unique(embedding.particle, return_inverse=True)
    some = replace(embedding, particle=within.reshape(embedding.particle.shape))
    # attached points need no gradients
    B = some.rows(stencil.rows(particles.X[used], gradients=not embedding.single))
    contact = surface_contact(
        samples, particles, stencil, settings, per,
        pair_contact=pair_contact, datum=datum, speed=speed if pair_contact else 0.0, carried=B,
    )  # fmt: skip
    return contact, embedding


def arrays(body: Body) -> dict[str, Floats]:
    """The initial values of all arrays of the kernels but those of the grid, flat."""
    X, per = body.particles.X - body.center, body.per
    n = len(X)
    whole = {
        name: np.zeros(n, int) for name in ("key", "rank", "order", "clamped", "stress_capped")
    }
    return {
        "x": X.ravel(),
        **{name: value.ravel() for name, value in body.start.items()},
        "F": np.tile(np.eye(3).ravel(), n),
        "m": per["density"] * per["V0"],
        "V0": per["V0"],
        "constants": body.law.constants.ravel(),
        "history": body.law.history.ravel() if body.law.set.flows else np.zeros(1),
        "viscosity": viscosities(per, body.h).ravel(),
        "push": np.zeros(12 * n),
        "wall_impulse": np.zeros(3 * PARTS),
        "grid": np.zeros(7, int),  # see `kernels.sorting`
        "queue": np.zeros(QUEUE, int),
        **whole,
        **_contact_arrays(body.contact, body.embedding, n, body.pair_contact),
    }


def _contact_arrays(
    contact: FloorContact | None, embedding: EmbeddedPoints | None, n: int, pair_contact: bool
) -> dict[str, Floats]:
    """The arrays of contact; without contact, one sample that is never active."""
    if contact is None or embedding is None:
        support, weight, arm = (
            np.zeros((1, SUPPORT), int),
            np.zeros((1, SUPPORT)),
            np.zeros((1, SUPPORT, 3)),
        )
        law = np.zeros(FLOOR_ROW)
    else:
        support, weight, arm = embedding.particle, embedding.weight, embedding.arm
        law = contact.law.ravel()
    count = len(support)
    order = np.argsort(support.ravel(), kind="stable")
    return {
        "sample_constants": law,
        "sample_force": np.zeros(3 * count),
        "sample_spring": np.zeros(3 * count),
        "sample_depth": np.zeros(count),
        "sample_active": np.zeros(count, int),
        "sample_capped": np.zeros(count, int),
        "sample_plane": np.full(count, -1),
        "plane": np.zeros(ROW * (count if pair_contact else 1)),
        "support_particle": support.ravel(),
        "support_weight": weight.ravel(),
        "support_arm": arm.ravel(),
        "particle_support_start": np.searchsorted(support.ravel()[order], np.arange(n + 1)),
        "particle_support": order,
    }


def grid_arrays(nodes: int, cells: int, walled: bool) -> dict[str, Floats]:
    """Arrays for the given numbers of nodes, a power of 2, and of cells that contain particles."""
    return {
        "node_of": np.zeros(2 * nodes, int),
        "node_at": np.zeros(3 * nodes, int),
        "node_cells": np.zeros(27 * nodes, int),
        "node_v": np.zeros(3 * nodes),
        "node_given": np.zeros(3 * nodes if walled else 1),
        "block": np.zeros(108 * cells),
        "cell_at": np.zeros(3 * cells, int),
        "cell_nodes": np.zeros(27 * cells, int),
        "cell_count": np.zeros(cells, int),
        "cell_start": np.zeros(cells, int),
    }

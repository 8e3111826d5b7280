"""Free flight: conservation of momentum, angular momentum and energy without contact."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.frame import Health
from gf_usd.core.frames.settings import LUMPED
from gf_usd.core.materials.dimensionless import G0
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import ball, preset_material, set_state, settings
from gf_usd.verify.case import AT_LEAST, Case, Measure

SPIN = np.array([0.3, 2.0, -0.5])  # [rad/s]
ROTATION_RATE = np.array([0.0, 3.0, 0.0])  # [rad/s]
SQUASH = 0.88  # height over height at rest
SLOW_ROTATION_RATE = np.array([0.01, 0.02, 0.03])  # [rad/s] along no axis
SQUEEZE = np.diag([0.4, -0.7, 0.3])  # [1/s]


def initial_velocity(X: Floats) -> Floats:
    """Spin about the origin and a squeeze: turn and vibration together."""
    return np.cross(SPIN, X) + X @ SQUEEZE


def free_fall(device: str) -> Iterator[Measure]:
    """Positions and momentum against g t^2 / 2 and m g t, every frame."""
    body, _ = ball(300)
    g = np.array([1.0, -G0, 0.0])
    s = settings(device, frames=24, gravity=tuple(g), filter_rate=10.0)
    position_error = momentum = 0.0
    material = preset_material("rubber", body, damping_time=0.0)
    for frame in TotalLagrangian(body, [material], s).frames():
        if frame.index:
            fallen = 0.5 * g * frame.time**2
            error = np.abs(frame.particles.x - body.X - fallen).max()
            position_error = max(position_error, error / np.linalg.norm(fallen))
            p = frame.health.mass * g * frame.time
            error = np.linalg.norm(np.asarray(frame.health.momentum) - p)
            momentum = max(momentum, float(error / np.linalg.norm(p)))
    why = (
        "position Verlet is exact under a constant force, so that only rounding remains: 6e-8 a"
        " substep in the sum of some 100 of them, of one sign at worst"
    )
    yield Measure(name="position", value=position_error, target=0.0, bound=6e-6, why=why)
    yield Measure(name="momentum", value=momentum, target=0.0, bound=6e-6, why=why)


@cache
def fly(device: str, frames: int, particles: int) -> tuple[Health, ...]:
    """A spinning, vibrating rubber ball at the Lagrangian limit."""
    body, _ = ball(particles)
    material = preset_material("rubber", body, damping_time=0.0)
    s = settings(device, frames=frames)
    return tuple(
        f.health for f in TotalLagrangian(body, [material], s, velocity=initial_velocity).frames()
    )


def momentum(device: str, frames: int = 120, particles: int = 500) -> Iterator[Measure]:
    """Linear momentum of a body that spins and vibrates."""
    health = fly(device, frames, particles)
    size = np.sqrt(2.0 * health[0].mass * health[0].kinetic)
    first = np.array(health[0].momentum)
    drift = max(float(np.linalg.norm(h.momentum - first)) for h in health)
    yield Measure(
        name="drift",
        value=float(drift / size),
        target=0.0,
        bound=1e-5,
        why=(
            "internal forces sum to zero by construction; the remaining error is the rounding of"
            " node sums, 6e-8 a substep, over sqrt(2 m E)"
        ),
    )


def spin(device: str, frames: int = 120, particles: int = 500) -> Iterator[Measure]:
    """Angular momentum and energy of the same flight."""
    health = fly(device, frames, particles)
    L = np.array([h.angular_momentum for h in health])
    E = np.array([h.kinetic + h.elastic for h in health])
    exchange = max(h.elastic for h in health) / E[0]
    yield Measure(
        name="angular-momentum",
        value=float(np.linalg.norm(L - L[0], axis=1).max() / np.linalg.norm(L[0])),
        target=0.0,
        bound=1e-4,
        why="force and gather are adjoint, so moments cancel exactly: rounding of f32; 1e-4 is"
        " required",
    )
    yield Measure(
        name="energy",
        value=float(np.abs(E / E[0] - 1.0).max()),
        target=0.0,
        bound=0.01,
        why=(
            "Verlet conserves a shadow energy; the energy oscillates about it by (w dt)^2 / 4 of"
            " the vibrational energy, and w dt reaches 1 at the finest scale only"
        ),
    )
    yield Measure(
        name="exchange",
        value=float(exchange),
        target=0.01,
        bound=0.0,
        kind=AT_LEAST,
        why="the ball must vibrate, or conservation of its energy would be trivial",
    )


def spin_apic(device: str) -> Iterator[Measure]:
    """L/L0 of a squashed, spinning ball after two seconds of APIC at every substep."""
    body, _ = ball(1000)
    material = preset_material("rubber", body, damping_time=0.0)
    s = settings(device, frames=121, fps=60.0, filter_rate=np.inf, mass=LUMPED)
    solver = TotalLagrangian(body, [material], s)
    X = solver.body.stencil.node_X
    F = np.diag([SQUASH**-0.5, SQUASH, SQUASH**-0.5])
    set_state(solver, X @ (F - np.eye(3)), np.cross(ROTATION_RATE, X @ F))
    first, *_, last = (np.linalg.norm(f.health.angular_momentum) for f in solver.frames())
    yield Measure(
        name="left", value=float(last / first), target=1.0, bound=(1.0 - SQUASH) ** 2, unit="L/L0",
        why=(
            "APIC conserves sum X x p, and sum x x p except for sum u x (change of p): u is of the"
            " order of the strain, 0.12, and so is the part of p that is not affine and can change;"
            " 0.12 squared"
        ),
    )  # fmt: skip
    s = settings(device, frames=2, fps=60.0, filter_rate=np.inf, mass=LUMPED)
    solver = TotalLagrangian(body, [material], s)
    X = solver.body.stencil.node_X
    set_state(solver, np.zeros_like(X), np.cross(SLOW_ROTATION_RATE, X))
    before, after = (np.array(f.health.angular_momentum) for f in solver.frames())
    yield Measure(
        name="affine", value=float(np.linalg.norm(after - before) / np.linalg.norm(before)),
        target=0.0, bound=1e-5,
        why=(
            "an unstrained rotating body has velocities affine in X, which APIC reproduces:"
            " rounding, 6e-8 a substep, in about 60 of them; strains due to rotation are rho w^2"
            " r^2 / E, 1e-5, and act through their square"
        ),
    )  # fmt: skip


CASES = (
    Case(
        name="free-fall",
        what="A ball falls for a second under gravity that is not along an axis.  Every particle"
        " must lie at X + g t^2 / 2, and momentum must be m g t, at every frame.",
        source="closed form",
        quick=free_fall,
    ),
    Case(
        name="momentum",
        what=(
            "A rubber ball spins and vibrates in free flight, without filter and damping.  Its"
            " linear momentum must be conserved."
        ),
        source="closed form",
        quick=momentum,
        full=lambda device: momentum(device, 1000, 1000),
    ),
    Case(
        name="spin",
        what="The same flight.  Angular momentum must not change, and energy must pass between"
        " motion and strain without loss: there is no hidden damping.",
        source="closed form",
        quick=spin,
        full=lambda device: spin(device, 1000, 1000),
    ),
    Case(
        name="spin-apic",
        what="The same ball with the APIC filter at every substep, as in the paper, for two"
        " seconds, squashed to 0.88 of its height.  The fraction of its spin that remains.",
        source="conservation of angular momentum",
        quick=spin_apic,
    ),
)

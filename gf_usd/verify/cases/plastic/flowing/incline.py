"""A block of sand on a slope, and free flight of flowing material.

On a slope of angle theta with friction mu the block stays where tan(theta) < mu, and slides with

    a = g (sin theta - mu cos theta)

above: every particle in contact with the floor is at Coulomb's limit, and together they bear the
weight.  The sand holds together (cohesion), and has more friction inside than under it.

In free flight without gravity momentum and mass are conserved, whatever separates.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.material import Material
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.verify.bodies import block, settings
from gf_usd.verify.case import ABSOLUTE, RELATIVE, Case, Measure

FRICTION, INSIDE, COHESION = 0.5, 0.8, 2e3  # [Pa]
DENSITY, STIFF, NU = 1600.0, 1e6, 0.3  # [kg/m^3], [Pa]
CELL, CELLS = 0.05, (4, 2, 4)  # [m]
FPS, SECONDS = 50, 0.4  # frames per second, and what is watched; the later half is measured
BELOW, ABOVE = 0.8, 1.6  # tan(theta) in mu
BURST = 40.0  # [1/s] of widening, at which no sand holds together


def sand(**changes: float) -> Material:
    """Sand that stands; changes replace parameters of the law."""
    own = {"internal_friction": INSIDE, "cohesion": COHESION, **changes}
    return Material(
        name="sand", law="druckerPrager", density=DENSITY, youngs_modulus=STIFF,
        poissons_ratio=NU, friction=FRICTION, restitution=0.0, parameters=own,
    )  # fmt: skip


def slide(steepness: float, device: str) -> tuple[float, float]:
    """Acceleration [m/s^2] and speed at the end [m/s] down a slope of tan(theta) = steepness mu.

    The block still bounces a little: what Coulomb's law makes of its upward acceleration, mu times
    that, is added.
    """
    lean = np.arctan(steepness * FRICTION)
    body = block((0.0, 0.0, 0.0), CELLS, CELL)
    frames = int(SECONDS * FPS)
    solver = UpdatedLagrangian(
        body, [sand()],
        settings(
            device, frames=frames + 1, fps=float(FPS), floor=0.0, filter_rate=np.inf,
            gravity=(G0 * np.sin(lean), -G0 * np.cos(lean), 0.0),
        ),
        samples=SurfaceSamples(X=body.X, area=body.V0 / body.spacing),
    )  # fmt: skip
    results = np.array([f.health.momentum for f in solver.frames()]) / float(
        body.V0.sum() * DENSITY
    )
    half = frames // 2
    gained = results[-1] - results[half]
    return float(gained[0] + FRICTION * gained[1]) / ((frames - half) / FPS), float(results[-1, 0])


def incline(device: str) -> Iterator[Measure]:
    """Rest and sliding."""
    lean = np.arctan(ABOVE * FRICTION)
    exact = G0 * (np.sin(lean) - FRICTION * np.cos(lean))
    results, _ = slide(ABOVE, device)
    yield Measure(
        name="acceleration", value=results, target=float(exact), bound=0.01, kind=RELATIVE,
        unit="m/s^2",
        why="the sum of Coulomb's forces is mu times the normal force; 1 % is required, the"
        " block's bouncing on the springs of the floor, 1.2 % of it, is corrected by the momentum",
    )  # fmt: skip
    _, left = slide(BELOW, device)
    yield Measure(
        name="speed-below", value=left, target=0.0, bound=2e-3, kind=ABSOLUTE, unit="m/s",
        why=(
            "a sticking block oscillates on the springs of friction, which are damped; the block"
            f" would have {SECONDS * G0 * float(np.sin(np.arctan(BELOW * FRICTION))):.2g} m/s"
            " without friction"
        ),
    )  # fmt: skip


def burst(device: str) -> Iterator[Measure]:
    """A block that flies, turns and bursts."""
    body = block((-0.1, -0.05, -0.1), CELLS, CELL)
    start = np.array([1.0, 2.0, -0.5])

    def velocity(X: np.ndarray) -> np.ndarray:
        return start + BURST * X + np.cross([0.0, 0.0, 5.0], X)

    solver = UpdatedLagrangian(
        body, [sand(cohesion=0.0)], settings(device, frames=11, fps=50.0), velocity=velocity
    )
    frames = list(solver.frames())
    first, last = frames[0].health, frames[-1].health
    momentum = np.subtract(last.momentum, first.momentum) / (first.mass * np.linalg.norm(start))
    wide = float(np.prod(np.ptp(frames[-1].particles.x, axis=0) / np.ptp(body.X, axis=0)))
    substeps = sum(f.health.substeps for f in frames)
    rounding = 6e-8 * BURST * 0.15 * np.sqrt(substeps)
    yield Measure(
        name="momentum", value=float(np.abs(momentum).max()), target=0.0, bound=float(rounding),
        kind=ABSOLUTE, unit="of the whole",
        why="each substep rounds velocities of up to BURST 0.15 m to 6e-8, this way or that; the"
        f" box around the particles becomes {wide:.3g} times as large",
    )  # fmt: skip
    yield Measure(
        name="mass", value=last.mass / first.mass - 1.0, target=0.0, bound=1e-15, kind=ABSOLUTE,
        why="particles keep their mass, and none is lost",
    )  # fmt: skip
    yield Measure(
        name="size", value=min(wide, 100.0), target=100.0, bound=1e-12, kind=RELATIVE,
        why="it must burst, to a hundred times the box, or the figures above prove nothing",
    )  # fmt: skip


CASES = (
    Case(
        name="incline",
        what=(
            "A block of sand is put on a slope: it sticks below the angle of friction of the"
            " floor, and above it slides by Coulomb's law."
        ),
        source="closed form: g (sin theta - mu cos theta)",
        quick=incline,
    ),
    Case(
        name="burst",
        what="A block of sand flies, turns and bursts into single particles, without gravity and"
        " floor: momentum and mass stay as they are.",
        source="conservation",
        quick=burst,
    ),
)

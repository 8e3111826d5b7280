"""Comparison of the two solvers for a ball that falls on the floor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gf_usd.core.frames.settings import LUMPED
from gf_usd.core.materials.dimensionless import FILTER_RATE, G0, time_scale
from gf_usd.physics.solvers import make_solver
from gf_usd.verify.bodies import ball, preset_material, settings, sphere
from gf_usd.verify.case import AT_LEAST, Case, Measure

FALL = 3.0  # radii
FRAMES, RATE = 120, 19.1  # RATE per T: the frames of a bake at 60 fps for r = 1 m


@dataclass(frozen=True, kw_only=True)
class Drop:
    """What one solver makes of it."""

    height: float  # least, of the mesh, over the height at rest
    sigma: float  # least mean of the smallest stretch
    center: float  # [r] lowest place of the center of mass
    rebound: float  # [r] highest place of it after that
    gain: float  # largest energy over that at the start


def drop(solver: str, particles: int, device: str) -> Drop:
    """A rubber ball of r = 1 m from three radii above the floor."""
    from gf_usd.physics.per_particle import strains

    body, samples = ball(particles)
    T = time_scale(body.radius)
    s = settings(
        device, frames=FRAMES, fps=RATE / T, gravity=(0.0, -G0, 0.0), floor=0.0,
        filter_rate=FILTER_RATE / T, lift=(0.0, 1.0 + FALL, 0.0), solver=solver,
        mass=LUMPED,  # as the other solver has it
    )  # fmt: skip
    materials = [preset_material("rubber", body)]
    skin = sphere()
    run = make_solver(s, body, materials, samples=samples, embedded={"skin": skin.points})
    heights, sigmas, centers, energies = [], [], [], []
    for frame in run.frames():
        heights.append(np.ptp(frame.embedded["skin"].x[:, 1]))
        sigmas.append(body.V0 @ strains(frame.particles.F)[0][:, 0] / body.volume)
        centers.append(frame.health.center[1])
        energies.append(frame.health.energy)
    low = int(np.argmin(centers))
    return Drop(
        height=float(min(heights) / heights[0]),
        sigma=float(min(sigmas)),
        center=float(centers[low]),
        rebound=float(max(centers[low:])),
        gain=float(max(energies) / energies[0]),
    )


def sides(particles: int) -> Callable[[str], Iterator[Measure]]:
    """The drop by both solvers, and the difference of their results."""

    def run(device: str) -> Iterator[Measure]:
        tl, ul = (drop(name, particles, device) for name in ("tl", "ul"))
        grid = "both have the same particles and cells; the grids lie differently, and one moves"
        for name, bound, why in (
            ("height", 0.015, f"{grid}: at this count a mesh height changes by 1 % with them"),
            (
                "sigma",
                0.01,
                f"a mean over the volume; {grid}, and twice the count changes it by up to"
                " half of this in either (drop.sigma-change)",
            ),
            ("center", 0.005, f"the same contact on both; {grid}"),
        ):
            a, b = getattr(tl, name), getattr(ul, name)
            yield Measure(
                name=f"{name}.ul-against-tl", value=b, target=a, bound=bound, why=why,
                unit="r" if name == "center" else "",
            )  # fmt: skip
        yield Measure(
            name="rebound.tl-over-ul",
            value=tl.rebound / ul.rebound,
            target=1.0,
            bound=0.0,
            kind=AT_LEAST,
            why=(
                "in every substep APIC dissipates energy of UL that TL, with the finite rate of"
                " its filter, conserves"
            ),
        )
        for name, results in (("tl", tl), ("ul", ul)):
            yield Measure(
                name=f"energy.{name}", value=max(0.0, results.gain - 1.0), target=0.0, bound=1e-3,
                why=(
                    "no energy is added to a falling body; that of Verlet oscillates by rounding"
                    " and by (w dt)^2 / 4 of the vibrational energy"
                ),
            )  # fmt: skip

    return run


CASES = (
    Case(
        name="solvers",
        what="The Total Lagrangian solver and the Updated Lagrangian baseline drop the same rubber"
        " ball on the same floor.  Height, stretch and place at the deepest squash must agree; how"
        " high each lets it rebound is compared.",
        source="no independent reference: the two solvers are compared with each other",
        quick=sides(1000),
        full=sides(8000),
    ),
)

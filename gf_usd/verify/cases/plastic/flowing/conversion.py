"""Conversion of a solid to sand in flight: conserved quantities and the spread of grains."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gf_usd.core.frames.settings import MIXED
from gf_usd.core.materials.conversion import TIME, Conversion, Limit
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import ContactSetup, Skin
from gf_usd.physics.solvers import make_solver
from gf_usd.verify.bodies import ball, preset_material, settings, sphere
from gf_usd.verify.case import ABSOLUTE, RELATIVE, Case, Curve, Measure

FPS, SOLID, FRAMES = 48.0, 6, 30
SPIN = 2.0  # [rad/s], about y
AFTER = (FRAMES - 1 - SOLID) / FPS  # [s] as sand


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What came of a flight, in units of its own."""

    path: float  # [r] of the center from its parabola, at most
    spin: float  # of the angular momentum about the center, at most
    gain: float  # of the energy of spinning, in a frame at most, that nothing accounts for
    spread: float  # growth of the moment about the axis, over that of free grains


def flight(particles: int, device: str) -> Flight:
    """A ball of rubber that spins and falls, and is sand from frame SOLID on."""
    body, samples = ball(particles)
    rows = np.arange(len(body))
    becomes = Conversion(particles=rows, material=1, limit=Limit(kind=TIME, value=SOLID / FPS))
    s = settings(
        device, frames=FRAMES, fps=FPS, time_codes_per_second=1.0, start=0.0,
        gravity=(0.0, -G0, 0.0), floor=None, filter_rate=np.inf, solver=MIXED,
    )  # fmt: skip
    shape = sphere()
    solver = make_solver(
        s, replace(body, conversions=(becomes,)),
        [preset_material("rubber", body), find_preset("dry-sand").material(1.0, None)],
        samples=samples, velocity=lambda X: np.cross([0.0, SPIN, 0.0], X),
        contact_setup=ContactSetup(skins=(Skin(points=shape.points, triangles=shape.triangles),)),
    )  # fmt: skip
    results = list(solver.frames())
    health, m = [f.health for f in results], body.V0
    t = np.arange(FRAMES) / FPS
    center = np.array([h.center for h in health])
    fallen = center[0] + np.outer(0.5 * t**2, [0.0, -G0, 0.0])
    spin = np.array([np.array(h.angular_momentum) - np.cross(h.center, h.momentum) for h in health])
    whole = float(np.linalg.norm(spin[0]))
    gains = [b.energy - a.energy - b.work - b.injected + b.dissipation for a, b in pairwise(health)]

    def about_axis(k: int) -> float:
        x = results[k].particles.x - m @ results[k].particles.x / m.sum()
        return float(m @ (x[:, 0] ** 2 + x[:, 2] ** 2))

    first, last = about_axis(SOLID), about_axis(FRAMES - 1)
    density = health[0].mass / m.sum()
    rate = whole / (density * first)
    return Flight(
        path=float(np.linalg.norm(center - fallen, axis=1).max()),
        spin=float(np.linalg.norm(spin - spin[0], axis=1).max() / whole),
        gain=max(0.0, *gains) / (0.5 * whole * SPIN),
        spread=(last / first - 1.0) / (rate * AFTER) ** 2,
    )


def conserve(counts: Sequence[int]) -> Callable[[str], Iterator[Measure]]:
    """Flights at several particle counts; the others for the curve."""

    def run(device: str) -> Iterator[Measure]:
        results = [flight(n, device) for n in counts]
        fine, cell = results[-1], 2.0 * np.cbrt(4.0 / 3.0 * np.pi / counts[-1])
        yield Measure(
            name="path", value=fine.path, target=0.0, bound=1e-4, unit="r",
            why="y = y0 - g t^2 / 2 whatever the body is made of: float32 rounding of some"
            f" {FRAMES} frames of positions",
        )  # fmt: skip
        yield Measure(
            name="angular-momentum", value=fine.spin, target=0.0, bound=1e-4, kind=ABSOLUTE,
            why="transfers and the change of solver conserve it: float32 rounding of some thousand"
            " substeps, 6e-8 each",
        )  # fmt: skip
        yield Measure(
            name="energy-from-nothing", value=fine.gain, target=0.0, bound=1e-3, kind=ABSOLUTE,
            why=(
                "strain energy is lost, and counted; the energy of the integrator oscillates by (w"
                " dt)^2 / 4 of the vibrational energy"
            ),
        )  # fmt: skip
        yield Measure(
            name="spread", value=fine.spread, target=1.0, bound=float(3.0 * cell**2), kind=RELATIVE,
            why=(
                "sand bears no tension, so that each grain moves on along its tangent and sum m"
                " r^2 grows by w^2 t^2.  Affine motion has an inertia of its own, m h^2 / 2 in"
                " addition to the ball's 2/5 m r^2: with the same angular momentum w falls by 5/4"
                f" (h / r)^2 and the growth by twice that, of cells of {cell:.2g} r; a fifth more"
                " is allowed"
            ),
            curve=Curve(
                title="ball that becomes sand: growth of sum m r^2", x_label="particles",
                y_label="growth / growth of free grains", x=tuple(map(float, counts)),
                y=tuple(one.spread for one in results), logarithmic=False, target=1.0,
            ) if len(results) > 1 else None,
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="conversion",
        what="A ball of rubber spins and falls freely, and becomes dry sand after an eighth of a"
        " second.  The Updated Lagrangian solver takes it over from the Total Lagrangian one: its"
        " center has to stay on its parabola, its angular momentum and energy have to be accounted"
        " for, and its grains to fly apart.",
        source="closed form: conservation laws; free grains, sum m r^2 = (1 + w^2 t^2) times it",
        quick=conserve((1000,)),
        full=conserve((1000, 4000, 16000)),
    ),
)

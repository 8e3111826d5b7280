"""Self-contact of two closing arms: momentum, energy, released samples and overlap."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import ContactSetup, Skin
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import comb, make_solid, preset_material, settings
from gf_usd.verify.case import Case, Measure

WIDTH, GAP, LENGTH = 0.5, 1.0, 3.0  # [m] of an arm, between the arms, of an arm
PRESETS = ("rubber", "jelly")
FRAMES = 20
ROUNDING = 1e-5  # of the momentum of an arm: float32 sums over some hundred substeps
OVERLAP, MAX_ENERGY_GAIN = 0.3, 1e-3  # [spacings]; of the initial kinetic energy


def close_arms(name: str, speed: float, particles: int, device: str) -> Iterator[Measure]:
    """Arms of one preset whose tips approach each other at a speed [m/s] each."""
    surface = comb(2, WIDTH, GAP, LENGTH, WIDTH, WIDTH)
    solid = make_solid(surface)
    body = sample_solid(solid, particles=particles, spacing=None, seed=0)
    center = WIDTH + 0.5 * GAP

    def closing_velocity(X: Floats) -> Floats:
        toward = np.sign(center - X[:, 0]) * np.maximum(LENGTH - X[:, 1], 0.0)
        return np.outer(speed / LENGTH * toward, [1.0, 0.0, 0.0])

    skin = Skin(points=surface.points, triangles=surface.triangles)
    solver = TotalLagrangian(
        body, [preset_material(name, body)], settings(device, frames=FRAMES),
        samples=sample_surface(solid, body.spacing), velocity=closing_velocity,
        contact_setup=ContactSetup(skins=(skin,), self_contact=frozenset({0})),
    )  # fmt: skip
    results = [frame.health for frame in solver.frames()]
    suffix = f"{name}.{speed:g}.{particles}"
    p = np.array([h.momentum for h in results])
    yield Measure(
        name=f"momentum.{suffix}", value=float(np.abs(p - p[0]).max()) / (results[0].mass * speed),
        target=0.0, bound=ROUNDING, why="the forces of a pair sum to zero; rounding of float32",
    )  # fmt: skip
    yield Measure(
        name=f"let-go.{suffix}", value=float(max(h.let_go for h in results)), target=0.0, bound=0.0,
        unit="samples", why="each sample stores on which side of the opposite surface it was",
    )  # fmt: skip
    energy_gain = np.cumsum([h.injected for h in results])
    yield Measure(
        name=f"given.{suffix}", value=max(0.0, float(energy_gain.max())) / results[0].kinetic,
        target=0.0,
        bound=MAX_ENERGY_GAIN,
        why="new planes store the energy of the old ones; at most a thousandth is allowed",
    )  # fmt: skip
    yield Measure(
        name=f"overlap.{suffix}", value=max(h.overlap for h in results) / body.spacing, target=0.0,
        bound=OVERLAP, unit="spacings",
        why=(
            "no independent reference: surfaces yield a little where bodies are pressed together,"
            " and less than a third of a spacing is required"
        ),
    )  # fmt: skip


def arms(speeds: Sequence[float], counts: Sequence[int]) -> Callable[[str], Iterator[Measure]]:
    """Every preset at every speed [m/s], with every number of particles."""

    def run(device: str) -> Iterator[Measure]:
        for count in counts:
            for name in PRESETS:
                for speed in speeds:
                    yield from close_arms(name, speed, count, device)

    return run


CASES = (
    Case(
        name="arms",
        what=(
            "Two arms of one body, 3 m long, close until they meet, their tips at 1.5, 3 and 6 m/s"
            " each.  Momentum, samples that pass through, the energy added by contact, and the"
            " overlap of the arms."
        ),
        source="conservation laws; the depth is a requirement of the project",
        quick=arms((1.5, 6.0), (500,)),
        full=arms((1.5, 3.0, 6.0), (500, 2000)),
    ),
)

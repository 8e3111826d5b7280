"""Taylor's bar on a floor with unilateral contact, from which its rim lifts.

In the case `taylor` a pin holds the whole foot on the wall.  On a floor without friction that takes
no pull the foot bends up around its edge, and leaves the floor there for good.  No source has this
set-up; the reference is finite elements of our own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.physics.contact.floor import HALF_SPACE, plane_modulus
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import mirror_plane, sample_strata, settings
from gf_usd.verify.case import RELATIVE, Case, Curve, Measure
from gf_usd.verify.cases.plastic.taylor import (
    COPPER,
    END,
    LENGTH,
    PARTS,
    RADIUS,
    SPEED,
    quarter_rod,
)

# At the end, of elements with 6, 8, 12 along the radius: radius 7.261, 7.298 and 7.327 mm, length
# 21.477, 21.470 and 21.467 mm, height of the rim 0.169, 0.210 and 0.244 mm.  Here are their limits
# of the first order in h; those of two pairs differ by 0.008, 0.004 and 0.007 mm.
ELEMENTS = (7.39e-3, 21.46e-3, 0.32e-3)


@dataclass(frozen=True, kw_only=True)
class Landing:
    """What became of a bar; arrays by frame."""

    radius: Floats  # [m] of the rim
    length: Floats  # [m] along the axis
    lift: Floats  # [m] of the rim over the floor
    energy: Floats  # [J] kinetic, elastic, of contact and dissipated
    depth: float  # [m] the deepest sample of all frames


def foot_of(cells: int) -> SurfaceSamples:
    """Contact samples of a quarter of the foot, at the places of the particles over it."""
    flat, area = sample_strata(
        lambda x, z: x * x + z * z < RADIUS**2, (cells, cells), RADIUS / cells
    )
    X = np.insert(flat, 1, 0.0, axis=1)
    return SurfaceSamples(X=X, area=area * 0.25 * np.pi * RADIUS**2 / area.sum())


def land(cells: int, device: str) -> Landing:
    """A quarter of the bar on the floor, `cells` cells a radius."""
    angle = np.linspace(0.0, 0.5 * np.pi, 17)
    rim = RADIUS * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], 1)
    ends = np.array([[0.0, 0.0, 0.0], [0.0, LENGTH, 0.0]])
    material = replace(COPPER, friction=0.0, restitution=1.0)
    solver = TotalLagrangian(
        quarter_rod(cells), [material],
        settings(device, frames=PARTS + 1, fps=PARTS / END, floor=0.0),
        pins=[mirror_plane(0, 0.0), mirror_plane(2, 0.0)], samples=foot_of(cells),
        embedded={"rim": rim, "ends": ends}, velocity=(0.0, -SPEED, 0.0),
    )  # fmt: skip
    rows, lost, depth = [], 0.0, 0.0
    for frame in solver.frames():
        edge, (low, high) = frame.embedded["rim"].x, frame.embedded["ends"].x[:, 1]
        lost += frame.health.plastic_dissipation or 0.0
        depth = max(depth, frame.health.penetration)
        energy = frame.health.kinetic + frame.health.elastic + frame.health.contact + lost
        radius = np.linalg.norm(edge[:, [0, 2]], axis=1).mean()
        rows.append((radius, high - low, edge[:, 1].mean(), energy))
    radius, length, lift, energy = np.array(rows).T
    return Landing(radius=radius, length=length, lift=lift, energy=energy, depth=depth)


def landing(*cells: int, bounds: tuple[float, float, float]) -> Callable[[str], Iterator[Measure]]:
    """The bar at several resolutions; bounds : of radius, length and lift at the finest."""

    def run(device: str) -> Iterator[Measure]:
        results = [land(n, device) for n in cells]
        finest = results[-1]
        shapes = np.array([(one.radius[-1], one.length[-1], one.lift[-1]) for one in results])
        why = (
            f"{cells[-1]} cells a radius; the foot bends up within its last cell, which reduces"
            " the order to one, also that of the finite elements"
        )
        for k, name in enumerate(("radius", "length", "lift")):
            yield Measure(
                name=name, value=float(shapes[-1, k]), target=ELEMENTS[k], bound=bounds[k],
                kind=RELATIVE, unit="m", why=why,
                curve=Curve(
                    title=f"Taylor's bar on a floor: {name} of its rim",
                    x_label="cell size h / radius R",
                    y_label=f"{name} [m]", x=tuple(1.0 / np.array(cells)), y=tuple(shapes[:, k]),
                    logarithmic=False, target=ELEMENTS[k],
                ) if name != "length" else None,
            )  # fmt: skip
        spacing = 0.5 * RADIUS / cells[-1]
        shock = COPPER.density * COPPER.wave_speed * SPEED
        modulus = float(
            plane_modulus(np.array(COPPER.youngs_modulus), np.array(COPPER.poissons_ratio))
        )
        hit = 2.0 * shock / (HALF_SPACE * modulus)
        again = SPEED / np.sqrt(HALF_SPACE * modulus / COPPER.density)
        yield Measure(
            name="depth", value=finest.depth, target=0.0, bound=float(hit + again) * spacing,
            unit="m",
            why=(
                "depth of the foot in the floor: twice the static deflection of its springs under"
                " the pressure rho c v of the impact, because the load is sudden, and the stopping"
                " distance of a sample that left the floor and returns at most as fast"
            ),
        )  # fmt: skip
        start = finest.energy[0]
        yield Measure(
            name="energy", value=float(np.abs(finest.energy / start - 1.0).max()), target=0.0,
            bound=1e-3,
            why="motion, strain, springs and what flow dissipated: the work of flow is a sum over"
            " substeps, each of which strains the foot by up to a hundredth",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="rim",
        what="The copper bar of the case `taylor` hits a floor without friction that takes no pull:"
        " its rim bends up and leaves the floor.  Radius and height of the rim, length of the bar.",
        source="our own finite elements of this set-up, axially symmetric, of four nodes and one"
        " pressure (tools/impact_reference.py)",
        quick=landing(4, bounds=(0.02, 0.005, 0.3)),
        full=landing(3, 4, 6, bounds=(0.01, 0.005, 0.15)),
    ),
)

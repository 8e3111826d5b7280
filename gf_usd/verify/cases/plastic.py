"""Laws that flow: loading and springback, and Taylor's bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames import CONSISTENT, LUMPED, Particles
from gf_usd.core.materials import Material
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, cloud, elastic, put, settings, virial
from gf_usd.verify.case import AT_LEAST, RELATIVE, Case, Curve, Measure, order

E, NU = 1e4, 0.3  # [Pa]
YIELD, LINEAR, VOCE, RATE = 200.0, 300.0, 100.0, 20.0  # [Pa], ..., of saturation per strain
OWN = {"yield_stress": YIELD, "hardening": LINEAR, "saturation": VOCE, "saturation_rate": RATE}


def history(solver: TotalLagrangian, name: str) -> Floats:
    """(N,) an internal variable of the particles."""
    seen = np.asarray(solver.state.save()["history"], float)
    return solver.body.law.internal(seen.reshape(len(solver.particles), -1))[name]


def bearable(a: float) -> float:
    """Y(a) [Pa] of OWN."""
    return YIELD + LINEAR * a + VOCE * (1.0 - float(np.exp(-RATE * a)))


def pulled(a: float, stress: float) -> Floats:
    """F of a bar with plastic strain a along x and uniaxial Kirchhoff stress [Pa]."""
    e, across = stress / E + a, -NU * stress / E - 0.5 * a
    return np.diag(np.exp([e, across, across]))


def uniaxial(device: str) -> Iterator[Measure]:
    """Kirchhoff stress of a block that is strained as a bar under tension is."""
    made = elastic(E=E, nu=NU, density=1e9, law="vonMises", parameters=OWN)
    body = block((0.0, 0.0, 0.0), (1, 1, 1), 1.0, places=GAUSS)
    s = settings(device, fps=1e9, substeps=1, followers=False)
    solver = TotalLagrangian(body, [made], s, real=np.float64)
    why = "the return is radial along this path, and so exact: rounding, and the square of 1e-5 of"
    why += " the excess that Newton's iteration leaves"

    def stress(F: Floats) -> tuple[float, float]:
        put(solver, solver.body.stencil.node_X @ (F - np.eye(3)).T)
        tau = virial(solver) @ F.T
        return float(tau[0, 0]), float(abs(tau[1, 1]))

    for a in (0.01, 0.05, 0.2):
        along, across = stress(pulled(a, bearable(a)))
        yield Measure(
            name=f"stress-at-{a:g}", value=along, target=bearable(a), bound=1e-8, kind=RELATIVE,
            unit="Pa", why=why,
        )  # fmt: skip
        yield Measure(
            name=f"across-at-{a:g}", value=across / YIELD, target=0.0, bound=1e-8,
            why=f"a free side has no stress; {why}",
        )  # fmt: skip
    half = 0.5 * bearable(0.2)
    unloaded = stress(pulled(0.2, half))[0]
    yield Measure(
        name="springback", value=(bearable(0.2) - unloaded) / half, target=1.0, bound=1e-8,
        why=f"unloading is elastic, with the slope E; {why}",
    )  # fmt: skip
    yield Measure(
        name="plastic-strain", value=float(history(solver, "plastic_strain").mean()), target=0.2,
        bound=1e-8, kind=RELATIVE, why=f"what stays when it is unloaded; {why}",
    )  # fmt: skip


# Taylor's bar of copper: Kamoulakos 1990; Zhu and Cescotto 1995.  [m], [m/s], [Pa], [kg/m^3]
RADIUS, LENGTH, SPEED = 3.2e-3, 32.4e-3, 227.0
COPPER = Material(
    name="copper", law="vonMises", density=8930.0, youngs_modulus=117e9, poissons_ratio=0.35,
    parameters={"yield_stress": 400e6, "hardening": 100e6},
)  # fmt: skip
END, PARTS = 80e-6, 40  # [s], frames
FINAL = (7.2259e-3, 21.42e-3)
HISTORY = {20e-6: (6.205e-3, 28.065e-3), 40e-6: (7.147e-3, 24.562e-3), 60e-6: (7.234e-3, 22.213e-3)}
FINE = 16  # points along the edge of a stratum, of which its share in a circle is counted


def cylinder(cells: int, length: float) -> Particles:
    """A rod along y about the origin, from -length to length [m], `cells` cells a radius.

    Strata that its mantle cuts have the volume and the middle of what is inside.
    """
    h = RADIUS / cells
    a, along = 0.5 * h, round(length / h)
    fine = (np.arange(FINE) + 0.5) / FINE * a
    places, share = [], []
    for i in range(-2 * cells, 2 * cells):
        for k in range(-2 * cells, 2 * cells):
            x, z = np.meshgrid(i * a + fine, k * a + fine, indexing="ij")
            inside = x * x + z * z < RADIUS**2
            if inside.all():
                places.append((h * (i // 2 + GAUSS[i % 2]), h * (k // 2 + GAUSS[k % 2])))
            elif inside.any():
                places.append((x[inside].mean(), z[inside].mean()))
            share.extend([inside.mean()] * bool(inside.any()))
    flat, weight = np.array(places), np.array(share)
    weight *= np.pi * RADIUS**2 / weight.sum()
    step = length / along
    y = ((np.arange(-along, along)[:, None] + GAUSS) * step).ravel()
    X = np.stack(
        [np.tile(flat[:, 0], len(y)), np.repeat(y, len(flat)), np.tile(flat[:, 1], len(y))], 1
    )
    V0 = np.tile(weight, len(y)) * 0.5 * step
    corner = -h * np.array([cells + 1, along, cells + 1])
    body = cloud(X, volume=float(V0.sum()), lattice=a, corner=corner)
    return replace(body, V0=V0)


def taylor(
    cells: int, device: str, made: Material = COPPER, end: float = END, mass: str = LUMPED
) -> dict[float, tuple[float, float]]:
    """By time [s] radius of the foot and length [m] of a bar thrown against a wall.

    The wall is the symmetry plane of two bars that are thrown against each other.
    mass : lumped, as in the finite elements of the source, or consistent, as bakes have it.
    """
    s = settings(device, frames=round(PARTS * end / END) + 1, fps=PARTS / END, mass=mass)
    angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    rim = RADIUS * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], 1)
    ends = np.array([[0.0, -LENGTH, 0.0], [0.0, LENGTH, 0.0]])
    solver = TotalLagrangian(
        cylinder(cells, LENGTH), [made], s, embedded={"rim": rim, "ends": ends},
        velocity=lambda X: np.sign(X[:, 1:2]) * [0.0, -SPEED, 0.0],
    )  # fmt: skip
    out = {}
    for frame in solver.frames():
        radius = np.linalg.norm(frame.embedded["rim"].x[:, [0, 2]], axis=1).mean()
        length = 0.5 * float(np.ptp(frame.embedded["ends"].x[:, 1]))
        out[round(frame.time, 9)] = float(radius), length
    return out


def impact(*cells: int, bounds: tuple[float, float, float]) -> Callable[[str], Iterator[Measure]]:
    """The bar at several resolutions; bounds : of radius, length and history at the finest."""

    def run(device: str) -> Iterator[Measure]:
        seen = [taylor(n, device) for n in cells]
        h = 1.0 / np.array(cells)
        radius, length = seen[-1][round(END, 9)]
        why = f"{cells[-1]} cells a radius, where the foot is pressed to a twentieth of its height"
        yield Measure(
            name="radius", value=radius, target=FINAL[0], bound=bounds[0], kind=RELATIVE, unit="m",
            why=why,
            curve=Curve(
                title="Taylor's bar, radius of the foot", x_label="h / R", y_label="radius [m]",
                x=tuple(h), y=tuple(one[round(END, 9)][0] for one in seen), logarithmic=False,
                target=FINAL[0],
            ),
        )  # fmt: skip
        yield Measure(
            name="length", value=length, target=FINAL[1], bound=bounds[1], kind=RELATIVE, unit="m",
            why=why,
        )  # fmt: skip
        for time, (foot, long) in HISTORY.items():
            value = seen[-1][round(time, 9)]
            for name, one, target in (("radius", value[0], foot), ("length", value[1], long)):
                yield Measure(
                    name=f"{name}-at-{time * 1e6:.0f}us", value=one, target=target,
                    bound=bounds[2], kind=RELATIVE, unit="m", why=why,
                )  # fmt: skip
        if len(cells) > 2:
            default = taylor(cells[-2], device, mass=CONSISTENT)[round(END, 9)]
            yield Measure(
                name="radius-consistent", value=default[0], target=FINAL[0], bound=0.03,
                kind=RELATIVE, unit="m",
                why=f"the mass matrix of bakes, {cells[-2]} cells a radius: the foot is crushed to"
                " a twentieth within the first cell, and no mass is more exact there",
            )  # fmt: skip
            radii = np.array([one[round(END, 9)][0] for one in seen])
            error = radii / FINAL[0] - 1.0
            yield Measure(
                name="order", value=order(h, error), target=1.0, bound=0.1, kind=AT_LEAST,
                why="at least the first order, which is all that the corner of the foot leaves",
            )  # fmt: skip
        hard = replace(COPPER, parameters={**COPPER.parameters, "yield_stress": 4e9})
        away = taylor(min(cells), device, hard, 40e-6)[round(40e-6, 9)][0]
        yield Measure(
            name="negative-control", value=abs(away / HISTORY[40e-6][0] - 1.0), target=0.2,
            bound=0.0, kind=AT_LEAST,
            why="ten times the yield stress keeps the foot narrow: the case must notice",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="uniaxial",
        what="A block is strained as a bar under tension beyond its yield stress, and back: stress,"
        " free sides, springback and plastic strain with linear and saturating hardening.",
        source="closed form (logarithmic strain, radial return)",
        quick=uniaxial,
        f64=True,
    ),
    Case(
        name="taylor",
        what="A copper bar hits a rigid wall at 227 m/s: radius of its foot and its length, at the"
        " end and on the way.",
        source="Kamoulakos 1990; Zhu and Cescotto 1995 (finite elements, 7.2259 and 21.42 mm)",
        quick=impact(2, bounds=(0.05, 0.01, 0.1)),
        full=impact(2, 3, 4, 6, bounds=(0.01, 0.005, 0.015)),
    ),
)

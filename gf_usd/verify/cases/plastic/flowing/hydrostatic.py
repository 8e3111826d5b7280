"""Hydrostatics: pressure, settlement and weight of a column of fluid between walls.

What lies at the height Y at rest bears what is above it, whatever the strains,

    p(Y) = rho g (H - Y),   J(Y) = (1 + gamma p / K)^(-1 / gamma)        [Tait]

and the top comes down by the integral of 1 - J over Y.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.material import Material
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.physics.updated_lagrangian.walls import Wall
from gf_usd.verify.bodies import block, settings
from gf_usd.verify.case import ABSOLUTE, RELATIVE, Case, Curve, Measure

HEIGHT, DENSITY, VISCOSITY = 1.0, 1000.0, 10.0  # [m], [kg/m^3], [Pa s]
GAMMA = 7.0  # of Tait's equation
SOFT = 100.0  # K in rho g H: the foot is compressed by 1 %
SECONDS, FPS = 1.0, 20.0  # eight periods of the slowest wave up and down, 4 H sqrt(rho / K)
DRAG = 1.0  # of critical, of that wave
BULK = SOFT * DENSITY * G0 * HEIGHT  # [Pa]


def compressed(Y: Floats) -> Floats:
    """J of what lies at heights Y [m] at rest."""
    return (1.0 + GAMMA * DENSITY * G0 * (HEIGHT - Y) / BULK) ** (-1.0 / GAMMA)


def settled(Y: Floats) -> Floats:
    """[m] by which what lies at heights Y at rest comes down: the integral of 1 - J."""
    n = 1.0 - 1.0 / GAMMA
    head = BULK / (GAMMA * DENSITY * G0)  # [m]
    top, here = (1.0 + (HEIGHT - np.array([0.0 * Y, Y])) / head) ** n
    return Y - head / n * (top - here)


@dataclass(frozen=True, kw_only=True)
class Stood:
    """A column at rest; errors in parts of the values at the foot and at the top."""

    pressure: float  # largest error
    settlement: float  # of the highest particles
    borne: float  # what the floor gave in the last frame, over the weight
    left: float  # [rho g H] largest speed times sqrt(K rho)


def stand(cells: int, device: str) -> Stood:
    """A column so many cells high and one wide."""
    h = HEIGHT / cells
    body = block((0.0, 0.0, 0.0), (1, cells, 1), h)
    mu = 0.2 * BULK
    E, nu = 9.0 * BULK * mu / (3.0 * BULK + mu), (3.0 * BULK - 2.0 * mu) / (6.0 * BULK + 2.0 * mu)
    water = Material(
        name="water", law="fluid", density=DENSITY, youngs_modulus=E, poissons_ratio=nu,
        parameters={"viscosity": VISCOSITY},
    )  # fmt: skip
    sides = [Wall(axis=a, at=at, above=at == 0.0) for a in (0, 2) for at in (0.0, h)]
    slowest = 0.5 * np.pi / HEIGHT * np.sqrt(BULK / DENSITY)
    solver = UpdatedLagrangian(
        body, [water],
        settings(
            device, frames=int(SECONDS * FPS) + 1, fps=FPS, gravity=(0.0, -G0, 0.0),
            drag=2.0 * DRAG * float(slowest), filter_rate=np.inf,
        ),
        walls=[*sides, Wall(axis=1, at=0.0)],
    )  # fmt: skip
    given, last = 0.0, None
    for frame in solver.frames():
        before, given, last = given, float(solver.state.wall_impulse[1]), frame
    assert last is not None
    Y = body.X[:, 1]
    F = solver.state.elastic
    p = BULK / GAMMA * (np.linalg.det(F) ** -GAMMA - 1.0)
    foot = DENSITY * G0 * HEIGHT
    top = Y.max() == Y
    down = Y - last.particles.x[:, 1]
    exact = settled(Y)
    return Stood(
        pressure=float(np.abs(p - DENSITY * G0 * (HEIGHT - Y)).max() / foot),
        settlement=float(down[top].mean() / exact[top].mean() - 1.0),
        borne=(given - before) * FPS / (last.health.mass * G0),
        left=float(np.abs(last.particles.v).max() * np.sqrt(BULK * DENSITY) / foot),
    )


def hydrostatic(cells: Sequence[int]) -> Callable[[str], Iterator[Measure]]:
    """The finest of several columns."""

    def run(device: str) -> Iterator[Measure]:
        results = [stand(n, device) for n in cells]
        finest = results[-1]
        curve = Curve(
            title="column at rest: pressure", x_label="cell size h / height H",
            y_label="error / (rho g H)",
            x=tuple(1.0 / n for n in cells), y=tuple(one.pressure for one in results),
        )  # fmt: skip
        why = (
            "half a percent is required. The error of the grid is of second order, 0.0002 with 8"
            " cells, since planes mirror; single precision adds 6e-8 of strain a substep, which is"
            f" {SOFT:g} times as much of the pressure (0.0012 with 32 cells, measured)"
        )
        yield Measure(
            name="pressure", value=finest.pressure, target=0.0, bound=0.005, kind=ABSOLUTE,
            unit="rho g H", why=why, curve=curve if len(results) > 1 else None,
        )  # fmt: skip
        yield Measure(
            name="settlement", value=1.0 + finest.settlement, target=1.0, bound=0.005,
            kind=RELATIVE, unit="of the closed form", why=why,
        )  # fmt: skip
        yield Measure(
            name="weight", value=finest.borne, target=1.0, bound=5e-4, kind=RELATIVE, unit="m g",
            why=(
                "momentum is conserved to rounding, so that the impulse of the floor equals that"
                " of the weight, except for residual motion, which drag damps"
            ),
        )  # fmt: skip
        yield Measure(
            name="speed", value=finest.left, target=0.0, bound=1e-3, kind=ABSOLUTE,
            unit="rho g H / sqrt(K rho)",
            why="the slowest wave is damped critically for eight of its periods",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="hydrostatic",
        what=(
            "A column of fluid stands between smooth walls on a smooth floor: its pressure at"
            " every height, its settlement, and the load on the floor."
        ),
        source="closed form: p = rho g (H - Y) and Tait's equation of state",
        quick=hydrostatic((16,)),
        full=hydrostatic((8, 16, 32)),
    ),
)

"""Final shape of a puddle of yield stress fluid on a rough floor.

A paste that has spread until it bears its weight has a shape like that of a glacier [Nye 1951]: on
the floor the shear stress is its yield stress tau, so that the thrust at a distance x from the
front is tau x.  With the pressure of the weight that is

    rho g h^2 / 2 = tau x,    h^2 = 2 tau x / (rho g)

for what is thin.  Where it is not, the paste stretches as it flows out, and bears along the floor
less than its weight by 2 sqrt(tau^2 - s^2), s = tau (1 - y / h) at the height y, that is

    rho g h^2 / 2 - pi tau h / 2 = tau x        [Dubash, Balmforth, Slim and Cochard 2009]

The error of the first is pi tau / (rho g h), 31 % of our puddle, ten times as high as
tau / (rho g), and 3 % of one a hundred times as high, which takes some 10^5 cells.
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

DENSITY, STANDS = 1000.0, 0.01  # [kg/m^3], [m] tau / (rho g)
TAU = DENSITY * G0 * STANDS  # [Pa] yield stress of shear
HIGH, WIDE = 0.12, 0.21  # [m] at the start, and from the wall to the front
SOFT = 100.0  # K in rho g HIGH
DRAG, SECONDS, FPS = 10.0, 6.0, 10.0  # [1/s]; with less the paste overshoots where it would stop


@dataclass(frozen=True, kw_only=True)
class Stopped:
    """A puddle at the end."""

    x: Floats  # (n,) [m] from the wall
    h: Floats  # (n,) [m]
    left: float  # kinetic energy [m g HIGH]


def spread(cells: int, device: str, seconds: float = SECONDS) -> Stopped:
    """A puddle that began as a block so many cells high."""
    d = HIGH / cells
    body = block((0.0, 0.0, 0.0), (round(WIDE / d), cells, 1), d)
    bulk = SOFT * DENSITY * G0 * HIGH
    mu = 0.2 * bulk
    E, nu = 9.0 * bulk * mu / (3.0 * bulk + mu), (3.0 * bulk - 2.0 * mu) / (6.0 * bulk + 2.0 * mu)
    paste = Material(
        name="paste", law="paste", density=DENSITY, youngs_modulus=E, poissons_ratio=nu,
        parameters={"yield_stress": 3.0**0.5 * TAU},
    )  # fmt: skip
    solver = UpdatedLagrangian(
        body, [paste],
        settings(
            device, frames=int(seconds * FPS) + 1, fps=FPS, gravity=(0.0, -G0, 0.0), drag=DRAG,
            filter_rate=np.inf,
        ),
        walls=[
            Wall(axis=0, at=0.0), Wall(axis=1, at=0.0, sticks=True), Wall(axis=2, at=0.0),
            Wall(axis=2, at=d, above=False),
        ],
    )  # fmt: skip
    *_, last = solver.frames()
    x = last.particles.x[:, 0]
    edges = d * np.arange(np.ceil(x.max() / d) + 1.0)
    area = np.histogram(x, edges, weights=body.V0)[0] / d
    left = last.health.kinetic / (last.health.mass * G0 * HIGH)
    return Stopped(x=0.5 * (edges[1:] + edges[:-1]), h=area / d, left=left)


def slope(one: Stopped) -> float:
    """The slope of the thrust along the middle of the puddle, over tau."""
    front = one.x[one.h > 0.0][-1]
    middle = (one.x > 0.2 * front) & (one.x < 0.8 * front)
    h = one.h[middle]
    thrust = 0.5 * DENSITY * G0 * h * h - 0.5 * np.pi * TAU * h
    return float(-np.polyfit(one.x[middle], thrust, 1)[0]) / TAU


def puddle(cells: Sequence[int]) -> Callable[[str], Iterator[Measure]]:
    """The finest of several puddles."""

    def run(device: str) -> Iterator[Measure]:
        results = [spread(n, device) for n in cells]
        slopes = [slope(one) for one in results]
        yield Measure(
            name="yield-stress", value=slopes[-1], target=1.0, bound=2.0 / cells[-1],
            kind=RELATIVE, unit="tau",
            why="a cell is 2 tau / (rho g) with 6 cells, in which the front, pi tau / (rho g) high,"
            " is not resolved, and a column of it has a height in eighths of a cell: of the order"
            " of the cell. 3 % are not met: 1.11 with 6 cells, 1.05 with 12; with four times the"
            " drag, so that nothing overshoots, 1.29, 1.11, 1.00, 0.94 with 6, 12, 18 and 24, by"
            " other parts of the length 0.86 to 1.02 with 24: the theory's next order, some 10 %",
            curve=Curve(
                title="puddle of paste: yield stress from its slope",
                x_label="cell size h / initial height",
                y_label="tau from the slope / tau", x=tuple(1.0 / n for n in cells),
                y=tuple(slopes), logarithmic=False, target=1.0,
            ) if len(results) > 1 else None,
        )  # fmt: skip
        yield Measure(
            name="at-rest", value=results[-1].left, target=0.0, bound=1e-5, kind=ABSOLUTE,
            unit="m g H", why="a puddle is at rest; the fall of the block has 0.1 and more",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="puddle",
        what=(
            "A block of paste spreads on a floor that it sticks to, and stops: the yield stress"
            " computed from the shape of the puddle."
        ),
        source="thrust over the floor: Nye 1951; Dubash, Balmforth, Slim and Cochard 2009",
        quick=puddle((6,)),
        full=puddle((6, 12)),
    ),
)

"""Slump of a column of paste under its own weight on a frictionless floor.

Slices that bear more than the yield stress Y spread until the weight above them, over their larger
area, is what they bear.  With y = Y / (rho g H) a column of height H becomes shorter by

    s = 1 - y (1 - ln y)        [Pashias, Boger, Summers and Glenister 1996, for 2 tau_y = Y]

The weight grows so slowly that the column is close to rest at every y.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.material import Material
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, mirror_plane, settings
from gf_usd.verify.case import RELATIVE, Case, Curve, Measure

HEIGHT, HALF = 1.0, 0.0625  # [m] of the column, and half of its width
YIELD, STIFF, DENSITY = 100.0, 300.0, 1000.0  # [Pa], E in yield stresses, [kg/m^3]
NU = 0.45
PERIODS = 160.0  # of the slowest elastic wave up and down, in which the weight grows to its end
DRAG = 0.5  # [1/period]
FRAMES = 60
YIELDS = (0.6, 0.4, 0.25)  # y at which the slump is read


def exact(y: Floats | float) -> Floats:
    """s [H] by the yield stress y [rho g H]."""
    y = np.asarray(y, float)
    return 1.0 - y * (1.0 - np.log(y))


def slumped(cells: int, least: float, device: str) -> tuple[Floats, Floats]:
    """y, falling to `least`, and the slump s [H] of a column `cells` cells wide from its middle."""
    h = HALF / cells
    body = block((0.0, 0.0, 0.0), (cells, round(HEIGHT / h), cells), h)
    material = Material(
        name="paste", law="vonMises", density=DENSITY, youngs_modulus=STIFF * YIELD,
        poissons_ratio=NU, parameters={"yield_stress": YIELD},
    )  # fmt: skip
    period = 4.0 * HEIGHT / float(np.sqrt(STIFF * YIELD / DENSITY))
    fps = FRAMES / (PERIODS * period)
    top = np.array([[0.0, HEIGHT, 0.0]])
    solver = TotalLagrangian(
        body, [material], settings(device, frames=FRAMES + 1, fps=fps, drag=DRAG / period),
        pins=[mirror_plane(axis, 0.0) for axis in range(3)], embedded={"top": top},
    )  # fmt: skip
    weight = YIELD / (least * DENSITY * HEIGHT)  # [m/s^2] at the end
    down = np.zeros((solver.body.stencil.free_count, 3))
    grown, s = np.arange(1, FRAMES + 1) / FRAMES, []
    for index, share in enumerate(grown, 1):
        down[:, 1] = -weight * share
        solver.state.accelerate(down)
        solver.advance(index, solver.substeps)
        s.append(HEIGHT - float(solver.read(index).embedded["top"].x[0, 1]))
    return least / grown, np.array(s) / HEIGHT


def slump(cells: Sequence[int]) -> Callable[[str], Iterator[Measure]]:
    """Slump during the collapse, of the finest of several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        results = [slumped(n, YIELDS[-1], device) for n in cells]
        for y in YIELDS:
            reached = [float(np.interp(-y, -ys, s)) for ys, s in results]
            yield Measure(
                name=f"slump-at-{y:g}", value=reached[-1], target=float(exact(y)), bound=0.05,
                kind=RELATIVE, unit="H",
                why=(
                    "the theory assumes slices that spread evenly, and neglects the flare of the"
                    " foot: 3 % of a column 8 times as high as wide, 19 % of one twice as high"
                    " (measured)"
                ),
                curve=Curve(
                    title="column of paste: slump", x_label="cell size h / half width",
                    y_label="slump s / height H",
                    x=tuple(1.0 / np.array(cells)), y=tuple(reached), logarithmic=False,
                    target=float(exact(y)),
                ) if y == YIELDS[-1] else None,
            )  # fmt: skip

    return run


CASES = (
    Case(
        name="slump",
        what=(
            "A column of perfectly plastic paste on a floor without friction becomes heavier until"
            " its load is four times its yield stress: its shortening at several weights."
        ),
        source="theory of slices (Pashias et al. 1996), which is within 10 % of experiments",
        quick=slump((1,)),
        full=slump((1, 2, 3)),
    ),
)

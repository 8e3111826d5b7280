"""Euler's elastica: large bending of a slender beam by a dead load at its end.

The load is applied slowly and the motion is critically damped, so that the beam is at rest when its
tip is measured; the result depends on neither the rate nor the mass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, clamp, elastic, settings
from gf_usd.verify.case import RELATIVE, Case, Curve, Measure

E, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]; the beam is 1 m long
# P L^2 / E I -> deflection w / L and shortening u / L of the tip.
ELASTICA = {1.0: (0.30172, 0.05643), 2.0: (0.49346, 0.16064), 5.0: (0.71379, 0.38763),
            10.0: (0.81061, 0.55500)}  # fmt: skip
FRAMES = 100  # a period: the load changes, and the beam is put back into its plane, so often
RAMP, WAIT = 0.75, 1.0  # [periods] to raise the load, and to come to rest


@dataclass(frozen=True, kw_only=True)
class Beam:
    """Its numbers, by slenderness L/t and cells through the thickness; it is one cell wide."""

    slenderness: int
    cells: int

    @property
    def h(self) -> float:
        return 1.0 / (self.slenderness * self.cells)

    @property
    def thickness(self) -> float:
        return 1.0 / self.slenderness

    @property
    def load(self) -> float:
        """[N] that makes P L^2 / E I = 1."""
        return E * self.h * self.thickness**3 / 12.0

    @property
    def omega(self) -> float:
        """[rad/s] of the first vibration: 1.8751^2 sqrt(E I / rho A) / L^2."""
        return 1.87510**2 * float(np.sqrt(E / DENSITY / 12.0)) * self.thickness


def bend(beam: Beam, loads: Sequence[float], device: str) -> list[tuple[float, float]]:
    """(w / L, u / L) of the tip under each load P L^2 / E I in turn."""
    h, n = beam.h, beam.cells
    body = block((0.0, 0.0, 0.0), (beam.slenderness * n, n, 1), h, places=GAUSS)
    period = 2.0 * np.pi / beam.omega
    s = settings(device, fps=FRAMES / period, drag=2.0 * beam.omega, safety=0.8)
    line = ((np.arange(n)[:, None] + GAUSS) * h).ravel()
    end = np.array([[1.0, y, z] for y in line for z in GAUSS * h])
    tip = np.array([[1.0, 0.5 * beam.thickness, 0.5 * h]])
    solver = TotalLagrangian(
        body, [elastic(E=E, nu=0.0, density=DENSITY)], s, pins=[clamp(0, 0.0)],
        embedded={"tip": tip},
    )  # fmt: skip
    # Spread over the end face, and brought to the nodes by the rows of its points.
    nodes = solver.body.stencil
    share = np.asarray(nodes.rows(end).W[:, : nodes.free_count].mean(0)).ravel()
    unit = solver.body.mass.acceleration(np.outer(share, [0.0, -beam.load, 0.0]))
    plane = Plane(solver, 0.5 * h)
    out, index, before = [], 0, 0.0
    for load in loads:
        for k in range(round((RAMP + WAIT) * FRAMES)):
            rise = min(1.0, (k + 0.5) / (RAMP * FRAMES))
            now = before + (load - before) * 0.5 * (1.0 - np.cos(np.pi * rise))
            solver.state.accelerate(now * unit)
            index += 1
            solver.advance(index, solver.coarse)
            plane.keep()
        before = load
        moved = (solver.read(index).embedded["tip"].x - tip)[0]
        out.append((-float(moved[1]), -float(moved[0])))
    return out


class Plane:
    """Keeps the motion symmetric about the plane of bending, z = middle [m].

    A blade one cell wide buckles sideways under a hundredth of the load.  Nothing pushes it there
    but rounding; the mean of the state and its mirror image has none, and never more energy.
    """

    def __init__(self, solver: TotalLagrangian, middle: float) -> None:
        X = solver.body.stencil.node_X
        image = X * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * middle]
        self.solver, self.partner = solver, cKDTree(X).query(image)[1]

    def keep(self) -> None:
        """Replace u and v by their symmetric parts."""
        for name in "uv":
            q = self.solver.state.get(name).reshape(-1, 3)
            self.solver.state.put(name, 0.5 * (q + q[self.partner] * [1.0, 1.0, -1.0]))


def elastica(
    beam: Beam, loads: Sequence[float], bound: float, why: str
) -> Callable[[str], Iterator[Measure]]:
    """Deflection and shortening next to those of the elastica."""

    def run(device: str) -> Iterator[Measure]:
        results = bend(beam, loads, device)
        curve = Curve(
            title="elastica: deflection of the tip", x_label="load P L^2 / (E I)",
            y_label="deflection w / length L",
            x=tuple(loads), y=tuple(w for w, _ in results), logarithmic=False,
        )  # fmt: skip
        for load, figures in zip(loads, results):
            for name, value, target in zip("wu", figures, ELASTICA[load]):
                yield Measure(
                    name=f"{name}.{load:g}", value=value, target=target, bound=bound,
                    kind=RELATIVE, unit="L", why=why, curve=curve if name == "w" else None,
                )  # fmt: skip

    return run


CASES = (
    Case(
        name="cantilever",
        what="A beam 20 times as long as thick, nu = 0, clamped at one end, is bent by a dead load"
        " at the other until its tip points down.  Deflection w and shortening u of the tip at four"
        " loads.",
        source="closed form: the elastica (Bisshopp and Drucker 1945)",
        quick=elastica(
            Beam(slenderness=10, cells=2), (1.0, 2.0), 0.01,
            "10 times as long as thick: the elastica has no shear, 0.6 (t/L)^2 = 0.6 % of w, nor"
            " stretch; bending itself is exact to 0.1 % from 2 cells through the thickness",
        ),
        full=elastica(
            Beam(slenderness=20, cells=8), tuple(ELASTICA), 0.01,
            "20 times as long as thick: the elastica has no shear, 0.6 (t/L)^2 = 0.15 % of w, nor"
            " the stretch that a steep load gives the beam, P / E A = 0.2 %; residual motion 0.1 %",
        ),
    ),
)  # fmt: skip

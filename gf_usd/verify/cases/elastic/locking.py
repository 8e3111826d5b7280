"""Locking: bending stiffness of nearly incompressible material.

The first bending vibration of a free beam determines its modulus, as in measurements of real bars.
The formula of the standard (ASTM E1876) has errors up to 0.4 % at nu = 0.49, more than the solver;
the reference is the frequency of the three-dimensional beam (`ritz.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, iterate_states, settings
from gf_usd.verify.case import Case, Curve, Measure, fit_frequency
from gf_usd.verify.ritz import bending_frequency

E, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]; the beam is 1 m long
SLENDERNESS = 8
ROOT, SIGMA = 4.730041, 0.982502  # of cos x cosh x = 1; of the mode's shape
AMPLITUDE = 2e-3  # [m]
SAMPLES = 40  # a period


def exact(nu: float) -> float:
    """Angular frequency [rad/s] of a square free beam."""
    return bending_frequency(nu, SLENDERNESS) * float(np.sqrt(E / DENSITY))


def shape(x: Floats) -> tuple[Floats, Floats]:
    """Bending mode (n,) along x in 0 .. 1, about 2 at the ends, and its slope."""
    z = ROOT * x
    value = np.cosh(z) + np.cos(z) - SIGMA * (np.sinh(z) + np.sin(z))
    slope = ROOT * (np.sinh(z) - np.sin(z) - SIGMA * (np.cosh(z) + np.cos(z)))
    return value, slope


def bending(nu: float, cells: int, periods: float, device: str) -> float:
    """Angular frequency [rad/s] of a beam with so many cells through the thickness."""
    h = 1.0 / (SLENDERNESS * cells)
    body = block((0.0, 0.0, 0.0), (SLENDERNESS * cells, cells, cells), h)
    expected = exact(nu)
    s = settings(
        device, frames=round(periods * SAMPLES) + 1, fps=SAMPLES * expected / (2.0 * np.pi),
        safety=0.8,
    )  # fmt: skip
    middle = 0.5 / SLENDERNESS

    def mode(X: Floats) -> Floats:
        value, slope = shape(X[:, 0])
        v = np.stack([-(X[:, 1] - middle) * slope, value, np.zeros(len(X))], 1)
        return AMPLITUDE * expected * v

    material = elastic(E=E, nu=nu, density=DENSITY)
    solver = TotalLagrangian(body, [material], s, velocity=mode)
    w = shape(body.X[:, 0])[0]
    w = w - w.mean()
    times, amplitudes = [], []
    for time, now in iterate_states(solver):
        times.append(time)
        amplitudes.append(w @ (now.particles.x - body.X)[:, 1] / (w @ w))
    return fit_frequency(np.array(times), np.array(amplitudes), expected)


def locking(
    ratios: Sequence[float], cells: int, periods: float = 1.5
) -> Callable[[str], Iterator[Measure]]:
    """Stiffness errors of bending for several Poisson's ratios."""

    def run(device: str) -> Iterator[Measure]:
        errors = [(bending(nu, cells, periods, device) / exact(nu)) ** 2 - 1.0 for nu in ratios]
        curve = Curve(
            title="bending stiffness over Poisson's ratio", x_label="Poisson's ratio",
            y_label="relative error of the stiffness",
            x=tuple(ratios), y=tuple(errors), logarithmic=False, target=0.0,
        )  # fmt: skip
        for nu, value in zip(ratios, errors):
            yield Measure(
                name=f"stiffness.{nu:g}", value=value, target=0.0,
                bound=2.0 * (ROOT / (SLENDERNESS * cells)) ** 2 / 8.0,
                curve=curve if nu == ratios[-1] else None,
                why="of second order at every nu: no more than twice (k h)^2 / 8, by which the row"
                f" sums of the mass slow a wave of k = {ROOT:.3g} / L, h = 1 / {cells} of the"
                " thickness",
            )  # fmt: skip

    return run


CASES = (
    Case(
        name="locking",
        what="A free square beam, 8 times as long as thick, vibrates in its first bending mode."
        "  Its frequency gives the stiffness, which must not grow as the material becomes"
        " incompressible.",
        source="linear elasticity in three dimensions by the Ritz method, converged to 1e-6"
        " (Visscher et al. 1991)",
        quick=locking((0.0, 0.49), 3),
        full=locking((0.0, 0.3, 0.45, 0.49), 6),
    ),
)

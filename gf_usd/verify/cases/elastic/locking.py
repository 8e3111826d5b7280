"""Nearly incompressible material: is bending too stiff?

The first bending vibration of a free beam tells its modulus; that is how moduli of real bars are
measured, and the standard for it gives the frequency for every Poisson's ratio.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, settings
from gf_usd.verify.case import Case, Curve, Measure, frequency

E, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]; the beam is 1 m long
SLENDERNESS = 8
ROOT, SIGMA = 4.730041, 0.982502  # of cos x cosh x = 1; of the mode's shape
AMPLITUDE = 2e-3  # [m]
SAMPLES = 40  # a period


def standard(nu: float) -> float:
    """Angular frequency [rad/s] of a square free beam by ASTM E1876, eq. 1 and 2."""
    r = 1.0 / SLENDERNESS
    T = (
        1.0
        + 6.585 * (1.0 + 0.0752 * nu + 0.8109 * nu**2) * r**2
        - 0.868 * r**4
        - 8.340 * (1.0 + 0.2023 * nu + 2.173 * nu**2) * r**4
        / (1.0 + 6.338 * (1.0 + 0.1408 * nu + 1.536 * nu**2) * r**2)
    )  # fmt: skip
    # E = .9465 (m f^2 / b) (L / t)^3 T with m = rho L b t.
    return 2.0 * np.pi * float(np.sqrt(E * r**2 / (0.9465 * DENSITY * T)))


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
    expected = standard(nu)
    s = settings(
        device, frames=round(periods * SAMPLES) + 1, fps=SAMPLES * expected / (2.0 * np.pi),
        safety=0.8,
    )  # fmt: skip
    middle = 0.5 / SLENDERNESS

    def mode(X: Floats) -> Floats:
        value, slope = shape(X[:, 0])
        v = np.stack([-(X[:, 1] - middle) * slope, value, np.zeros(len(X))], 1)
        return AMPLITUDE * expected * v

    made = elastic(E=E, nu=nu, density=DENSITY)
    solver = TotalLagrangian(body, [made], s, velocity=mode)
    w = shape(body.X[:, 0])[0]
    w = w - w.mean()
    times, amplitudes = [], []
    for frame in solver.frames():
        times.append(frame.time)
        amplitudes.append(w @ (frame.particles.x - body.X)[:, 1] / (w @ w))
    return frequency(np.array(times), np.array(amplitudes), expected)


def locking(
    ratios: Sequence[float], cells: int, periods: float = 1.5
) -> Callable[[str], Iterator[Measure]]:
    """Stiffness errors of bending for several Poisson's ratios, the first of them 0."""

    def run(device: str) -> Iterator[Measure]:
        errors = [(bending(nu, cells, periods, device) / standard(nu)) ** 2 - 1.0 for nu in ratios]
        curve = Curve(
            title="stiffness error of bending", x_label="nu", y_label="error",
            x=tuple(ratios), y=tuple(errors), logarithmic=False, target=0.0,
        )  # fmt: skip
        yield Measure(
            name="stiffness.0", value=errors[0], target=0.0, bound=0.4 / cells**2, curve=curve,
            why=f"the row sums of the mass, which spread the beam by half a cell, would have .35 /"
            f" n^2, n = {cells} cells through the thickness (measured); the mass matrix no more",
        )  # fmt: skip
        for nu, value in zip(ratios[1:], errors[1:]):
            yield Measure(
                name=f"locking.{nu:g}", value=value - errors[0], target=0.0, bound=0.015,
                why="how much stiffer than at nu = 0, each next to its own reference: measured .8 %"
                " at nu = .49 whatever the grid, part of it the standard's own error of .3 %",
            )  # fmt: skip

    return run


CASES = (
    Case(
        name="locking",
        what="A free square beam, 8 times as long as thick, vibrates in its first bending mode."
        "  Its frequency gives the stiffness, which must not grow as the material becomes"
        " incompressible.",
        source="ASTM E1876 (impulse excitation of bars)",
        quick=locking((0.0, 0.49), 3),
        full=locking((0.0, 0.3, 0.45, 0.49), 6),
    ),
)

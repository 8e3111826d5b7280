"""A bar that is fixed at one end and free at the other: its first longitudinal vibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gf_usd.model import Floats
from gf_usd.physics.solver import TotalLagrangian
from gf_usd.verify.bodies import MIDDLE, block, clamp, elastic, settings
from gf_usd.verify.case import AT_LEAST, RELATIVE, Case, Curve, Measure
from gf_usd.verify.fit import frequency, order

E, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]; the bar is 1 m long
EXACT = 0.5 * np.pi * np.sqrt(E / DENSITY)  # [rad/s]
AMPLITUDE = 0.02  # [m]
PERIODS, SAMPLES = 3, 40


def first_mode(cells: int, device: str, places: Floats | None = MIDDLE) -> float:
    """Angular frequency [rad/s] of a bar with so many cells along it; places: see `block`."""
    h = 1.0 / cells
    body = block((0.0, 0.0, 0.0), (cells, 2, 2), h, places=places)
    s = settings(
        device, frames=PERIODS * SAMPLES + 1, fps=SAMPLES * EXACT / (2.0 * np.pi), safety=0.25
    )

    def mode(X: Floats) -> Floats:
        return np.sin(0.5 * np.pi * X[:, :1]) * [AMPLITUDE * EXACT, 0.0, 0.0]

    solver = TotalLagrangian(
        body, [elastic(E=E, nu=0.0, density=DENSITY)], s, velocity=mode, pins=[clamp(0, 0.0)]
    )
    # The part of the motion that has the shape of the mode.
    shape = np.sin(0.5 * np.pi * body.X[:, 0])
    times, amplitudes = [], []
    for frame in solver.frames():
        times.append(frame.time)
        amplitudes.append(shape @ (frame.particles.x - body.X)[:, 0] / (shape @ shape))
    return frequency(np.array(times), np.array(amplitudes), EXACT)


def bar(*cells: int) -> Callable[[str], Iterator[Measure]]:
    """The frequency at several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        h = 1.0 / np.array(cells)
        w = np.array([first_mode(n, device) for n in cells])
        error = w / EXACT - 1.0
        lumping = (0.5 * np.pi / cells[-1]) ** 2 / 8.0
        yield Measure(
            name="frequency", value=float(w[-1]), target=EXACT, bound=1.5 * lumping, kind=RELATIVE,
            unit="rad/s",
            why=f"lumped mass lowers the frequency by (k h)^2 / 8 = {lumping:.1e}, k = pi / 2L,"
            f" with {cells[-1]} cells along the bar; half as much again for the places of the"
            " particles",
        )  # fmt: skip
        yield Measure(
            name="order", value=order(h, error), target=2.0, bound=0.1, kind=AT_LEAST,
            why="quadratic splines with lumped mass and a pin that mirrors across its boundary;"
            " coarse grids show a little of the next order",
            curve=Curve(
                title="fixed-free bar, error of the first frequency", x_label="h / L",
                y_label="error", x=tuple(h), y=tuple(np.abs(error)),
            ),
        )  # fmt: skip
        yield Measure(
            name="sampled", value=first_mode(cells[-1], device, None), target=EXACT, bound=0.01,
            kind=RELATIVE, unit="rad/s",
            why="particles at random in their strata do not integrate a slope exactly: a share of"
            " the stiffness is lost that grows with the square of the jitter and stays as the grid"
            " is refined, measured .5 % for a jitter of .35",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="bar",
        what="A bar with nu = 0, pinned at one end, starts with the velocity of its first mode."
        "  Its frequency must be (pi / 2L) sqrt(E / rho), and the error must fall with h^2.",
        source="closed form",
        quick=bar(8, 16, 32),
        full=bar(8, 16, 32, 64),
    ),
)

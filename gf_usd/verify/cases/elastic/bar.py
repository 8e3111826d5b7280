"""The first longitudinal vibration of a bar with one fixed end.

Also large, fast stretch: a block with a fixed top face under its own weight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, MIDDLE, block, clamp, elastic, iterate_states, settings
from gf_usd.verify.case import (
    AT_LEAST,
    RELATIVE,
    Case,
    Curve,
    Measure,
    convergence_order,
    fit_frequency,
    interpolate_minimum,
)

E, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]; the bar is 1 m long
EXACT = 0.5 * np.pi * np.sqrt(E / DENSITY)  # [rad/s]
AMPLITUDE = 0.02  # [m]
PERIODS, SAMPLES = 3, 40


def first_mode(cells: int, device: str, places: Floats = MIDDLE) -> float:
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
    for time, now in iterate_states(solver):
        times.append(time)
        amplitudes.append(shape @ (now.particles.x - body.X)[:, 0] / (shape @ shape))
    return fit_frequency(np.array(times), np.array(amplitudes), EXACT)


def bar(*cells: int) -> Callable[[str], Iterator[Measure]]:
    """The frequency at several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        h = 1.0 / np.array(cells)
        w = np.array([first_mode(n, device) for n in cells])
        error = w / EXACT - 1.0
        places = (0.5 * np.pi / cells[-1]) ** 2 / 96.0
        yield Measure(
            name="frequency", value=float(w[-1]), target=EXACT, bound=1.5 * places, kind=RELATIVE,
            unit="rad/s",
            why=(
                "particles in the middle of their strata give h^2 / 16 instead of h^2 / 12 as the"
                " mean square of x in a cell of length h, which lowers the frequency by (k h)^2 /"
                f" 96 = {places:.1e}, k = pi / 2L, with {cells[-1]} cells along the bar; half as"
                " much again for the pin"
            ),
        )  # fmt: skip
        yield Measure(
            name="order", value=convergence_order(h, error), target=2.0, bound=0.1, kind=AT_LEAST,
            why=(
                "quadratic splines and a pin that mirrors across its boundary; coarse grids show a"
                " small term of the next order"
            ),
            curve=Curve(
                title="fixed-free bar: first frequency", x_label="cell size h / length L",
                y_label="relative error", x=tuple(h), y=tuple(np.abs(error)),
            ),
        )  # fmt: skip
        yield Measure(
            name="sampled", value=first_mode(cells[-1], device, GAUSS), target=EXACT,
            bound=places, kind=RELATIVE, unit="rad/s",
            why=(
                "the points of Gauss's rule, where a bake has its particles, integrate the slopes"
                " exactly: the error is smaller than that of the other positions"
            ),
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


VERTICAL_E, NU, VERTICAL_DENSITY, G = 1e6, 0.3, 1050.0, 1000.0  # [Pa], -, [kg/m^3], [m/s^2]
# Lowest point of the bottom corner [m] and when [s], what tools/vertical_reference.py tends to.  An
# independent finite element code agrees.  A figure of -1.7146 m is published for such a block: it
# is not of this set-up.
LIMIT, TIME = -1.751, 0.0884
END, FRAMES = 0.1, 100  # [s] simulated
TIP = 0.01  # of it: the required accuracy
FLAT = 0.004  # [s] the corner is within 1 % of its lowest for so long before and after


def stretch(cells: int, device: str) -> tuple[float, float]:
    """Time [s] and displacement [m] of the lowest point of the bottom corner.

    cells : along the edge of the cube.  Its top face may slide but not leave its plane.  That is
    the symmetry plane of a body twice as high whose halves are pulled apart, which is simulated.
    """
    h = 1.0 / cells
    body = block((-0.5, -1.0, -0.5), (cells, 2 * cells, cells), h, places=GAUSS)
    material = elastic(E=VERTICAL_E, nu=NU, density=VERTICAL_DENSITY, law="neoHookean")
    s = settings(device, frames=FRAMES + 1, fps=FRAMES / END)
    corner = np.array([[x, -1.0, z] for x in (-0.5, 0.5) for z in (-0.5, 0.5)])
    solver = TotalLagrangian(body, [material], s, embedded={"corner": corner})
    # Weight at the particles, brought to the nodes: those at the plane hang on both halves.
    pull = np.zeros((len(body), 3))
    pull[:, 1] = solver.body.m * np.where(body.X[:, 1] < 0.0, -G, G)
    solver.state.accelerate(solver.body.mass.acceleration(solver.body.rows.combined.T @ pull))
    times, tips = [], []
    for frame in solver.frames():
        times.append(frame.time)
        tips.append(float((frame.embedded["corner"].x - corner)[:, 1].mean()))
    return interpolate_minimum(np.array(times), np.array(tips))


def hang(*cells: int) -> Callable[[str], Iterator[Measure]]:
    """The tip at one or several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        times, tips = np.transpose([stretch(n, device) for n in cells])
        yield Measure(
            name="tip", value=float(tips[-1]), target=LIMIT, bound=TIP, kind=RELATIVE, unit="m",
            why=f"{cells[-1]} cells along the edge; 1 % is required: linear finite"
            " elements on the same equations (tools/vertical_reference.py, 8, 12, 16, 24, 32, 48"
            " along the edge) have -1.7640, -1.7618, -1.7571, -1.7519, -1.7519, -1.7511",
            curve=Curve(
                title="vertical bar: lowest position of the tip", x_label="cell size h [m]",
                y_label="position of the tip [m]",
                x=tuple(1.0 / np.array(cells)), y=tuple(tips), logarithmic=False, target=LIMIT,
            ),
        )  # fmt: skip
        late = END / FRAMES if cells[-1] >= 24 else FLAT
        yield Measure(
            name="time", value=float(times[-1]), target=TIME, bound=late / TIME, kind=RELATIVE,
            unit="s",
            why=(
                "the corner oscillates about the motion of the block with a period of 0.01 s, and"
                f" stays within 1 % of its lowest for {FLAT} s on either side: on coarse grids a"
                " neighboring wave is the deepest; 24 cells separate them, and the error is one"
                " frame"
            ),
        )  # fmt: skip

    return run


VERTICAL_CASES = (
    Case(
        name="vertical",
        what="A cube of 1 m, Neo-Hookean, hangs by its top face, which may slide sideways, when a"
        " gravity of 1000 m/s^2 sets in.  It stretches to 2.7 times its length; how far the bottom"
        " corner comes down, and when.",
        source="finite elements, two independent codes: -1.751 m at 0.0884 s (a published"
        " -1.7146 m is not of this set-up)",
        quick=hang(8),
        full=hang(8, 12, 16, 24),
    ),
)

"""Flesh that is driven: by springs to a pose, and by a part whose motion is given."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Goals, Pin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, clamp, elastic, settings
from gf_usd.verify.case import RELATIVE, Case, Curve, Measure, frequency

RATE, DENSITY, G = 2.0 * np.pi * 3.0, 1000.0, 9.81  # [rad/s], [kg/m^3], [m/s^2]
TOLERANCE = 1e-3


def still(X: Floats) -> Callable[[float], Floats]:
    """The rest pose, at any frame."""
    return lambda frame: X


def springs(device: str) -> Iterator[Measure]:
    """A block on springs to where it rests: its swing, and how far it sags."""
    body = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
    soft = [elastic(E=1e5, nu=0.3, density=DENSITY)]
    goals = Goals(pose=still, rate=lambda X: np.full(len(X), RATE), damping=0.0, moving=False)
    s = settings(device, frames=121, fps=360.0)
    seen = list(TotalLagrangian(body, soft, s, velocity=(0.2, 0.0, 0.0), goals=goals).frames())
    x = np.array([frame.particles.x[:, 0].mean() for frame in seen])
    dt = s.frame_time / max(frame.health.substeps for frame in seen)
    yield Measure(
        name="frequency", value=frequency(np.array([f.time for f in seen]), x - x[0], RATE),
        target=float(np.sqrt(DENSITY * RATE**2 / DENSITY)), bound=TOLERANCE, kind=RELATIVE,
        unit="rad/s",
        why=f"the midpoint rule is slow by (w dt)^2 / 12 = {(RATE * dt) ** 2 / 12.0:.1e}; 0.1 % is"
        " what is asked for",
    )  # fmt: skip
    damped = replace(goals, damping=1.0)
    s = settings(device, frames=33, fps=24.0, gravity=(0.0, -G, 0.0))
    *_, last = TotalLagrangian(body, soft, s, goals=damped).frames()
    yield Measure(
        name="sag", value=float((body.X - last.particles.x)[:, 1].mean()),
        target=DENSITY * G / (DENSITY * RATE**2), bound=TOLERANCE, kind=RELATIVE, unit="m",
        why="at rest the rule of the step does not matter: rounding, and e^(-w t) of the way; 0.1 %"
        " is what is asked for",
    )  # fmt: skip


E_BAR, PERIODS, SAMPLES, AMPLITUDE = 1e6, 2, 60, 0.002  # [Pa], -, a period, [m]
SPEED = np.sqrt(E_BAR / DENSITY)  # [m/s] of waves; the bar is 1 m long
ANSWER = 1.0 / np.cos(1.0)  # 1.8508


def driven(pin: Pin, behind: float, cells: int, device: str) -> float:
    """Amplitude of the free end over that of the base, which swings with w L / c = 1.

    pin : what is driven; behind : [cells] of the bar that lie behind the base; cells : of it all.
    """
    w = SPEED
    fps = SAMPLES * w / (2.0 * np.pi)
    count = PERIODS * SAMPLES + 1
    h = 1.0 / (cells - behind)
    body = block((-behind * h, 0.0, 0.0), (cells, 2, 2), h)
    shift = AMPLITUDE * np.sin(w * np.arange(count + 1) / fps)
    moving = replace(pin, path=pin.anchors + shift[:, None, None] * np.eye(3)[0])

    def mode(X: Floats) -> Floats:
        x = np.maximum(X[:, :1], 0.0)
        return AMPLITUDE * w * np.cos(1.0 - x) / np.cos(1.0) * [1.0, 0.0, 0.0]

    tip = np.array([[1.0, h, h]])
    solver = TotalLagrangian(
        body, [elastic(E=E_BAR, nu=0.0, density=DENSITY)], settings(device, frames=count, fps=fps),
        velocity=mode, pins=[moving], embedded={"tip": tip},
    )  # fmt: skip
    seen = [(frame.time, frame.embedded["tip"].x[0, 0] - 1.0) for frame in solver.frames()]
    t, u = np.array(seen).T
    base = np.stack([np.sin(w * t), np.cos(w * t), np.ones_like(t)], 1)
    sine = np.linalg.lstsq(base, u, rcond=None)[0]
    return float(sine[0] / AMPLITUDE)


# [cells] between where flesh begins and the last node that a core holds.  Slopes of quadratic
# splines are linear between the middles of edges.  Under an even stress they are 1 - r^i, with
# r = -(2 - 3^(1/2)), behind one that is 0: together -r / (1 - r) more than without the core.
FIRM = (2.0 - 3.0**0.5) / (3.0 - 3.0**0.5)


def base(*cells: int) -> Callable[[str], Iterator[Measure]]:
    """The answer of the bar to a driven face, and to a driven core at several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        yield Measure(
            name="face", value=driven(clamp(0, 0.0), 0.0, cells[-1], device), target=ANSWER,
            bound=0.01, kind=RELATIVE,
            why=f"{cells[-1]} cells along the bar; its answer changes by 1.56 % for 1 % of its"
            " length; 1 % is what is asked for",
        )  # fmt: skip
        # nodes lie in the middle of cells: the last of those that the core holds is at x = 0
        core = replace(clamp(0, 1e-6), sharp=False)
        behind = 2.5
        h = 1.0 / (np.array(cells) - behind)
        answers = np.array([driven(core, behind, n, device) for n in cells])
        slope = float(np.tan(1.0))  # d ln(1 / cos x) / dx at 1
        yield Measure(
            name="core", value=float(answers[-1]), target=ANSWER, bound=1.5 * slope * FIRM * h[-1],
            kind=RELATIVE,
            why=f"flesh begins {FIRM:.2f} cells before the last node that is held, and the bar is"
            " longer by that; half as much again for the terms behind the linear one",
        )  # fmt: skip
        yield Measure(
            name="limit", value=float(np.polyfit(h, answers, 1)[1]), target=ANSWER, bound=0.01,
            kind=RELATIVE,
            why="the line through the answers of the core at h = 0; 1 % is asked for",
            curve=Curve(
                title="bar on a driven core", x_label="h / L", y_label="answer", x=tuple(h),
                y=tuple(answers), logarithmic=False, target=ANSWER,
            ),
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="goals",
        what="A block hangs on springs alone that draw it to where it rests.  It must swing with"
        " sqrt(k / rho) and sag by rho g / k, k the stiffness of the springs per volume.",
        source="closed form",
        quick=springs,
    ),
    Case(
        name="driven",
        what="The base of a bar with nu = 0 swings by U at w L / c = 1.  Its free end must swing by"
        " U / cos 1, whether the base is a face of the bar or a core inside of it.",
        source="closed form",
        quick=base(8, 16),
        full=base(16, 32),
    ),
)

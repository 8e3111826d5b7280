"""Driven flesh: springs to goals, and a part with prescribed motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Goals, Pin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, clamp, elastic, settings
from gf_usd.verify.case import RELATIVE, Case, Curve, Measure, fit_frequency

RATE, DENSITY, G = 2.0 * np.pi * 3.0, 1000.0, 9.81  # [rad/s], [kg/m^3], [m/s^2]
TOLERANCE = 1e-3


def rest_pose(X: Floats) -> Callable[[float], Floats]:
    """A pose function that returns the rest positions in all frames."""
    return lambda frame: X


def springs(device: str) -> Iterator[Measure]:
    """Frequency and static sag of a block on springs to its rest positions."""
    body = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
    soft = [elastic(E=1e5, nu=0.3, density=DENSITY)]
    goals = Goals(pose=rest_pose, rate=lambda X: np.full(len(X), RATE), damping=0.0, moving=False)
    s = settings(device, frames=121, fps=360.0)
    results = list(TotalLagrangian(body, soft, s, velocity=(0.2, 0.0, 0.0), goals=goals).frames())
    x = np.array([frame.particles.x[:, 0].mean() for frame in results])
    dt = s.frame_time / max(frame.health.substeps for frame in results)
    yield Measure(
        name="frequency", value=fit_frequency(np.array([f.time for f in results]), x - x[0], RATE),
        target=float(np.sqrt(DENSITY * RATE**2 / DENSITY)), bound=TOLERANCE, kind=RELATIVE,
        unit="rad/s",
        why=f"the midpoint rule is slow by (w dt)^2 / 12 = {(RATE * dt) ** 2 / 12.0:.1e}; 0.1 % is"
        " required",
    )  # fmt: skip
    damped = replace(goals, damping=1.0)
    s = settings(device, frames=33, fps=24.0, gravity=(0.0, -G, 0.0))
    *_, last = TotalLagrangian(body, soft, s, goals=damped).frames()
    yield Measure(
        name="sag", value=float((body.X - last.particles.x)[:, 1].mean()),
        target=DENSITY * G / (DENSITY * RATE**2), bound=TOLERANCE, kind=RELATIVE, unit="m",
        why=(
            "at rest the integration rule does not matter: rounding, and e^(-w t) of the"
            " displacement; 0.1 % is required"
        ),
    )  # fmt: skip


E_BAR, PERIODS, SAMPLES, AMPLITUDE = 1e6, 2, 60, 0.002  # [Pa], -, per period, [m]
SPEED = np.sqrt(E_BAR / DENSITY)  # [m/s] of waves; the bar is 1 m long
AMPLITUDE_RATIO = 1.0 / np.cos(1.0)  # 1.8508


def amplitude_ratio(pin: Pin, behind: float, cells: int, device: str) -> float:
    """Amplitude of the free end over that of the base, which oscillates with w L / c = 1.

    pin : driven region.   behind : [cells] length behind the base.   cells : total length.
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
    results = [(frame.time, frame.embedded["tip"].x[0, 0] - 1.0) for frame in solver.frames()]
    t, u = np.array(results).T
    base = np.stack([np.sin(w * t), np.cos(w * t), np.ones_like(t)], 1)
    sine = np.linalg.lstsq(base, u, rcond=None)[0]
    return float(sine[0] / AMPLITUDE)


# [cells] distance of the effective start of the flesh from the last node of a core.  Slopes of
# quadratic splines are linear between edge midpoints.  Under uniform stress they are 1 - r^i, with
# r = -(2 - 3^(1/2)), next to a slope of 0: in sum -r / (1 - r) more than without the core.
CORE_OFFSET = (2.0 - 3.0**0.5) / (3.0 - 3.0**0.5)


def driven_base(*cells: int) -> Callable[[str], Iterator[Measure]]:
    """Amplitude ratio of a bar with a driven face, and with a driven core of several cell sizes."""

    def run(device: str) -> Iterator[Measure]:
        yield Measure(
            name="face", value=amplitude_ratio(clamp(0, 0.0), 0.0, cells[-1], device),
            target=AMPLITUDE_RATIO,
            bound=0.01, kind=RELATIVE,
            why=f"{cells[-1]} cells along the bar; the amplitude ratio changes by 1.56 % for 1 %"
            " of its length; 1 % is required",
        )  # fmt: skip
        # nodes are at cell centers: the last node of the core is at x = 0
        core = replace(clamp(0, 1e-6), sharp=False)
        behind = 2.5
        h = 1.0 / (np.array(cells) - behind)
        ratios = np.array([amplitude_ratio(core, behind, n, device) for n in cells])
        slope = float(np.tan(1.0))  # d ln(1 / cos x) / dx at 1
        yield Measure(
            name="core", value=float(ratios[-1]), target=AMPLITUDE_RATIO,
            bound=1.5 * slope * CORE_OFFSET * h[-1],
            kind=RELATIVE,
            why=(
                f"flesh begins {CORE_OFFSET:.2f} cells before the last prescribed node, and the"
                " bar is longer by that; half as much again for the terms behind the linear one"
            ),
        )  # fmt: skip
        yield Measure(
            name="limit", value=float(np.polyfit(h, ratios, 1)[1]), target=AMPLITUDE_RATIO,
            bound=0.01,
            kind=RELATIVE,
            why="the line through the amplitude ratios of the core at h = 0; 1 % is required",
            curve=Curve(
                title="bar on a driven core: amplitude of the free end",
                x_label="cell size h / length L", y_label="amplitude ratio, end / base", x=tuple(h),
                y=tuple(ratios), logarithmic=False, target=AMPLITUDE_RATIO,
            ),
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="goals",
        what=(
            "A block is held only by springs that pull it to its rest position.  It must swing"
            " with sqrt(k / rho) and sag by rho g / k, k the stiffness of the springs per volume."
        ),
        source="closed form",
        quick=springs,
    ),
    Case(
        name="driven",
        what="The base of a bar with nu = 0 swings by U at w L / c = 1.  Its free end must swing by"
        " U / cos 1, whether the base is a face of the bar or a core inside of it.",
        source="closed form",
        quick=driven_base(8, 16),
        full=driven_base(16, 32),
    ),
)

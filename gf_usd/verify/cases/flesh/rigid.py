"""Rigid regions: a bar with a rigid end mass, and free rotation of a rigid body."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.core.stage import Pin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import box_particles, clamp, elastic, settings
from gf_usd.verify.case import ABSOLUTE, RELATIVE, Case, Measure, fit_frequency
from gf_usd.verify.cases.flesh.driven import CORE_OFFSET

E_BAR, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]
PERIODS, SAMPLES = 3, 40  # and samples of each


def rigid_region(axis: int, at: float) -> Pin:
    """The rigid region above a coordinate [m]."""
    plain = clamp(axis, at)
    return replace(plain, inside=lambda X: X[:, axis] > at, sharp=False, rigid=True)


def flesh_and_rigid_boxes(bounds: list[tuple[Floats, Floats]], h: float, at: float) -> Particles:
    """Boxes of flesh, material 0, below x = at [m], and of a rigid region, material 1."""
    body = box_particles(bounds, h, np.zeros(3))
    return replace(body, material=(body.X[:, 0] > at).astype(np.int64))


def swing(times: float, cells: int, device: str) -> tuple[float, float]:
    """beta = w L / c of a bar of 1 m with an end of so many times its mass, and its closed form."""
    root: Any = brentq(lambda b: b * np.tan(b) - 1.0 / times, 1e-6, np.pi / 2 - 1e-6)
    beta = float(root)
    # The last node of the flesh's side that the region takes lies FIRM cells before the boundary.
    h = 1.0 / (cells + 0.5 + CORE_OFFSET)
    wide = 2.0 * h
    ends = np.array([[0.0, 0.0, 0.0], [1.0, wide, wide], [1.0, 0.0, 0.0], [2.0, wide, wide]])
    body = flesh_and_rigid_boxes([(ends[0], ends[1]), (ends[2], ends[3])], h, 1.0)
    c = np.sqrt(E_BAR / DENSITY)
    fps = SAMPLES * beta * c / (2.0 * np.pi)
    table = [elastic(E=E_BAR, nu=0.0, density=rho) for rho in (DENSITY, times * DENSITY)]

    def mode(X: Floats) -> Floats:
        return 1e-3 * beta * c * np.sin(beta * np.minimum(X[:, :1], 1.0)) * [1.0, 0.0, 0.0]

    solver = TotalLagrangian(
        body, table, settings(device, frames=PERIODS * SAMPLES + 1, fps=fps), velocity=mode,
        pins=[clamp(0, 0.0), rigid_region(0, 1.0)], embedded={"end": np.array([[1.5, h, h]])},
    )  # fmt: skip
    results = [(frame.time, frame.embedded["end"].x[0, 0] - 1.5) for frame in solver.frames()]
    t, u = np.array(results).T
    return fit_frequency(t, u, beta * c) / c, beta


def loaded(cells: int) -> Callable[[str], Iterator[Measure]]:
    """A bar with a rigid end as heavy as the bar, and one ten times as heavy."""

    def run(device: str) -> Iterator[Measure]:
        for times in (1.0, 10.0):
            value, target = swing(times, cells, device)
            yield Measure(
                name=f"mass {times:g}", value=value, target=target, bound=0.01, kind=RELATIVE,
                why=f"{cells} cells along the bar; 1 % is required",
            )  # fmt: skip

    return run


SPIN, SECONDS, EDGE = np.array([0.3, 4.0, 0.2]), 3.0, 0.2  # [1/s] nearly about the middle axis


def euler_rotations(moments: Floats, omega: Floats, times: Floats) -> NDArray[np.float64]:
    """(T, 3, 3) rotations of a body with principal moments along x, y, z, by Euler's equations."""

    def rate(_: float, y: Floats) -> Floats:
        w, q = y[:3], y[3:]
        rotations = np.array([
            [0.0, -w[0], -w[1], -w[2]], [w[0], 0.0, w[2], -w[1]],
            [w[1], -w[2], 0.0, w[0]], [w[2], w[1], -w[0], 0.0],
        ])  # fmt: skip
        return np.concatenate([-np.cross(w, moments * w) / moments, 0.5 * rotations @ q])

    start = np.concatenate([omega, [1.0, 0.0, 0.0, 0.0]])
    solution = solve_ivp(rate, (0.0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12)
    return Rotation.from_quat(solution.y[[4, 5, 6, 3]].T).as_matrix()


def tumble(device: str) -> Iterator[Measure]:
    """A block with a thin cover of light flesh at one end turns for three seconds."""
    size, light = np.array([8.0, 4.0, 3.0]) * EDGE, 1e-4
    end = size[0] - EDGE
    body = flesh_and_rigid_boxes(
        [(np.array([0.0, 0.0, 0.0]), np.array([EDGE, *size[1:]])),
         (np.array([EDGE, 0.0, 0.0]), size)], EDGE, EDGE,
    )  # fmt: skip
    table = [elastic(E=1e3 * light, nu=0.3, density=rho) for rho in (light * DENSITY, DENSITY)]
    # the principal axes are those of the box; its moments without the flesh
    m = DENSITY * np.prod([end, *size[1:]])
    square = np.array([end, *size[1:]]) ** 2
    moments = m * (square.sum() - square) / 12.0
    center = np.array([EDGE + 0.5 * end, *(0.5 * size[1:])])
    corner = np.array([[size[0], 0.0, 0.0], size])
    frames = int(SECONDS * 24.0) + 1
    solver = TotalLagrangian(
        body, table, settings(device, frames=frames), pins=[rigid_region(0, EDGE)],
        velocity=lambda X: np.cross(SPIN, X - center), embedded={"corner": corner},
    )  # fmt: skip
    results = list(solver.frames())
    times = np.array([frame.time for frame in results])
    rotations = euler_rotations(moments, SPIN, times)
    x = np.stack([frame.embedded["corner"].x for frame in results])
    exact = center + np.einsum("tab,kb->tka", rotations, corner - center)
    half_diagonal = float(np.linalg.norm(corner - center, axis=1).max())
    yield Measure(
        name="precession", value=float(np.abs(x - exact).max()) / half_diagonal, target=0.0,
        bound=0.01,
        kind=ABSOLUTE,
        why="of the half diagonal; the flesh has 1e-4 of the density, and near the middle axis its"
        " part of the inertia grows by e^(w t); 1 % is required",
    )  # fmt: skip
    for name, values, scale in (
        ("momentum", [f.health.momentum for f in results],
         m * np.linalg.norm(SPIN) * half_diagonal),
        ("angular momentum", [f.health.angular_momentum for f in results],
         float(np.linalg.norm(moments * SPIN))),
    ):  # fmt: skip
        change = np.abs(np.array(values) - values[0]).max() / scale
        yield Measure(
            name=name, value=float(change), target=0.0, bound=1e-4, kind=ABSOLUTE,
            why="float32 in some thousand substeps",
        )  # fmt: skip


CASES = (
    Case(
        name="rigid-end",
        what="A bar with nu = 0 is fixed at one end and has a rigid part at the other, of M/m times"
        " its mass.  It must swing with beta tan beta = m / M, beta = w L / c.",
        source="closed form",
        quick=loaded(10),
        full=loaded(24),
    ),
    Case(
        name="tumble",
        what=(
            "A rigid block with flesh of negligible mass rotates freely, nearly about its"
            " intermediate axis.  It must precess according to Euler's equations, and conserve its"
            " momenta."
        ),
        source="Euler's equations, solved to 1e-10",
        quick=tumble,
    ),
)

"""Method of manufactured solutions with large strain, shear and rotation.

    x = R(t) (X + w),    w_a = G (sin(pi X_a) s_a + sin(pi X_b + 0.7) s_b),
    s_a = sin(c pi t + phi_a)

on the cube |X_a| < 1/2, with b the axis after a, c = sqrt(E / rho), and R a rotation about
(1, 2, 2) / 3 at a constant rate.  The forces follow from the Neo-Hookean law: in the inside
rho b = rho d2x/dt2 - Div P, and on the faces the traction P N.

Only x, its gradient F and P(F) are derived by hand: v is the derivative of x, and Div P that of
P(F(X)), by complex steps, f'(x) = Im f(x + i e) / e, exact to rounding (Squire and Trapp
1998), and the acceleration a central difference of v.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.material import Material
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, elastic, set_state, settings
from gf_usd.verify.case import AT_LEAST, Case, Curve, Measure, convergence_order
from gf_usd.verify.cases.elastic.manufactured import faces

E, NU, DENSITY, G = 1e6, 0.3, 1000.0, 0.12  # [Pa], -, [kg/m^3], [m]
RATE = np.pi * np.sqrt(E / DENSITY)  # [rad/s]
END = np.pi / RATE  # [s] half a period
TURN = 0.5 * np.pi / END  # [rad/s]
PHASE = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0
AXIS = np.array([1.0, 2.0, 2.0]) / 3.0
SHEAR = 0.7  # phase of what shears
TINY = 1e-30  # a complex step
STEP = 1e-4 / RATE  # [s] of the central difference: an error of STEP^2 RATE^2 / 6 = 2e-9
STIFFER = 1.5  # the fastest wave at these stretches over that at rest, with something to spare

SPIN = np.array([[0.0, -AXIS[2], AXIS[1]], [AXIS[2], 0.0, -AXIS[0]], [-AXIS[1], AXIS[0], 0.0]])


def rotation(t: complex) -> Any:
    """R (3, 3) at a time [s]; Rodrigues' formula."""
    angle = TURN * t
    return np.eye(3) + np.sin(angle) * SPIN + (1.0 - np.cos(angle)) * (SPIN @ SPIN)


def place(X: Any, t: complex) -> Any:
    """x (n, 3) [m]."""
    s = np.sin(RATE * t + PHASE)
    w = np.sin(np.pi * X) * s + np.sin(np.pi * np.roll(X, -1, 1) + SHEAR) * np.roll(s, -1)
    return (X + G * w) @ rotation(t).T


def velocity(X: Floats, t: float) -> Floats:
    """dx/dt (n, 3) [m/s]."""
    return np.imag(place(X, t + 1j * TINY)) / TINY


def acceleration(X: Floats, t: float) -> Floats:
    """d2x/dt2 (n, 3) [m/s^2]."""
    return (velocity(X, t + STEP) - velocity(X, t - STEP)) / (2.0 * STEP)


def gradient(X: Any, t: float) -> Any:
    """F (n, 3, 3)."""
    s = np.sin(RATE * t + PHASE)
    F = np.zeros((len(X), 3, 3), X.dtype) + np.eye(3)
    for a in range(3):
        b = (a + 1) % 3
        F[:, a, a] += np.pi * G * np.cos(np.pi * X[:, a]) * s[a]
        F[:, a, b] += np.pi * G * np.cos(np.pi * X[:, b] + SHEAR) * s[b]
    return rotation(t) @ F


def stress(X: Any, t: float, material: Material) -> Any:
    """P (n, 3, 3) [Pa] = mu (F - F^-T) + lam ln J F^-T."""
    F = gradient(X, t)
    inverse = np.linalg.inv(F).swapaxes(1, 2)
    log_J = np.log(np.linalg.det(F))[:, None, None]
    return material.mu * (F - inverse) + material.lam * log_J * inverse


def body_force(X: Floats, t: float, material: Material) -> Floats:
    """b (n, 3) [m/s^2]."""
    divergence = np.zeros_like(X)
    for axis in range(3):
        aside = X + 1j * TINY * np.eye(3)[axis]
        divergence += np.imag(stress(aside, t, material)[:, :, axis]) / TINY
    return acceleration(X, t) - divergence / DENSITY


def error(cells: int, device: str) -> float:
    """Largest L2 error of the particles over half a period, in units of G."""
    h = 1.0 / cells
    body = block(-0.5 * np.ones(3), [cells] * 3, h, places=GAUSS)
    material = elastic(E=E, nu=NU, density=DENSITY, law="neoHookean")
    # A substep a frame, so that forces change with every substep.
    steps = int(np.ceil(END * 4.0 * STIFFER * material.wave_speed / h))
    solver = TotalLagrangian(
        body, [material], settings(device, frames=steps + 1, fps=steps / END, substeps=1),
        real=np.float64,
    )  # fmt: skip
    X, normals = faces(cells)
    inner, outer = solver.body.rows.combined.T, solver.body.stencil.rows(X).W.T
    patch = 0.25 * h * h  # [m^2] of a Gauss point
    nodes = solver.body.stencil.node_X
    set_state(solver, place(nodes, 0.0) - nodes, velocity(nodes, 0.0))
    worst = 0.0
    for index in range(1, steps + 1):
        t = solver.state.time + 0.5 * solver.frame_time  # forces act in the middle of a step
        f = inner @ (solver.body.m[:, None] * body_force(body.X, t, material))
        f += outer @ (patch * np.einsum("nij,nj->ni", stress(X, t, material), normals))
        solver.state.accelerate(solver.body.mass.acceleration(f))
        solver.advance(index, 1)
        u = solver.body.rows.combined @ solver.state.view().u + solver.state.offset
        off = body.X + u - place(body.X, solver.state.time)
        worst = max(worst, float(np.sqrt((off**2).sum(1).mean())))
    return worst / G


def largest_stretches() -> tuple[float, float]:
    """The least and the greatest singular value of F in space and time."""
    line = np.linspace(-0.5, 0.5, 9)
    X = np.stack([g.ravel() for g in np.meshgrid(line, line, line)], 1)
    s = np.concatenate(
        [np.linalg.svd(gradient(X, t), compute_uv=False).ravel() for t in np.linspace(0.0, END, 17)]
    )
    return float(s.min()), float(s.max())


def converge(*cells: int) -> Callable[[str], Iterator[Measure]]:
    """The order of the error over several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        errors = np.array([error(n, device) for n in cells])
        h = 1.0 / np.array(cells)
        low, high = largest_stretches()
        yield Measure(
            name="order", value=convergence_order(h, errors), target=2.0, bound=0.15, kind=AT_LEAST,
            why="quadratic splines and the step, a fixed share of h / c, are of second order;"
            f" stretches are {low:.2f} to {high:.2f}, and of a wave of 2 m the next order shows on"
            " coarse grids: C h^2 (1 - h) has the order 2 - h / (1 - h), 1.85 for h = 1/8 m",
            curve=Curve(
                title="manufactured solution, large strain", x_label="cell size h [m]",
                y_label="L2 error / amplitude G", x=tuple(h), y=tuple(errors),
            ),
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="manufactured-finite",
        what=(
            "A cube is stretched and sheared by up to half while it turns by 90 degrees, according"
            " to a manufactured solution, driven by the body force and the tractions that the"
            " Neo-Hookean law requires for it.  The largest L2 error of displacement must fall"
            " with h^2."
        ),
        source="manufactured solution; its forces by complex-step differentiation of the law",
        quick=converge(4, 6, 8),
        full=converge(4, 6, 8, 12, 16),
        f64=True,
    ),
)

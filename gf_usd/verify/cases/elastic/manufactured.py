"""Method of manufactured solutions with small strain.

    u_a = G sin(pi X_a) sin(c pi t + phi_a),   c = sqrt(E / rho),   a = x, y, z

on the cube |X_a| < 1/2.  F is diagonal, F_a = 1 + pi G cos(pi X_a) sin(c pi t + phi_a), and so is
the Neo-Hookean P_a = mu (F_a - 1 / F_a) + lam ln J / F_a.  The forces follow: in the inside
rho b = rho d2u/dt2 - Div P, and on the faces the traction P_a.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.material import Material
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, block, elastic, set_state, settings
from gf_usd.verify.case import AT_LEAST, Case, Curve, Measure, convergence_order

E, NU, DENSITY, G = 1e7, 0.3, 1000.0, 1e-4  # [Pa], -, [kg/m^3], [m]
RATE = np.pi * np.sqrt(E / DENSITY)  # [rad/s]
PHASE = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0
PERIODS = 0.5


class Solution:
    """The closed form for a material."""

    def __init__(self, material: Material) -> None:
        self.mu, self.lam = material.mu, material.lam

    def u(self, X: Floats, t: float) -> Floats:
        """(n, 3) [m]."""
        return G * np.sin(np.pi * X) * np.sin(RATE * t + PHASE)

    def v(self, X: Floats, t: float) -> Floats:
        """(n, 3) [m/s]."""
        return RATE * G * np.sin(np.pi * X) * np.cos(RATE * t + PHASE)

    def F(self, X: Floats, t: float) -> Floats:
        """(n, 3) the diagonal."""
        return 1.0 + np.pi * G * np.cos(np.pi * X) * np.sin(RATE * t + PHASE)

    def P(self, X: Floats, t: float) -> Floats:
        """(n, 3) [Pa] the diagonal."""
        F = self.F(X, t)
        return self.mu * (F - 1.0 / F) + self.lam * np.log(F).sum(1, keepdims=True) / F

    def b(self, X: Floats, t: float) -> Floats:
        """(n, 3) [m/s^2] d2u/dt2 - Div P / rho; dP_a/dX_a by the chain rule through F_a."""
        F = self.F(X, t)
        slope = -(np.pi**2) * self.u(X, t)
        log_J = np.log(F).sum(1, keepdims=True)
        dP = (self.mu * (1.0 + F**-2) + self.lam * (1.0 - log_J) * F**-2) * slope
        return -(RATE**2) * self.u(X, t) - dP / DENSITY


def faces(cells: int) -> tuple[Floats, Floats]:
    """Gauss points (n, 3) on the six faces of the cube and their outward normals (n, 3)."""
    line = ((np.arange(cells)[:, None] + GAUSS) / cells - 0.5).ravel()
    a, b = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    X, normals = [], []
    for axis in range(3):
        for side in (-0.5, 0.5):
            X.append(np.insert(np.stack([a, b], 1), axis, side, axis=1))
            normals.append(np.tile(2.0 * side * np.eye(3)[axis], (len(a), 1)))
    return np.concatenate(X), np.concatenate(normals)


def error(cells: int, device: str) -> float:
    """Largest L2 error of the particles over half a period, in units of G."""
    h = 1.0 / cells
    body = block(-0.5 * np.ones(3), [cells] * 3, h, places=GAUSS)
    material = elastic(E=E, nu=NU, density=DENSITY, law="neoHookean")
    exact = Solution(material)
    period = 2.0 * np.pi / RATE
    # A substep a frame, so that forces change with every substep.
    steps = int(np.ceil(PERIODS * period * 4.0 * material.wave_speed / h))
    s = settings(device, frames=steps + 1, fps=steps / (PERIODS * period), substeps=1)
    X, normals = faces(cells)
    solver = TotalLagrangian(body, [material], s, real=np.float64)
    inner, outer = solver.body.rows.combined.T, solver.body.stencil.rows(X).W.T
    patch = 0.25 * h * h  # [m^2] of a Gauss point
    set_state(
        solver, exact.u(solver.body.stencil.node_X, 0.0), exact.v(solver.body.stencil.node_X, 0.0)
    )
    worst = 0.0
    for index in range(1, steps + 1):
        t = solver.state.time + 0.5 * solver.frame_time  # forces act in the middle of a step
        f = inner @ (solver.body.m[:, None] * exact.b(body.X, t))
        f += outer @ (patch * normals * exact.P(X, t))
        solver.state.accelerate(solver.body.mass.acceleration(f))
        solver.advance(index, 1)
        u = solver.body.rows.combined @ solver.state.view().u + solver.state.offset
        off = u - exact.u(body.X, solver.state.time)
        worst = max(worst, float(np.sqrt((off**2).sum(1).mean())))
    return worst / G


def converge(*cells: int) -> Callable[[str], Iterator[Measure]]:
    """The error at several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        errors = np.array([error(n, device) for n in cells])
        h = 1.0 / np.array(cells)
        yield Measure(
            name="slope", value=convergence_order(h, errors), target=2.0, bound=0.15, kind=AT_LEAST,
            why=(
                "quadratic splines with traction at their edges are second order in h, and so is"
                " the step, which is a fixed share of h / c; dependent nodes at edges add a small"
                " error"
            ),
            curve=Curve(
                title="manufactured solution, small strain", x_label="cell size h [m]",
                y_label="L2 error / amplitude G",
                x=tuple(h), y=tuple(errors),
            ),
        )  # fmt: skip
        yield Measure(
            name="error", value=float(errors[-1]), target=0.0,
            bound=1.5 * np.pi**3 / (8.0 * cells[-1] ** 2), unit="G",
            why="no more than with the row sums of the mass, which slow waves by (k h)^2 / 8,"
            f" k = pi: over half a period a phase of pi^3 / (8 n^2), n = {cells[-1]} cells, in the"
            " mean over the cube as much in units of G, and half as much again for edges",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="manufactured",
        what=(
            "A cube vibrates according to a manufactured solution, driven by the body force and"
            " the tractions that the Neo-Hookean law requires for it.  The largest L2 error of"
            " displacement over half a period must fall with h^2."
        ),
        source="manufactured solution: u = G sin(pi X) sin(c pi t + phi), G = 1e-4",
        quick=converge(4, 6, 8),
        full=converge(4, 8, 16, 32),
        f64=True,
    ),
)

"""Free vibrations and rotational inertia of unconstrained bodies, which test the mass matrix.

Lamb's vibrations of an elastic sphere of radius R, waves of shear at c_s and of pressure at c_p
(Lamb 1882; Love 1944, sections 194 to 196).  With j_l the spherical Bessel functions:

    torsional, degree l    u = j_l(w r / c_s) r x grad Y_l     (l - 1) j_l(x) = x j_l+1(x)
    radial                 u = j_1(w r / c_p) e_r              tan x = x / (1 - (c_p / 2 c_s)^2 x^2)

with x = w R / c_s of torsional ones and w R / c_p of radial ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import trimesh
from scipy.optimize import root_scalar
from scipy.special import eval_legendre, spherical_jn

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, ball, block, elastic, iterate_states, settings, sphere
from gf_usd.verify.case import AT_LEAST, Case, Curve, Measure, convergence_order, fit_frequency

NU, E, DENSITY = 0.25, 1e6, 1000.0  # -, [Pa], [kg/m^3]
AMPLITUDE = 1e-3  # largest velocity over c_s: strains stay linear to 1e-3
PERIODS, SAMPLES = 2, 12
FINE = 4  # subdivisions of the sphere: with 3 its facets alone are worth 0.3 % of T3


def first_root(f: Callable[[Any], Any], low: float, high: float) -> float:
    """The least x in (low, high) at which f changes its sign; f takes arrays."""
    x = np.linspace(low, high, 2001)
    y = np.asarray(f(x))
    k = int(np.flatnonzero(y[:-1] * y[1:] < 0.0)[0])
    return float(root_scalar(f, bracket=(x[k], x[k + 1])).root)


@dataclass(frozen=True)
class Mode:
    """One of Lamb's vibrations."""

    name: str
    degree: int  # l, of a torsional one; 0: radial
    tolerance: float  # largest error of its frequency at 8000 particles

    @property
    def root(self) -> float:
        """w R / c_s."""
        n = self.degree
        if n:
            return first_root(
                lambda x: (n - 1) * spherical_jn(n, x) - x * spherical_jn(n + 1, x), 0.5, 12.0
            )
        ratio = (2.0 - 2.0 * NU) / (1.0 - 2.0 * NU)  # (c_p / c_s)^2
        x = first_root(lambda x: np.sin(x) * (1.0 - 0.25 * ratio * x * x) - x * np.cos(x), 1.0, 6.0)
        return x * float(np.sqrt(ratio))

    def shape(self, X: Floats, R: float) -> Floats:
        """u (n, 3) at points X (n, 3) about the middle, of size one at most; axis z."""
        r = np.maximum(np.linalg.norm(X, axis=1), 1e-12 * R)
        x = self.root * r / R
        if not self.degree:
            x = x / np.sqrt((2.0 - 2.0 * NU) / (1.0 - 2.0 * NU))
            u = (spherical_jn(1, x) / r)[:, None] * X
        else:
            n, c = self.degree, X[:, 2] / r
            # dP_n/dc = n (P_n-1 - c P_n) / sin^2, and e_phi = (-y, x, 0) / (r sin)
            sin2 = np.maximum(1.0 - c * c, 1e-12)
            slope = n * (eval_legendre(n - 1, c) - c * eval_legendre(n, c)) / sin2
            u = (spherical_jn(n, x) * slope / r)[:, None] * np.cross([0.0, 0.0, 1.0], X)
        return u / np.linalg.norm(u, axis=1).max()


MODES = (Mode("T2", 2, 0.01), Mode("T3", 3, 0.02), Mode("T4", 4, 0.03), Mode("radial", 0, 0.005))


@cache
def sphere_of(particles: int) -> Particles:
    """A ball of about so many particles, the same for all modes."""
    return ball(particles, subdivisions=FINE)[0]


def lamb_error(mode: Mode, particles: int, device: str) -> tuple[float, float]:
    """w / w_Lamb - 1, and h / R."""
    body = sphere_of(particles)
    material = elastic(E=E, nu=NU, density=DENSITY)
    R, shear = body.radius, float(np.sqrt(material.mu / DENSITY))
    exact = mode.root * shear / R
    s = settings(
        device, frames=PERIODS * SAMPLES + 1, fps=SAMPLES * exact / (2.0 * np.pi), safety=0.25
    )
    middle = (body.V0 @ body.X) / body.V0.sum()
    solver = TotalLagrangian(
        body, [material], s, velocity=lambda X: AMPLITUDE * shear * mode.shape(X - middle, R)
    )
    shape = mode.shape(body.X - middle, R)
    times, amplitudes = [], []
    for time, now in iterate_states(solver):
        times.append(time)
        amplitudes.append(float((shape * (now.particles.x - body.X)).sum()))
    w = fit_frequency(np.array(times), np.array(amplitudes), exact)
    return w / exact - 1.0, solver.body.h / R


def lamb(*counts: int) -> Callable[[str], Iterator[Measure]]:
    """The frequencies at several numbers of particles, 8000 the last but for a finer one."""

    def run(device: str) -> Iterator[Measure]:
        for mode in MODES:
            found = np.array([lamb_error(mode, n, device) for n in counts])
            error, h = found[:, 0], found[:, 1]
            yield Measure(
                name=mode.name, value=1.0 + float(error[-1]), target=1.0, bound=mode.tolerance,
                why=f"the tolerance required with 8000 particles, here with {counts[-1]}",
                curve=Curve(
                    title=f"free sphere: frequency of mode {mode.name}",
                    x_label="cell size h / radius R", y_label="relative error",
                    x=tuple(h), y=tuple(np.abs(error)),
                ),
            )  # fmt: skip
            if len(h) > 2 and mode.degree:
                yield Measure(
                    name=f"order.{mode.name}", value=convergence_order(h, error), target=2.0,
                    bound=0.15,
                    kind=AT_LEAST,
                    why="of second order or better: cut cells are integrated up to the second"
                    " moments; from two counts to the next the order scatters",
                )  # fmt: skip

    return run


TOLERANCE_OF_INERTIA = 1e-3  # of the inertia
SPINS = np.eye(3)  # [rad/s] about each axis in turn


def spun(body: Particles, spin: Floats, device: str) -> tuple[float, float]:
    """Kinetic energy [J] and angular momentum along the axis, halved, of a body that turns.

    spin : [rad/s] of size one, about the middle of the particles.
    """
    middle = (body.V0 @ body.X) / body.V0.sum()
    material = elastic(E=E, nu=NU, density=DENSITY)
    solver = TotalLagrangian(
        body, [material], settings(device), velocity=lambda X: np.cross(spin, X - middle)
    )
    health = solver.read(0).health
    return health.kinetic, 0.5 * float(np.dot(health.angular_momentum, spin))


def inertia(*counts: int) -> Callable[[str], Iterator[Measure]]:
    """Rigid rotations of a box and of balls of several numbers of particles."""

    def run(device: str) -> Iterator[Measure]:
        sides = np.array([4.0, 3.0, 2.0])
        box = block(-0.5 * sides, (4, 3, 2), 1.0, places=GAUSS)
        closed = 0.5 * DENSITY * sides.prod() * ((sides**2).sum() - sides**2) / 12.0
        ratio = np.array([spun(box, w, device) for w in SPINS]) / closed[:, None]
        yield Measure(
            name="box", value=off_most(ratio), target=1.0, bound=TOLERANCE_OF_INERTIA,
            why="the required tolerance, for a box of 4 x 3 x 2 cells of Gauss points, which have"
            " its inertia m (a^2 + b^2) / 12; the row sums would have 1 + 6 h^2 / (a^2 + b^2), up"
            " to 1.46",
        )  # fmt: skip
        mesh = sphere(1.0, FINE)
        solid = trimesh.Trimesh(mesh.points, mesh.triangles, process=False)
        own = 0.5 * DENSITY * np.diag(solid.moment_inertia)
        ratios, h = [], []
        for count in counts:
            body = sphere_of(count)
            of_nodes = np.array([spun(body, w, device) for w in SPINS])
            ratios.append(off_most(of_nodes / own[:, None]))
            h.append(2.0 * body.lattice / body.radius)
        yield Measure(
            name="ball", value=ratios[0], target=1.0, bound=TOLERANCE_OF_INERTIA,
            why=f"the required tolerance, for a ball of {counts[0]} particles against the"
            " polyhedron that they fill; the row sums would have 1 + 5/4 (h / R)^2",
            curve=Curve(
                title="ball: moment of inertia of the mass matrix",
                x_label="cell size h / radius R", y_label="relative error", x=tuple(h),
                y=tuple(np.abs(np.array(ratios) - 1.0)),
            ),
        )  # fmt: skip

    return run


def off_most(ratios: Floats) -> float:
    """The ratio that is farthest from one."""
    return float(ratios.flat[np.abs(ratios - 1.0).argmax()])


CASES = (
    Case(
        name="lamb",
        what="A free elastic sphere, nu = 1/4, starts with the velocity of one of its vibrations."
        "  The frequencies of the lowest torsional ones of degree 2, 3 and 4 and of the lowest"
        " radial one.",
        source="Lamb 1882; Love 1944, sections 194 to 196",
        quick=lamb(2000, 8000),
        full=lamb(2000, 8000, 32_000),
    ),
    Case(
        name="inertia",
        what="A box and a ball turn rigidly about each axis: kinetic energy and angular momentum"
        " over those of the body.",
        source="closed form: integrals over a box and over a polyhedron",
        quick=inertia(2000),
        full=inertia(2000, 8000),
    ),
)

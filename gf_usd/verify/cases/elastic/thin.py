"""Bending vibration of rods thinner than a grid cell, sampled as in a bake.

The lowest vibration of a free slender rod of length L, k L = 4.730 (Timoshenko 1928, section 55):

    w = k^2 sqrt(E I / rho A)        I / A = t^2 / 12 for a square one of thickness t

The strain of bending is z w'', odd through the thickness, and the particles of a cut cell have the
second moments of its content: so the stiffness against bending is integrated exactly, as long as
the nodes can follow the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import trimesh
from scipy.optimize import root_scalar

from gf_usd.core.arrays import Floats
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import elastic, iterate_states, make_solid, settings
from gf_usd.verify.case import RELATIVE, Case, Measure, fit_frequency
from gf_usd.verify.cases.sampling import surface_from_mesh

E, NU, DENSITY = 1e6, 0.3, 1000.0  # [Pa], -, [kg/m^3]
THICKNESS, SLENDER = 1.0, 24.0  # [m], and the length over it
TILT = (0.3, 0.5, 0.7)  # [rad] Euler angles of the rod across the grid
KL = float(root_scalar(lambda x: np.cos(x) * np.cosh(x) - 1.0, bracket=(4.0, 5.0)).root)
SPEED = 1e-3  # of the rod's thickness times w: strains stay linear
PERIODS, SAMPLES = 1.5, 16
BOUND = 0.4  # of the frequency


def shape(x: Floats) -> Floats:
    """Deflection of the lowest vibration, of size one at the ends, at x (n,) from the middle."""
    half = 0.5 * KL
    s = KL * x / (SLENDER * THICKNESS)
    cosine, hyperbolic = float(np.cos(half)), float(np.cosh(half))
    return (np.cos(s) / cosine + np.cosh(s) / hyperbolic) / 2.0


def bending(across: float, tilted: bool, device: str) -> float:
    """The frequency over that of the beam; across : particles through the thickness."""
    mesh = trimesh.creation.box((SLENDER * THICKNESS, THICKNESS, THICKNESS))
    turn = trimesh.transformations.euler_matrix(*TILT) if tilted else np.eye(4)
    mesh.apply_transform(turn)
    along, _, up = turn[:3, :3].T
    body = sample_solid(
        make_solid(surface_from_mesh(mesh, "/Rod")),
        particles=None,
        spacing=THICKNESS / across,
        seed=0,
    )
    radius = THICKNESS / np.sqrt(12.0)
    exact = (KL / (SLENDER * THICKNESS)) ** 2 * float(np.sqrt(E / DENSITY)) * radius
    speed = SPEED * THICKNESS * exact

    def start(X: Floats) -> Floats:
        # Cross-sections turn with the slope, or the rod would begin with shear.
        x, z, d = X @ along, X @ up, 1e-3 * THICKNESS
        slope = (shape(x + d) - shape(x - d)) / (2.0 * d)
        return speed * (np.outer(shape(x), up) - np.outer(slope * z, along))

    s = settings(
        device, frames=int(PERIODS * SAMPLES) + 1, fps=SAMPLES * exact / (2.0 * np.pi), safety=0.8
    )
    solver = TotalLagrangian(body, [elastic(E=E, nu=NU, density=DENSITY)], s, velocity=start)
    weight = body.V0 * shape(body.X @ along)
    results = [
        (t, float(weight @ ((now.particles.x - body.X) @ up))) for t, now in iterate_states(solver)
    ]
    t, q = np.transpose(results)
    return fit_frequency(t, q, exact) / exact


def rods(*across: float) -> Callable[[str], Iterator[Measure]]:
    """Rods of several numbers of particles through the thickness, along the grid and across it."""

    def run(device: str) -> Iterator[Measure]:
        for count in across:
            for name, tilted in (("along", False), ("slanted", True)):
                yield Measure(
                    name=f"{name}.{count:g}", value=bending(count, tilted, device), target=1.0,
                    bound=BOUND, kind=RELATIVE,
                    why=(
                        "no independent reference for the size of this error: light nodes at the"
                        " boundary are interpolated from the others by an affine fit, which"
                        " stiffens parts that are a cell thick or less.  The bound is a third to"
                        " twice the stiffness; a rod that folds like cloth has none"
                    ),
                )  # fmt: skip

    return run


CASES = (
    Case(
        name="thin",
        what="A free square rod, 24 times as long as thick, bends in its lowest vibration: with one"
        " particle through its thickness, half a cell of the grid, and with more.",
        source="closed form: Timoshenko, Vibration Problems in Engineering, 1928, section 55",
        quick=rods(1.0),
        full=rods(0.5, 1.0, 2.0, 3.0),
    ),
)

"""The elastic drop of all solvers of `tools/bench/peers`, as numbers; it needs only NumPy.

A ball of radius 1 m meets a hard frictionless floor with the speed of a fall from half a meter, is
compressed and rebounds.  Everything is f32 on the solver's side.  The law is fixed corotated where
a solver has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RADIUS = 1.0  # [m]
DENSITY = 1000.0  # [kg/m^3]
GRAVITY = 9.81  # [m/s^2], along -y
FALL = 0.5  # [m] that the ball has fallen when it meets the floor
SPEED = float(np.sqrt(2.0 * GRAVITY * FALL))  # [m/s]
MU = 26.1 * DENSITY * GRAVITY * RADIUS  # [Pa], the preset "rubber"
LAM = 13.1 * DENSITY * GRAVITY * RADIUS  # [Pa]
POISSON = LAM / (2.0 * (LAM + MU))
YOUNG = 2.0 * MU * (1.0 + POISSON)  # [Pa]
WAVE_SPEED = float(np.sqrt((LAM + 2.0 * MU) / DENSITY))  # [m/s]
COURANT = 0.25  # dt c / h: half of what the strictest of the explicit solvers stands
FPS = 120.0  # frames per second of the drop
SECONDS = 0.65  # [s] from touching the floor to past the top of the rebound
GAP = 0.02  # [m] between ball and floor at the start
FIELD_AT = 1.5  # [m] above and below the center, from where a field pushes the ball together


@dataclass(frozen=True)
class Ball:
    """Particles in strata of edge `lattice`, about the origin."""

    X: NDArray[np.float64]  # (n, 3) [m]
    volume: float  # [m^3] of each particle
    lattice: float  # [m]
    corner: NDArray[np.float64]  # (3,) [m] of the lattice


def ball(n: int) -> Ball:
    """About n particles, one at a random place in each stratum of the ball."""
    volume = 4.0 / 3.0 * np.pi * RADIUS**3
    a = float(np.cbrt(volume / n))
    k = int(np.ceil(2.0 * RADIUS / a))
    corner = np.full(3, -0.5 * k * a)
    cube = np.stack(np.unravel_index(np.arange(k**3), (k, k, k)), -1)
    place = 0.5 + 0.7 * (np.random.default_rng(0).random(cube.shape) - 0.5)
    X = corner + a * (cube + place)
    X = X[np.linalg.norm(X, axis=1) < RADIUS]
    return Ball(X=X, volume=volume / len(X), lattice=a, corner=corner)


def sphere_points(n: int) -> NDArray[np.float64]:
    """n points on the ball, by the golden angle (Gonzalez 2010)."""
    k = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * k / n, np.pi * (1.0 + np.sqrt(5.0)) * k
    rho = np.sqrt(1.0 - z * z)
    return RADIUS * np.stack([rho * np.cos(turn), z, rho * np.sin(turn)], -1)


def cell(n: int) -> float:
    """[m] grid spacing h for n particles: eight of them in a full cell."""
    return 2.0 * ball(n).lattice


def step(n: int) -> float:
    """[s] the substep that all explicit solvers take with n particles."""
    return COURANT * cell(n) / WAVE_SPEED

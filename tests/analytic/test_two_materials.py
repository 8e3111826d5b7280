"""A bar of a soft and a stiff half, with a sharp border and a blended one: its first vibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh_tridiagonal

from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.per_particle import of_materials
from gf_usd.geometry.connected.bodies import smoothstep
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import MIDDLE, block, clamp, elastic, settings
from gf_usd.verify.case import fit_frequency

CELLS, DENSITY = 24, 1000.0
SOFT, STIFF = 2e5, 2e6  # [Pa]; the soft half is clamped, the bar is 1 m long
AMPLITUDE, PERIODS, SAMPLES = 0.005, 2, 24
FINE = 4000


def modulus(x: np.ndarray, width: float) -> np.ndarray:
    share = smoothstep(0.5 + (x - 0.5) / width) if width else (x > 0.5).astype(float)
    return SOFT + (STIFF - SOFT) * share


def first_mode(width: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Frequency [rad/s] and shape of (E u')' = -rho w^2 u, u(0) = 0, E u'(1) = 0.

    Finite differences: springs in series between masses.
    """
    h = 1.0 / FINE
    k = modulus((np.arange(FINE) + 0.5) * h, width) / h
    m = np.full(FINE, DENSITY * h)
    m[-1] /= 2.0
    diagonal = (k + np.append(k[1:], 0.0)) / m
    off = -k[1:] / np.sqrt(m[1:] * m[:-1])
    values, vectors = eigh_tridiagonal(diagonal, off, select="i", select_range=(0, 0))
    shape = np.append(0.0, vectors[:, 0] / np.sqrt(m))
    return float(np.sqrt(values[0])), np.arange(FINE + 1) * h, shape / shape[-1]


def measured(body: Particles, materials, exact, x, shape) -> float:
    s = settings(
        "cpu", frames=PERIODS * SAMPLES + 1, fps=SAMPLES * exact / (2.0 * np.pi), safety=0.5
    )

    def mode(X):
        return np.interp(X[:, :1], x, shape) * [AMPLITUDE * exact, 0.0, 0.0]

    solver = TotalLagrangian(body, materials, s, velocity=mode, pins=[clamp(0, 0.0)])
    form = np.interp(body.X[:, 0], x, shape)
    frames = list(solver.frames())
    way = [form @ (f.particles.x - body.X)[:, 0] / (form @ form) for f in frames]
    return fit_frequency(np.array([f.time for f in frames]), np.array(way), exact)


def test_the_series_formula_of_two_halves():
    # tan(k1 / 2) tan(k2 / 2) = sqrt(E1 / E2), k = w sqrt(rho / E), of waves in two halves
    w = first_mode(0.0)[0]
    k1, k2 = (w * np.sqrt(DENSITY / E) for E in (SOFT, STIFF))
    # second order: (k h)^2 of 4000 springs is 1e-7
    assert np.tan(k1 / 2) * np.tan(k2 / 2) == pytest.approx(np.sqrt(SOFT / STIFF), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.0, 0.5])
def test_the_first_frequency_is_that_of_springs_in_series(width):
    exact, x, shape = first_mode(width)
    h = 1.0 / CELLS
    body = block((0.0, 0.0, 0.0), (CELLS, 2, 2), h, places=MIDDLE)
    materials = [elastic(E=E, nu=0.0, density=DENSITY) for E in (SOFT, STIFF)]
    body = replace(body, material=(body.X[:, 0] > 0.5).astype(np.int64))
    if width:
        values = of_materials(body, materials)
        E = modulus(body.X[:, 0], width)
        body = replace(body, own={**values, "mu": 0.5 * E, "lam": 0.0 * E})
    w = measured(body, materials, exact, x, shape)
    # Splines cannot kink, so that about half a cell of the soft half stretches like the stiff one:
    # w^2 rises by half a cell of the half meter, w by h / 2, where the border is sharp.  Over one
    # twelve cells wide lumped mass lowers it by (k h)^2 / 8, with k of the soft half; as much again
    # for the places of the particles.
    k = exact * np.sqrt(DENSITY / SOFT)
    bound = 2.0 * (k * h) ** 2 / 8.0 if width else 0.5 * h
    assert w == pytest.approx(exact, rel=bound)
    # the mean modulus would be far off: this measures the order of the halves as well
    mean = 0.5 * np.pi * np.sqrt(0.5 * (SOFT + STIFF) / DENSITY)
    assert abs(mean / exact - 1.0) > 0.5

"""Vibrations of bodies with cut cells at the surface, sampled as in a bake.

A free bar of length L with nu = 0, across the grid, vibrates along itself:

    u = cos(pi x / L) e,    w = (pi / L) sqrt(E / rho),    with x along the bar from an end

which leaves its sides without stress.  A hollow sphere breathes (Love 1944, section 196):

    u = (A j_1(k r) + B y_1(k r)) e_r,    k = w / c_p
    (lambda + 2 mu) u' + 2 lambda u / r = 0 at both radii
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import root_scalar
from scipy.special import spherical_jn, spherical_yn

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Surface
from gf_usd.core.frames.particles import Particles
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import elastic, iterate_states, make_solid, settings, sphere
from gf_usd.verify.case import AT_LEAST, Case, Curve, Measure, convergence_order, fit_frequency
from gf_usd.verify.cases.sampling import LENGTH, WIDTH, slanted_bar

E, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]
SPEED = 1e-3  # of the waves: strains stay linear to 1e-3
PERIODS, SAMPLES = 2, 16
NU = 0.25  # of the hollow sphere
INNER, OUTER, FINE = 0.5, 1.0, 4  # [m] radii, subdivisions

Field = Callable[[Floats], Floats]  # places (n, 3) -> (n, 3)


def vibration(body: Particles, nu: float, mode: Field, exact: float, device: str) -> float:
    """w / exact - 1 of a body that starts with the velocity of a mode, of size one."""
    material = elastic(E=E, nu=nu, density=DENSITY)
    s = settings(
        device, frames=PERIODS * SAMPLES + 1, fps=SAMPLES * exact / (2.0 * np.pi), safety=0.25
    )
    speed = SPEED * material.wave_speed
    solver = TotalLagrangian(body, [material], s, velocity=lambda X: speed * mode(X))
    shape = body.V0[:, None] * mode(body.X)
    results = [
        (t, float((shape * (now.particles.x - body.X)).sum())) for t, now in iterate_states(solver)
    ]
    t, q = np.transpose(results)
    return fit_frequency(t, q, exact) / exact - 1.0


def along(particles: int, device: str) -> tuple[float, float]:
    """Error of the frequency of the bar, and h over its thickness."""
    surface = slanted_bar()
    body = sample_solid(make_solid(surface), particles=particles, spacing=None, seed=0)
    spread = surface.points - surface.points.mean(0)
    way = np.linalg.svd(spread, full_matrices=False)[2][0]
    wave = np.pi / LENGTH

    def mode(X: Floats) -> Floats:
        return np.outer(np.sin(wave * (X - surface.points.mean(0)) @ way), way)

    exact = wave * float(np.sqrt(E / DENSITY))
    return vibration(body, 0.0, mode, exact, device), 2.0 * body.lattice / WIDTH


def hollow() -> Surface:
    """A sphere with a spherical hole."""
    skin, hole = sphere(OUTER, FINE), sphere(INNER, FINE)
    triangles = np.concatenate([skin.triangles, hole.triangles[:, ::-1] + len(skin.points)])
    return replace(
        skin, path="/Hollow", points=np.concatenate([skin.points, hole.points]),
        triangles=triangles, face_counts=np.full(len(triangles), 3),
        face_indices=triangles.ravel(),
        triangle_corners=np.arange(triangles.size).reshape(-1, 3),
    )  # fmt: skip


def breathing(a: float, b: float, ratio: float) -> tuple[float, Callable[[Floats], Floats]]:
    """k [1/m] of the lowest vibration between radii [m], and its u(r), of size one.

    ratio : lambda / (lambda + 2 mu).
    """
    functions = (spherical_jn, spherical_yn)

    def stress(f: Callable[..., Floats], k: float, r: float) -> float:
        return float(k * f(1, k * r, True) + 2.0 * ratio * f(1, k * r) / r)

    def both(k: float) -> float:
        (ja, ya), (jb, yb) = ([stress(f, k, r) for f in functions] for r in (a, b))
        return ja * yb - ya * jb

    grid = np.linspace(0.1, 6.0, 600) / b
    signs = np.sign([both(float(k)) for k in grid])
    first = int(np.flatnonzero(signs[:-1] != signs[1:])[0])
    k = float(root_scalar(both, bracket=(grid[first], grid[first + 1])).root)
    A, B = (stress(spherical_yn, k, a), -stress(spherical_jn, k, a))

    def u(r: Floats) -> Floats:
        return A * spherical_jn(1, k * r) + B * spherical_yn(1, k * r)

    size = float(np.abs(u(np.linspace(a, b, 100))).max())
    return k, lambda r: u(r) / size


def breathe(particles: int, device: str) -> tuple[float, float, float]:
    """Error of the frequency of the hollow sphere, (k h)^2 / 8, and h over its wall."""
    solid = make_solid(hollow())
    body = sample_solid(solid, particles=particles, spacing=None, seed=0)
    # Radii of the same volume: facets lie under the spheres.
    b = float(np.cbrt(3.0 * body.V0.sum() / (4.0 * np.pi * (1.0 - (INNER / OUTER) ** 3))))
    a = b * INNER / OUTER
    material = elastic(E=E, nu=NU, density=DENSITY)
    k, u = breathing(a, b, material.lam / (material.lam + 2.0 * material.mu))

    def mode(X: Floats) -> Floats:
        r = np.linalg.norm(X, axis=1)
        near = np.maximum(r, 0.5 * a)  # nodes in the hole are the particles' business
        return (u(near) / near)[:, None] * X

    h = 2.0 * body.lattice
    error = vibration(body, NU, mode, k * material.wave_speed, device)
    return error, (k * h) ** 2 / 8.0, h / (b - a)


def bar(*counts: int) -> Callable[[str], Iterator[Measure]]:
    """The bar at several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        error, h = np.transpose([along(n, device) for n in counts])
        yield Measure(
            name="order", value=convergence_order(h, error), target=2.0, bound=0.15, kind=AT_LEAST,
            why="quadratic splines, and the moments of cut cells up to the second: of the order two"
            f" or better; from {1.0 / h[0]:.1f} to {1.0 / h[-1]:.1f} cells through the thickness,"
            " where the order itself scatters with how the surface cuts the cells",
            curve=Curve(
                title="free bar at an angle to the grid: longitudinal frequency",
                    x_label="cell size h / thickness",
                y_label="relative error", x=tuple(h), y=tuple(np.abs(error)),
            ),
        )  # fmt: skip
        yield Measure(
            name="frequency", value=1.0 + float(error[-1]), target=1.0, bound=float(h[-1] ** 2),
            why=(
                "the error of the surface is a fraction of a cell, of second order: (h /"
                " thickness)^2"
            ),
        )  # fmt: skip

    return run


def sphere_with_a_hole(*counts: int) -> Callable[[str], Iterator[Measure]]:
    """The hollow sphere at several resolutions."""

    def run(device: str) -> Iterator[Measure]:
        error, row_sums, h = np.transpose([breathe(n, device) for n in counts])
        for count, one, bound in zip(counts, error, row_sums):
            yield Measure(
                name=f"frequency.{count}", value=1.0 + float(one), target=1.0, bound=float(bound),
                why="of second order: no more than (k h)^2 / 8, by which the row sums of the mass"
                " slow waves; the error is far less and changes its sign, so that no order can be"
                " read off",
                curve=Curve(
                    title="hollow sphere: lowest radial frequency",
                    x_label="cell size h / wall thickness", y_label="relative error",
                    x=tuple(h), y=tuple(np.abs(error)),
                ) if count == counts[-1] else None,
            )  # fmt: skip

    return run


CASES = (
    Case(
        name="slanted",
        what=(
            "A free bar with nu = 0 lies at an angle to the grid, parallel to none of its planes,"
            " and vibrates longitudinally.  Its frequency must be (pi / L) sqrt(E / rho), and the"
            " error must fall with h^2."
        ),
        source="closed form",
        quick=bar(500, 1000, 2000),
        full=bar(500, 1000, 2000, 4000, 8000, 16_000),
    ),
    Case(
        name="hollow",
        what=(
            "A free hollow sphere, with a wall as thick as the radius of its cavity, vibrates"
            " radially: its lowest frequency, with curved surfaces on both sides."
        ),
        source="closed form: Love 1944, section 196",
        quick=sphere_with_a_hole(500, 2000),
        full=sphere_with_a_hole(500, 1000, 2000, 4000, 8000, 16_000),
    ),
)

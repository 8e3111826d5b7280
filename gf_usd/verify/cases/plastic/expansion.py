"""Plastic expansion of a thick cylinder until its hole is four times as wide.

Its material is perfectly plastic and as good as incompressible, so that a point at R comes to
r = sqrt(R^2 + a^2 - A^2) when the hole, A at rest, is a wide, and balance of forces leaves

    -sigma_rr(a) = Y / sqrt(3) ln((B^2 + a^2 - A^2) / a^2)        [Hill 1950, section V.2]

on the hole.  It is measured by the work of what widens the hole over the volume that it takes, less
the work of inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material, young_poisson
from gf_usd.core.stage import Pin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import (
    mirror_plane,
    plane_strain,
    plane_strain_slice,
    sample_strata,
    settings,
)
from gf_usd.verify.case import AT_LEAST, RELATIVE, Case, Curve, Measure, convergence_order

# Cardiff et al. 2016; the set-up of solids4foam's tutorial cylinderExpansion.  [m], [Pa]
INNER, OUTER = 10e-3, 20e-3
SHEAR, BULK, YIELD = 3.8e9, 40e9, 0.5e6
DENSITY = 1000.0  # [kg/m^3]: the answer has none
# Of the hole, 0.002 of the waves in a material a hundred times as soft, and four times that in the
# set-up's own, whose steps are ten times shorter.  [m/s]
SLOW, BRISK = 1.34, 5.37
SOFTER = 100.0
STEP = 0.5e-3  # [m] that the hole widens a frame
END = 40.5e-3  # [m]
START = (10.5e-3, 13e-3)  # [m] between which the stress is fitted to be read at INNER


def exact(a: Floats | float) -> Floats:
    """-sigma_rr [Pa] on a hole of radius a [m]."""
    a2 = np.asarray(a, float) ** 2
    return YIELD / np.sqrt(3.0) * np.log((OUTER**2 + a2 - INNER**2) / a2)


def inertia(a: Floats | float, speed: float) -> Floats:
    """What is added to `exact` [Pa] if the hole widens at a constant speed [m/s].

    r r' = a a' at every point, and so the integral of rho r'' over the wall is

        rho a'^2 (ln(b / a) - (1 - a^2 / b^2) / 2),     b^2 = B^2 + a^2 - A^2
    """
    a2 = np.asarray(a, float) ** 2
    b2 = OUTER**2 + a2 - INNER**2
    return DENSITY * speed**2 * 0.5 * (np.log(b2 / a2) - 1.0 + a2 / b2)


def place(X: Floats, a: float) -> Floats:
    """Where points X (n, 3) are when the hole is `a` wide [m]; also of points in the hole."""
    R = np.maximum(np.hypot(X[:, 0], X[:, 1]), 1e-3 * INNER)[:, None]
    out = X.copy()
    out[:, :2] *= np.sqrt(R**2 + a**2 - INNER**2) / R
    return out


def spline(X: Floats, a: float, h: float) -> Floats:
    """Nodal values at X whose quadratic spline is `place` to the third order in h.

    A spline of nodal values f is f + h^2 / 8 laplace f.
    """
    around = [place(X + way, a) + place(X - way, a) for way in 0.5 * h * np.eye(3)[:2]]
    return place(X, a) - (sum(around) - 4.0 * place(X, a)) / 2.0


def ring(cells: int) -> tuple[Particles, float]:
    """A quarter of the cylinder, one cell thick, and its thickness [m]; `cells` cells a radius."""
    h = INNER / cells

    def inside(x: Floats, y: Floats) -> Any:
        return (np.hypot(x, y) > INNER) & (np.hypot(x, y) < OUTER)

    flat, area = sample_strata(inside, [round(OUTER / h)] * 2, h)
    return plane_strain_slice(flat, area / area.sum() * 0.25 * np.pi * (OUTER**2 - INNER**2), h), h


def widening(h: float, hole: Floats) -> Pin:
    """All that is within the hole, as it moves when that has the radii `hole` (frames,) [m]."""
    count = round(INNER / h)
    ijk = np.stack(
        np.meshgrid(*[np.arange(-3, count + 2)] * 2, np.arange(-2, 4), indexing="ij"), -1
    )
    X = h * (ijk.reshape(-1, 3) + 0.5)
    R = np.hypot(X[:, 0], X[:, 1])
    X = X[(R < INNER) & (4.0 * h > INNER - R)]
    return Pin(
        name="hole",
        inside=lambda at: np.hypot(at[:, 0], at[:, 1]) < INNER,
        # Far away: the nodes have values of their own, instead of mirroring what is outside.
        nearest=lambda at: at + OUTER / h * OUTER,
        anchors=X,
        path=np.stack([spline(X, a, h) for a in hole]),
    )


def blown_up(
    cells: int, softer: float, speed: float, end: float, device: str
) -> tuple[Floats, Floats]:
    """Radii of the hole [m] and -sigma_rr [Pa] there without inertia, in the middle of each frame.

    softer : what the moduli are divided by; the answer does not depend on them.
    speed : [m/s] of the hole.
    """
    body, h = ring(cells)
    mu, kappa = SHEAR / softer, BULK / softer
    lam = kappa - 2.0 / 3.0 * mu
    E, nu = young_poisson(mu, lam)
    material = Material(
        name="soft", law="vonMises", density=DENSITY, youngs_modulus=E, poissons_ratio=nu,
        parameters={"yield_stress": YIELD},
    )  # fmt: skip
    hole = np.arange(INNER, end + 0.5 * STEP, STEP)
    solver = TotalLagrangian(
        body, [material], settings(device, frames=len(hole), fps=speed / STEP),
        pins=[widening(h, hole), mirror_plane(0, 0.0), mirror_plane(1, 0.0), *plane_strain(h)],
        real=np.float64,
    )  # fmt: skip
    work = np.array([frame.health.work for frame in solver.frames()][1:])
    taken = 0.25 * np.pi * np.diff(hole**2) * h
    middle = 0.5 * (hole[1:] + hole[:-1])
    return middle, work / taken - inertia(middle, speed)


def read(hole: Floats, stress: Floats, a: float) -> float:
    """-sigma_rr [Pa] when the hole is `a` wide: between frames; as it sets in, along `exact`."""
    if a > INNER:
        return float(np.interp(a, hole, stress))
    first = (hole > START[0]) & (hole < START[1])
    return float(np.polyval(np.polyfit(exact(hole[first]), stress[first], 1), exact(a)))


def expansion(
    cells: Sequence[int], radii: Sequence[float], bound: float, *, own: bool = False
) -> Callable[[str], Iterator[Measure]]:
    """Stress on the hole at radii [m], and where there are several resolutions its order.

    own : with the moduli of the set-up, and not softer ones.
    """
    softer, speed, kind = (1.0, BRISK, "own-moduli.") if own else (SOFTER, SLOW, "")

    def run(device: str) -> Iterator[Measure]:
        results = [blown_up(n, softer, speed, max(radii) + STEP, device) for n in cells]
        why = (
            f"{cells[-1]} cells in the wall, moduli divided by {softer:g}: errors of volume, of the"
            " third order in h, have a pressure of the bulk modulus, which is many yield stresses"
        )
        last = np.array([read(*one, max(radii)) for one in results])
        for a in radii:
            yield Measure(
                name=f"{kind}stress-at-{a * 1e3:.0f}mm", value=-read(*results[-1], a),
                target=-float(exact(a)), bound=bound, kind=RELATIVE, unit="Pa", why=why,
                curve=Curve(
                    title=f"thick cylinder{kind and ', unscaled moduli'}: pressure on the bore",
                    x_label="cell size h / wall thickness", y_label="pressure [Pa]",
                    x=tuple(1.0 / np.array(cells)), y=tuple(-last), logarithmic=False,
                    target=-float(exact(max(radii))),
                ) if a == max(radii) else None,
            )  # fmt: skip
        if len(cells) > 2:
            error = last / exact(max(radii)) - 1.0
            yield Measure(
                name=f"{kind}order", value=convergence_order(1.0 / np.array(cells), error),
                target=2.0,
                bound=0.0, kind=AT_LEAST, why="the order of quadratic splines, or more",
            )  # fmt: skip

    return run


def full(device: str) -> Iterator[Measure]:
    """Softer moduli and the own ones, which need twice as many cells."""
    yield from expansion((4, 6, 10), (10e-3, 20e-3, 40e-3), 0.015)(device)
    yield from expansion((10, 14, 20), (10e-3, 20e-3, 40e-3), 0.015, own=True)(device)


CASES = (
    Case(
        name="expansion",
        what=(
            "A thick cylinder of perfectly plastic material, 10 mm inside and 20 outside, is"
            " expanded until its hole is 40 mm wide, in plane strain: the pressure on"
            " the bore."
            "  Flow of this extent must neither lock nor lose volume."
        ),
        source="closed form of a rigid, perfectly plastic cylinder (Hill 1950); set-up of Cardiff"
        " et al. 2016",
        quick=expansion((5,), (10e-3, 20e-3), 0.02),
        full=full,
        f64=True,
    ),
)

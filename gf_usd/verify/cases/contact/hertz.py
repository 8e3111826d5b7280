"""Hertz's impact: contact time and restitution of an elastic ball on a rigid floor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.physics.contact.floor import plane_modulus
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import ball, elastic, iterate_states, settings
from gf_usd.verify.case import AT_LEAST, RELATIVE, Case, Curve, Measure

YOUNG, DENSITY = 1e6, 1000.0  # [Pa], [kg/m^3]; the radius is 1 m
FRAMES = 100  # in Hertz's time
FEW = 50  # of the quick form
# Of the floor: an axis of the grid, its diagonal and neither.  A contact of 0.1 R holds some six
# samples at 8,000 particles, so that its time depends on where they lie.
NORMALS = ((0.0, 1.0, 0.0), (1.0, 1.0, 1.0), (1.0, 2.0, 3.0))
FINE = 5  # subdivisions of the sphere: its facets lie 0.0004 R under it


@cache
def ball_of(particles: int) -> tuple[Particles, SurfaceSamples]:
    """A ball of about so many particles, the same for all impacts."""
    return ball(particles, subdivisions=FINE)


@dataclass(frozen=True, kw_only=True)
class Impact:
    """A ball that comes at the floor, and goes."""

    time: float  # in contact, over Hertz's
    restitution: float


def impact(
    particles: int, approach: float, nu: float, up: Floats, device: str, frames: int
) -> Impact:
    """A ball that falls along -up (3,) so fast that Hertz's greatest approach [R] is this.

    m v^2 / 2 = 8/15 E* sqrt(R) delta^(5/2);   t = 2.87 (m^2 / (R E*^2 v))^(1/5)

    Contact begins when the lowest sample, which falls freely, comes to the floor.  It ends where
    the root of the energy in the springs comes to zero: the last of them yields linearly in time.
    """
    modulus = float(plane_modulus(np.array(YOUNG), np.array(nu)))
    m = 4.0 / 3.0 * np.pi * DENSITY
    v = float(np.sqrt(16.0 / 15.0 * modulus * approach**2.5 / m))
    time = float(2.87 * (m**2 / (modulus**2 * v)) ** 0.2)
    body, samples = ball_of(particles)
    height = 1.0 + 0.02 * v * time
    s = settings(
        device, frames=2 * frames, fps=frames / time, floor=0.0,
        floor_normal=tuple(up), lift=tuple(height * up),
    )  # fmt: skip
    material = elastic(E=YOUNG, nu=nu, density=DENSITY, restitution=1.0, friction=0.0)
    solver = TotalLagrangian(body, [material], s, samples=samples, velocity=tuple(-v * up))
    begins = float((height + (samples.X @ up).min()) / v)
    touched: list[tuple[float, float]] = []
    speed = -v
    mass = solver.body.stencil.mass
    for now, state in iterate_states(solver):
        speed = float(mass @ (state.v @ up)) / mass.sum()
        if state.contact > 0.0:
            touched.append((now, float(np.sqrt(state.contact))))
        elif speed > 0.0 and touched and now > touched[-1][0] + 0.05 * time:
            break
    (before, stronger), (last, weaker) = touched[-2:]
    ends = last + min(1.0, weaker / (stronger - weaker)) * (last - before)
    return Impact(time=(ends - begins) / time, restitution=speed / v)


def mean_impact(particles: int, approach: float, nu: float, device: str, frames: int) -> Impact:
    """The mean over the directions of NORMALS."""
    ways = [np.array(up) / np.linalg.norm(up) for up in NORMALS]
    results = [impact(particles, approach, nu, up, device, frames) for up in ways]
    return Impact(
        time=float(np.mean([one.time for one in results])),
        restitution=float(np.mean([one.restitution for one in results])),
    )


def durations(
    counts: Sequence[int], given: Sequence[tuple[float, float, float]], frames: int
) -> Callable[[str], Iterator[Measure]]:
    """Impacts at given (approach, nu, bound) of the finest count; the others for the curve."""

    def run(device: str) -> Iterator[Measure]:
        ratios: dict[tuple[float, float], float] = {}
        for approach, nu, bound in given:
            results = [mean_impact(n, approach, nu, device, frames) for n in counts]
            curve = Curve(
                title=f"contact time, largest approach {approach:g} R, Poisson's ratio {nu:g}",
                x_label="particles", y_label="contact time / Hertz's", x=tuple(map(float, counts)),
                y=tuple(one.time for one in results), logarithmic=False, target=1.0,
            )  # fmt: skip
            yield Measure(
                name=f"time.{approach:g}R.nu{nu:g}", value=results[-1].time, target=1.0,
                bound=bound,
                kind=RELATIVE, curve=curve if len(counts) > 1 else None,
                why=(
                    "closed form for small strain, which neglects terms of the order approach / R;"
                    f" the contact radius is {np.sqrt(approach) / cell(counts[-1]):.2g} cells of"
                    " the grid, whose missing compliance the springs supply; of a frame,"
                    f" {100.0 / frames:g} %, the end of the contact is known to a quarter"
                ),
            )  # fmt: skip
            ratios[nu, approach] = results[-1].time
            yield Measure(
                name=f"restitution.{approach:g}R.nu{nu:g}", value=results[-1].restitution,
                target=1.0,
                bound=0.01, kind=AT_LEAST,
                why=(
                    "there is no damping: the missing energy is vibration of the ball, 1e-3 of the"
                    " energy at a speed of 0.01 c in theory (Hunter 1957), so up to 1 % of the"
                    " speed"
                ),
            )  # fmt: skip

        for nu in dict.fromkeys(nu for nu, _ in ratios) if len(counts) > 1 else ():
            (low, short), (high, long) = sorted((a, t) for (n, a), t in ratios.items() if n == nu)
            yield Measure(
                name=f"time.limit.nu{nu:g}", value=short + (short - long) * low / (high - low),
                target=1.0, bound=0.01, kind=RELATIVE,
                why=(
                    f"the times at {low:g} and {high:g} R, extrapolated linearly to zero approach,"
                    " because the theory neglects terms of the order approach / R"
                ),
            )  # fmt: skip

    return run


def cell(particles: int) -> float:
    """[R] edge of a cell of a ball of so many particles."""
    return float(2.0 * np.cbrt(4.0 / 3.0 * np.pi / particles))


CASES = (
    Case(
        name="hertz",
        what=(
            "An elastic ball hits a rigid floor so fast that by Hertz's theory it is indented by"
            " 0.05 and 0.01 of its radius, without damping.  The contact time relative to the"
            " closed form, with 8,000 particles, and the speed after the bounce: means of three"
            " directions."
        ),
        source="Hertz 1882; Johnson 1985, section 11.4: 2.87 (m^2 / (R E*^2 v))^(1/5)",
        quick=durations((8000,), ((0.05, 0.3, 0.02), (0.01, 0.3, 0.05)), FEW),
        full=durations(
            (2000, 8000, 32000),
            ((0.05, 0.3, 0.05), (0.01, 0.3, 0.05), (0.05, 0.45, 0.05), (0.01, 0.45, 0.05)),
            FRAMES,
        ),
    ),
)

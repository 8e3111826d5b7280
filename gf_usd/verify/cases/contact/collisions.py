"""Collisions of elastic balls: conservation of momentum, angular momentum and energy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.frame import Health
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.stage import ContactSetup, Skin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import ball, elastic, settings, sphere
from gf_usd.verify.case import AT_LEAST, Case, Curve, Measure

YOUNG, POISSON, DENSITY = 1e6, 0.3, 1000.0  # waves run at 37 m/s
FINE = 4  # subdivisions of the spheres
ROUNDING = 1e-5
LEAST_COARSE, LEAST_FINE = 0.97, 0.99  # restitution of balls of few, and of so many particles
FINE_BALL = 3000


@dataclass(frozen=True, kw_only=True)
class Crash:
    """A row of equal balls of 1 m, the first at a speed v along x."""

    speed: float  # [m/s]
    health: tuple[Health, ...]  # of every frame
    velocity: Floats  # (B,) [m/s] of each ball along x at the end
    mass: Floats  # (B,) [kg]

    @property
    def momentum_change(self) -> float:
        """Largest change of any component, over m v of the first ball."""
        p = np.array([h.momentum for h in self.health])
        return float(np.abs(p - p[0]).max() / (self.mass[0] * self.speed))

    @property
    def angular_change(self) -> float:
        """Of angular momentum about the origin, over m v r."""
        L = np.array([h.angular_momentum for h in self.health])
        return float(np.abs(L - L[0]).max() / (self.mass[0] * self.speed))

    @property
    def scale(self) -> float:
        """[J] kinetic energy at the start."""
        return self.health[0].kinetic

    @property
    def put_in(self) -> float:
        """Energy that new planes gave, all gains and losses, over that at the start."""
        return float(sum(abs(h.injected) for h in self.health) / self.scale)

    @property
    def restitution(self) -> float:
        """Of the relative speed of the first and the last ball."""
        return float((self.velocity[-1] - self.velocity[0]) / self.speed)

    @property
    def total(self) -> float:
        """Energy at the end over that at the start."""
        last = self.health[-1]
        return (last.kinetic + last.elastic + last.contact) / self.scale

    @property
    def centers(self) -> float:
        """Of it, that of the motion of the centers; with equal balls (1 + e^2) / 2."""
        return 0.5 * float(self.mass @ self.velocity**2) / self.scale

    @property
    def ringing(self) -> float:
        """Of it, the rest: vibrations in the balls."""
        return self.total - self.centers


def crash(
    particles: int, balls: int, device: str, *, speed: float = 1.0, aside: float = 0.0,
    friction: float = 0.0,
) -> Crash:  # fmt: skip
    """The balls are copies of one, whole cells of the grid apart; the last is `aside` [m] of x."""
    body, samples = ball(particles, subdivisions=FINE)
    h = 2.0 * body.lattice
    apart = h * np.ceil(2.0 / h + 0.5)
    shift = np.zeros((balls, 3))
    shift[:, 0] = apart * (np.arange(balls) - 0.5 * (balls - 1))
    shift[-1, 1] = aside
    of = np.repeat(np.arange(balls), len(body))
    many = replace(
        body, volume=balls * body.volume, body=of,
        X=copies(body.X, shift),
        **{name: np.concatenate([getattr(body, name)] * balls) for name in (
            "V0", "material", "orientation", "scale", "color", "opacity", "surface"
        )},
    )  # fmt: skip
    assert samples.normal is not None
    on = SurfaceSamples(
        X=copies(samples.X, shift), area=np.tile(samples.area, balls),
        normal=np.tile(samples.normal, (balls, 1)),
        body=np.repeat(np.arange(balls), len(samples.X)),
    )  # fmt: skip
    skin = sphere(1.0, FINE)
    setup = ContactSetup(
        skins=tuple(Skin(points=skin.points + at, triangles=skin.triangles) for at in shift)
    )
    material = elastic(E=YOUNG, nu=POISSON, density=DENSITY, restitution=1.0, friction=friction)
    # The gaps, and some contact times (a tenth of a second each).
    seconds = (balls - 1) * ((apart - 2.0) / speed + 0.6)
    frames = 24 * (balls - 1)
    s = settings(device, frames=frames, fps=frames / seconds)
    start = [(speed, 0.0, 0.0)] + [(0.0, 0.0, 0.0)] * (balls - 1)
    solver = TotalLagrangian(many, [material], s, samples=on, velocity=start, contact_setup=setup)
    results = list(solver.frames())
    m = solver.body.m
    mass = np.bincount(of, m)
    along = np.bincount(of, m * results[-1].particles.v[:, 0]) / mass
    return Crash(
        speed=speed, health=tuple(f.health for f in results), velocity=along, mass=mass
    )  # fmt: skip


def copies(X: Floats, shift: Floats) -> Floats:
    """X (n, 3) at each shift (B, 3), one after the other."""
    return np.concatenate([X + at for at in shift])


def kept(name: str, results: Crash) -> Iterator[Measure]:
    """What no collision changes."""
    for what, value in (
        ("momentum", results.momentum_change), ("angular-momentum", results.angular_change)
    ):  # fmt: skip
        yield Measure(
            name=f"{what}.{name}", value=value, target=0.0, bound=ROUNDING,
            why=(
                "the forces and moments of a pair sum to zero: rounding of float32 over some"
                " hundred substeps, 6e-8 each"
            ),
        )  # fmt: skip
    yield Measure(
        name=f"planes.{name}", value=results.put_in, target=0.0, bound=1e-3,
        why="new contact planes store the energy of the old ones; a thousandth is allowed",
    )  # fmt: skip


def collisions(counts: Sequence[int]) -> Callable[[str], Iterator[Measure]]:
    """Two balls aside and in line, and a cradle of three; those in line at all counts."""

    def run(device: str) -> Iterator[Measure]:
        yield from kept("aside", crash(counts[0], 2, device, aside=0.5, friction=0.5))
        results = [crash(count, 2, device) for count in counts]
        yield from kept("head-on", results[-1])
        x = tuple(map(float, counts))
        yield Measure(
            name="energy.head-on", value=results[-1].total, target=1.0, bound=5e-3,
            why=(
                "there is no damping: the energy of position Verlet oscillates by up to (w dt)^2 /"
                " 4 of that of the stiffest vibrations, which is a hundredth of the vibrational"
                " energy"
            ),
        )  # fmt: skip
        for count, one in zip(counts, results):
            tolerance = LEAST_FINE if count >= FINE_BALL else LEAST_COARSE
            last = one is results[-1]
            yield Measure(
                name=f"restitution.head-on.{count}", value=one.restitution, target=1.0,
                bound=1.0 - tolerance, kind=AT_LEAST,
                why=(
                    "slow balls separate at their approach speed, except for the energy of"
                    f" vibrations: {tolerance} is required"
                ),
                curve=Curve(
                    title="head-on collision of two balls: loss of relative speed",
                    x_label="particles per ball", y_label="1 - restitution e",
                    x=x, y=tuple(1.0 - each.restitution for each in results),
                ) if last else None,
            )  # fmt: skip
            yield Measure(
                name=f"ringing.head-on.{count}", value=one.ringing / (1.0 - one.centers),
                target=1.0, bound=0.25, unit="of what the centers lost",
                why=(
                    f"of the energy {one.centers:.5f} is motion of the centers, {one.ringing:.5f}"
                    f" is vibration of the balls and {1.0 - one.total:.5f} is lost: there is no"
                    " damping, and the energy of Verlet oscillates by at most (w dt)^2 / 4 of the"
                    " vibrational energy, w dt up to 1"
                ),
                curve=Curve(
                    title="head-on collision of two balls: energy left in vibrations",
                    x_label="particles per ball",
                    y_label="vibrational energy / initial energy", x=x,
                    y=tuple(each.ringing for each in results),
                ) if last else None,
            )  # fmt: skip
        yield from kept("cradle", crash(counts[0], 3, device))

    return run


CASES = (
    Case(
        name="collisions",
        what=(
            "Equal elastic balls collide without damping: two head-on, two off-center with"
            " friction, three in a row.  Momentum, angular momentum, the energy added by contact,"
            " the restitution, and the energy of vibrations afterward."
        ),
        source="conservation laws; Hertz: slow elastic balls separate at their approach speed",
        quick=collisions((600, 1500)),
        full=collisions((600, 1500, 3000)),
    ),
)

"""Taylor's bar: impact of a copper rod on a rigid wall.

The wall and the rod's two planes of symmetry are pins that hold one axis and slide along the
others.  The mass is the consistent one of bakes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.frame import Frame
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Pin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import GAUSS, mirror_plane, particles_at, sample_strata, settings
from gf_usd.verify.case import AT_LEAST, RELATIVE, Case, Curve, Measure

# Kamoulakos 1990; Zhu and Cescotto 1995.  [m], [m/s], [Pa], [kg/m^3]
RADIUS, LENGTH, SPEED = 3.2e-3, 32.4e-3, 227.0
COPPER = Material(
    name="copper", law="vonMises", density=8930.0, youngs_modulus=117e9, poissons_ratio=0.35,
    parameters={"yield_stress": 400e6, "hardening": 100e6},
)  # fmt: skip
HARD = replace(COPPER, parameters={**COPPER.parameters, "yield_stress": 4e9})
END, PARTS = 80e-6, 40  # [s], frames
FINAL = (7.2259e-3, 21.42e-3)
HISTORY = {20e-6: (6.205e-3, 28.065e-3), 40e-6: (7.147e-3, 24.562e-3), 60e-6: (7.234e-3, 22.213e-3)}
CONTROL = 40e-6  # [s] when the hard bar is measured


@dataclass(frozen=True, kw_only=True)
class Impact:
    """What became of a bar."""

    shape: dict[float, tuple[float, float]]  # by time [s] radius of the foot and length [m]
    energy: Floats  # (frames,) [J] kinetic, elastic and dissipated up to each frame
    work: float  # [J] of the wall
    momentum: float  # [kg m/s] along the bar at the end
    least: float  # smallest principal stretch
    substeps: int  # of all frames

    def at(self, time: float) -> tuple[float, float]:
        """Radius of the foot and length [m] at a frame's time [s]."""
        return self.shape[round(time, 9)]


def quarter_rod(cells: int) -> Particles:
    """A quarter of a rod along y, x and z above 0, `cells` cells a radius.

    Strata that its mantle cuts have the volume and the middle of what is inside.
    """
    h = RADIUS / cells
    along = round(LENGTH / h)
    flat, area = sample_strata(lambda x, z: x * x + z * z < RADIUS**2, (cells, cells), h)
    area *= 0.25 * np.pi * RADIUS**2 / area.sum()
    step = LENGTH / along
    y = ((np.arange(along)[:, None] + GAUSS) * step).ravel()
    X = np.stack(
        [np.tile(flat[:, 0], len(y)), np.repeat(y, len(flat)), np.tile(flat[:, 1], len(y))], 1
    )
    V0 = np.tile(area, len(y)) * 0.5 * step
    body = particles_at(X, volume=float(V0.sum()), lattice=0.5 * h, corner=np.zeros(3))
    return replace(body, V0=V0)


def wall(speed: float, frames: int) -> Pin:
    """The plane y = 0 that moves up at a speed [m/s]."""
    still = mirror_plane(1, 0.0)
    rise = speed * END / PARTS * np.arange(frames)
    return replace(still, path=still.anchors + np.outer(rise, [0.0, 1.0, 0.0])[:, None])


def taylor(
    cells: int,
    device: str,
    made: Material,
    end: float = END,
    *,
    moving: bool = False,
    real: type = np.float32,
) -> Impact:
    """A bar that is thrown against a wall or, if `moving`, at rest when the wall hits it."""
    frames = round(PARTS * end / END) + 1
    angle = np.linspace(0.0, 0.5 * np.pi, 17)
    rim = RADIUS * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], 1)
    ends = np.array([[0.0, 0.0, 0.0], [0.0, LENGTH, 0.0]])
    thrown = 0.0 if moving else -SPEED
    solver = TotalLagrangian(
        quarter_rod(cells), [made], settings(device, frames=frames, fps=PARTS / END),
        pins=[mirror_plane(0, 0.0), wall(thrown + SPEED, frames), mirror_plane(2, 0.0)],
        embedded={"rim": rim, "ends": ends}, real=real,
        velocity=lambda X: np.tile([0.0, thrown, 0.0], (len(X), 1)),
    )  # fmt: skip
    shape, energy, lost, work, substeps = {}, [], 0.0, 0.0, 0
    frame: Frame | None = None
    for frame in solver.frames():
        radius = np.linalg.norm(frame.embedded["rim"].x[:, [0, 2]], axis=1).mean()
        length = float(np.ptp(frame.embedded["ends"].x[:, 1]))
        shape[round(frame.time, 9)] = float(radius), length
        lost += frame.health.plastic_dissipation or 0.0
        work += frame.health.work
        substeps += frame.health.substeps
        energy.append(frame.health.kinetic + frame.health.elastic + lost)
    assert frame is not None
    return Impact(
        shape=shape, energy=np.array(energy), work=work, momentum=frame.health.momentum[1],
        least=frame.health.min_stretch, substeps=substeps,
    )  # fmt: skip


def impact(*cells: int, bounds: tuple[float, float, float]) -> Callable[[str], Iterator[Measure]]:
    """The bar at several resolutions; bounds : of radius, length and history at the finest."""

    def run(device: str) -> Iterator[Measure]:
        results = [taylor(n, device, COPPER) for n in cells]
        coarsest, finest = results[0], results[-1]
        h = 1.0 / np.array(cells)
        radii = np.array([one.at(END)[0] for one in results])
        why = (
            f"{cells[-1]} cells a radius; the foot is pressed to {finest.least:.2f} of its height"
            " within the first, whose corner reduces the order to one"
        )
        yield Measure(
            name="radius", value=finest.at(END)[0], target=FINAL[0], bound=bounds[0],
            kind=RELATIVE, unit="m", why=why,
            curve=Curve(
                title="Taylor's bar: final radius of the foot", x_label="cell size h / radius R",
                y_label="radius of the foot [m]",
                x=tuple(h), y=tuple(radii), logarithmic=False, target=FINAL[0],
            ),
        )  # fmt: skip
        yield Measure(
            name="length", value=finest.at(END)[1], target=FINAL[1], bound=bounds[1],
            kind=RELATIVE, unit="m", why=why,
        )  # fmt: skip
        for time, (foot, long) in HISTORY.items():
            for name, value, target in zip(("radius", "length"), finest.at(time), (foot, long)):
                yield Measure(
                    name=f"{name}-at-{time * 1e6:.0f}us", value=value, target=target,
                    bound=bounds[2], kind=RELATIVE, unit="m", why=why,
                )  # fmt: skip
        if len(cells) > 2:
            # r = r0 - c h through the two finest
            r0 = radii[-1] + (radii[-1] - radii[-2]) * h[-1] / (h[-2] - h[-1])
            yield Measure(
                name="radius-converged", value=float(r0), target=FINAL[0], bound=0.005,
                kind=RELATIVE, unit="m",
                why="the limit of the first order in h through the two finest resolutions",
            )  # fmt: skip
        start = finest.energy[0]
        yield Measure(
            name="energy", value=float(np.abs(finest.energy / start - 1.0).max()), target=0.0,
            bound=1e-3,
            why="motion, strain and what flow dissipated: the work of flow is a sum over substeps,"
            " each of which strains the foot by up to a hundredth",
        )  # fmt: skip
        yield from moved(min(cells), coarsest, device)
        away = taylor(min(cells), device, HARD, CONTROL).at(CONTROL)[0]
        yield Measure(
            name="negative-control", value=abs(away / HISTORY[CONTROL][0] - 1.0), target=0.2,
            bound=0.0, kind=AT_LEAST,
            why="a negative control: with ten times the yield stress the foot stays narrow",
        )  # fmt: skip

    return run


def moved(cells: int, still: Impact, device: str) -> Iterator[Measure]:
    """The same impact in a frame of reference that moves with the bar: the wall does the work."""
    results = taylor(cells, device, COPPER, moving=True)
    yield Measure(
        name="work", value=results.work, target=float(results.energy[-1]), bound=1e-3,
        kind=RELATIVE,
        unit="J", why=(
            "the work of the wall is the only source of energy; bound as for energy above"
        ),
    )  # fmt: skip
    yield Measure(
        name="impulse", value=results.work / SPEED, target=results.momentum,
        bound=0.5 * RADIUS / cells / LENGTH, kind=RELATIVE, unit="N s",
        why="the wall's force, at a constant speed its work over that, makes the bar's momentum;"
        " half of the first cell moves with the wall from the beginning",
    )  # fmt: skip


def observers(cells: int) -> Callable[[str], Iterator[Measure]]:
    """The shapes in two frames of reference, one moving with the bar, in double precision."""

    def run(device: str) -> Iterator[Measure]:
        still = taylor(cells, device, COPPER, real=np.float64)
        moving = taylor(cells, device, COPPER, moving=True, real=np.float64)
        far = SPEED * END / RADIUS
        off = [
            np.abs(np.array(moving.at(time)) / np.array(shape) - 1.0).max()
            for time, shape in still.shape.items()
        ]
        yield Measure(
            name="moving-wall", value=float(max(off)), target=0.0,
            bound=2.0**-53 * far * still.substeps,
            why=f"which of the two moves affects only rounding: each of {still.substeps} substeps"
            f" rounds positions of up to {far:.1f} radii by 2^-53, at most all in one direction",
        )  # fmt: skip

    return run


CASES = (
    Case(
        name="taylor",
        what=(
            "A copper bar hits a rigid wall at 227 m/s, with the mass matrix of bakes: radius of"
            " its foot and its length, at the end and on the way; energy, and work and impulse of"
            " the wall if the wall moves and the bar is at rest."
        ),
        source="Kamoulakos 1990; Zhu and Cescotto 1995 (finite elements, 7.2259 and 21.42 mm)",
        quick=impact(3, bounds=(0.04, 0.005, 0.055)),
        full=impact(4, 6, 10, bounds=(0.01, 0.005, 0.015)),
    ),
    Case(
        name="taylor-f64",
        what=(
            "The bar of the case taylor in double precision, once moving toward a fixed wall and"
            " once at rest, hit by the wall: radius and length must be the same at all times."
        ),
        source="symmetry: Galilean invariance",
        quick=observers(2),
        full=observers(4),
        f64=True,
    ),
)

"""genesis-world's MPM on its CPU backend, with its own sampling of the ball and its own floor.

Option: squeeze [m/s^2], from two points above and below it, without gravity, floor and speed.
"""

import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import genesis as gs
import numpy as np

from tools.bench import play, scene

SIDE = 1.4  # [m] that the ball may spread to, without the padding that genesis keeps free


@cache
def built(n: int, dt: float, squeeze: float):
    """A scene, its ball, and the substeps of one of its steps: compiled once a process."""
    gs.init(backend=gs.cpu, precision="32", logging_level="error")
    substeps = play.chunk(dt)
    lattice = scene.cell(n) / 2.0
    lowest = scene.RADIUS + scene.GAP
    side = SIDE + 5.0 * scene.cell(n)
    world = gs.Scene(
        sim_options=gs.options.SimOptions(
            dt=substeps * dt,
            substeps=substeps,
            gravity=(0.0, 0.0, 0.0 if squeeze else -scene.GRAVITY),
        ),
        mpm_options=gs.options.MPMOptions(
            lower_bound=(-side, -side, -10.0 * lattice),
            upper_bound=(side, side, 2.0 + side),
            grid_density=1.0 / scene.cell(n),
            particle_size=lattice,
        ),
        show_viewer=False,
    )
    if squeeze:
        for side in (-scene.FIELD_AT, scene.FIELD_AT):
            place = (0.0, 0.0, lowest + side)
            field = gs.force_fields.Point(strength=squeeze, position=place, flow=0.0)
            field.activate()
            world.add_force_field(force_field=field)
    else:
        world.add_entity(morph=gs.morphs.Plane())
    ball = world.add_entity(
        material=gs.materials.MPM.Elastic(
            E=scene.YOUNG, nu=scene.POISSON, rho=scene.DENSITY, model="corotation"
        ),
        morph=gs.morphs.Sphere(pos=(0.0, 0.0, lowest), radius=scene.RADIUS),
    )
    world.build()
    return world, ball, substeps


class Genesis:
    """z is up in genesis; heights are handed over in column 1."""

    def __init__(self, n: int, dt: float, threads: int, squeeze: float = 0.0) -> None:
        self.world, self.ball, self.substeps = built(n, dt, squeeze)
        self.world.reset()
        if not squeeze:
            self.ball.set_velocity(np.array((0.0, 0.0, -scene.SPEED)))

    def advance(self, count: int) -> None:
        for _ in range(-(-count // self.substeps)):
            self.world.step(update_visualizer=False)
        self.ball.get_particles_pos()  # waits

    def positions(self) -> np.ndarray:
        x = self.ball.get_particles_pos()
        return np.asarray(x.cpu(), float).reshape(-1, 3)[:, (0, 2, 1)]


if __name__ == "__main__":
    play.main(Genesis, {"genesis-world": version("genesis-world")})

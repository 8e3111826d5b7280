"""gf-usd itself on the drop of `tools/bench/scene.py`; options: solver (tl | ul) and law."""

import importlib
import sys
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import numpy as np

from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.physics.solvers import make_solver
from tools.bench import play, scene


class GfUsd:
    """Elastic: no damping of the material, no filter, a floor that gives everything back."""

    def __init__(
        self, n: int, dt: float, threads: int, solver: str = "tl", law: str = "corotated"
    ) -> None:
        if law == "stableNeoHookean":
            importlib.import_module("stable_neo_hookean")
        ball = scene.ball(n)
        count, volume = len(ball.X), ball.volume * len(ball.X)
        spacing = float(np.cbrt(ball.volume))
        particles = Particles(
            X=ball.X, V0=np.full(count, ball.volume), material=np.zeros(count, int),
            orientation=np.tile((1.0, 0.0, 0.0, 0.0), (count, 1)),
            scale=np.full((count, 3), ball.lattice), color=np.full((count, 3), 0.5),
            opacity=np.ones(count), surface=np.zeros(count, int), spacing=spacing,
            volume=volume, lattice=ball.lattice, corner=ball.corner,
        )  # fmt: skip
        area = 4.0 * np.pi * scene.RADIUS**2
        points = int(np.ceil(area / spacing**2))
        samples = SurfaceSamples(X=scene.sphere_points(points), area=np.full(points, area / points))
        material = Material(
            name="drop", law=law, density=scene.DENSITY, youngs_modulus=scene.YOUNG,
            poissons_ratio=scene.POISSON, friction=0.0, restitution=1.0,
        )  # fmt: skip
        self.fps = 1.0 / dt
        settings = Settings(
            frames=1, fps=self.fps, time_codes_per_second=self.fps, start=0.0, substeps=1,
            gravity=(0.0, -scene.GRAVITY, 0.0), up=(0.0, 1.0, 0.0), floor=0.0, threads=threads,
            lift=(0.0, scene.RADIUS + scene.GAP, 0.0), solver=solver,
        )  # fmt: skip
        self.dt = dt
        self.settings = settings
        self.solver = make_solver(
            settings, particles, [material], samples=samples, velocity=(0.0, -scene.SPEED, 0.0)
        )
        self.frame = 0

    def advance(self, count: int) -> None:
        self.frame += 1
        object.__setattr__(self.settings, "fps", 1.0 / (count * self.dt))
        self.solver.advance(self.frame, count)

    def positions(self) -> np.ndarray:
        return self.solver.read(self.frame).particles.x


if __name__ == "__main__":
    play.main(GfUsd, {"gf-usd": version("gf-usd"), "taichi": version("taichi")})

"""newton's implicit MPM, which is made for granular media, on the elastic drop.

Its settings are those of newton's example of an elastic beam (example_mpm_beam_twist): conjugate
residuals, discontinuous linear strains, no plastic flow.  Its elasticity is Hencky's law, which the
others do not have: only its speed is compared, not its drop.
"""

import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverImplicitMPM

from tools.bench import play, scene


@cache
def built(n: int):
    """Model and solver: compiled once a process."""
    ball = scene.ball(n)
    count = len(ball.X)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -scene.GRAVITY))
    SolverImplicitMPM.register_custom_attributes(builder)
    start = ball.X[:, (0, 2, 1)] + (0.0, 0.0, scene.RADIUS + scene.GAP)
    builder.add_particles(
        pos=start.tolist(), vel=np.tile((0.0, 0.0, -scene.SPEED), (count, 1)).tolist(),
        mass=[scene.DENSITY * ball.volume] * count,
        radius=[0.5 * float(np.cbrt(ball.volume))] * count,
    )  # fmt: skip
    builder.add_ground_plane(cfg=newton.ModelBuilder.ShapeConfig(mu=0.0))
    model = builder.finalize(device="cpu")
    model.mpm.young_modulus.fill_(scene.YOUNG)
    model.mpm.poisson_ratio.fill_(scene.POISSON)
    model.mpm.tensile_yield_ratio.fill_(1.0)
    config = SolverImplicitMPM.Config(
        voxel_size=scene.cell(n), strain_basis="P1d", velocity_basis="Q1",
        warmstart_mode="particles", carry_residual_strain="unconverged", air_drag=0.0,
        tolerance=1e-6,
    )  # fmt: skip
    return model, SolverImplicitMPM(model, config=config)


class NewtonImplicitMPM:
    """z is up in newton; heights are handed over in column 1.  Its step is ten explicit ones."""

    STEP = 10.0

    def __init__(self, n: int, dt: float, threads: int) -> None:
        self.model, self.solver = built(n)
        self.now, self.next = self.model.state(), self.model.state()
        self.dt = dt

    def advance(self, count: int) -> None:
        for _ in range(count):
            self.solver.step(self.now, self.next, None, None, self.dt)
            self.now, self.next = self.next, self.now

    def positions(self) -> np.ndarray:
        return self.now.particle_q.numpy().astype(float)[:, (0, 2, 1)]


if __name__ == "__main__":
    wp.config.quiet = True
    play.main(NewtonImplicitMPM, {"newton": version("newton"), "warp-lang": version("warp-lang")})

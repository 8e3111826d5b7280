"""newton's Vertex Block Descent on tetrahedra: implicit steps, stable Neo-Hookean.

VBD has one law for solids, that of Smith, de Goes and Kim (2018) without its term for degenerate
tetrahedra, so that its drop is compared with a reference of that law.  `n` counts vertices.
"""

import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import newton
import numpy as np
import warp as wp
from scipy.spatial import Delaunay

from tools.bench import play, scene

THIN = 0.05  # tetrahedra of less quality are left out: slivers between lattice and surface
CONTACT = 0.4  # of (c / s)^2: the floor's stiffness per mass, as gf-usd has it


def tetrahedra(n: int) -> tuple[np.ndarray, np.ndarray]:
    """About n vertices (n, 3) of a ball, and its tetrahedra (m, 4).

    A body-centered lattice inside and points of the golden angle on the sphere, joined by Delaunay.
    """
    volume = 4.0 / 3.0 * np.pi * scene.RADIUS**3
    a = np.cbrt(2.0 * volume / n)
    k = int(np.ceil(scene.RADIUS / a)) + 1
    cube = a * np.stack(np.meshgrid(*[np.arange(-k, k + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    X = np.concatenate([cube, cube + 0.5 * a])
    near = 0.55 * a  # lattice points this near to the sphere would make slivers with it
    X = X[np.linalg.norm(X, axis=1) < scene.RADIUS - near]
    on = round(4.0 * np.pi * scene.RADIUS**2 / (0.75 * a) ** 2)
    X = np.concatenate([X, scene.sphere_points(on)])
    tets = Delaunay(X).simplices
    edges = X[tets[:, 1:]] - X[tets[:, :1]]
    six = np.linalg.det(edges)
    tets[six < 0.0] = tets[six < 0.0][:, (0, 2, 1, 3)]
    pairs = X[tets][:, :, None] - X[tets][:, None]
    mean = np.sqrt((pairs**2).sum((1, 2, 3)) / 12.0)
    good = np.abs(six) * np.sqrt(2.0) > THIN * mean**3  # 1 for a regular one
    return X, tets[good]


@cache
def built(n: int, iterations: int):
    """Model, solver and contacts: compiled once a process."""
    X, tets = tetrahedra(n)
    spacing = float(np.cbrt(4.0 / 3.0 * np.pi * scene.RADIUS**3 / len(X)))
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -scene.GRAVITY))
    builder.add_soft_mesh(
        pos=wp.vec3(0.0, 0.0, scene.RADIUS + scene.GAP), rot=wp.quat_identity(), scale=1.0,
        vel=wp.vec3(0.0, 0.0, -scene.SPEED), vertices=[wp.vec3(*x) for x in X.tolist()],
        indices=tets.ravel().tolist(), density=scene.DENSITY, k_mu=scene.MU, k_lambda=scene.LAM,
        k_damp=0.0, particle_radius=1e-4 * spacing, add_surface_mesh_edges=False,
    )  # fmt: skip
    builder.add_ground_plane()
    builder.color()
    model = builder.finalize(device="cpu")
    mass = scene.DENSITY * spacing**3  # of a surface sample: rho times its area times the spacing
    model.soft_contact_ke = mass * CONTACT * (scene.WAVE_SPEED / spacing) ** 2
    model.soft_contact_kd = 0.0
    model.soft_contact_mu = 0.0
    model.shape_material_ke.fill_(model.soft_contact_ke)
    model.shape_material_kd.fill_(0.0)
    model.shape_material_mu.fill_(0.0)
    solver = newton.solvers.SolverVBD(
        model=model, iterations=iterations, particle_enable_self_contact=False,
        particle_enable_tile_solve=False,
    )  # fmt: skip
    return model, solver, newton.CollisionPipeline(model)


class NewtonVBD:
    """z is up in newton; heights are handed over in column 1."""

    STEP = 1.0

    def __init__(self, n: int, dt: float, threads: int, iterations: int = 10) -> None:
        self.model, self.solver, self.pipeline = built(n, iterations)
        self.contacts = self.pipeline.contacts()
        self.now, self.next = self.model.state(), self.model.state()
        self.control = self.model.control()
        self.dt = dt

    def advance(self, count: int) -> None:
        for _ in range(count):
            self.now.clear_forces()
            self.pipeline.collide(self.now, self.contacts)
            self.solver.step(self.now, self.next, self.control, self.contacts, self.dt)
            self.now, self.next = self.next, self.now

    def positions(self) -> np.ndarray:
        return self.now.particle_q.numpy().astype(float)[:, (0, 2, 1)]


if __name__ == "__main__":
    wp.config.quiet = True
    play.main(NewtonVBD, {"newton": version("newton"), "warp-lang": version("warp-lang")})

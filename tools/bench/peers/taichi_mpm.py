"""Taichi's stock MLS-MPM in 3D, jelly only, as its examples write it (mpm99, mpm3d_ggui).

Three loops per substep: over particles, which scatter with atomics to a dense grid; over grid
nodes; over particles, which gather; F is updated by (I + dt C) F and split by `ti.svd`.  What
differs from the example: sizes, moduli, no branches for water and snow, a grid that is no larger
than the drop needs, and a start from given particles.
"""

import sys
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import numpy as np
import taichi as ti

from tools.bench import play, scene

BOUND = 3  # cells of wall, as in the example
WIDTH, HEIGHT = 3.0, 3.0  # [m] the drop stays inside


@cache
def kernels(n: int, dt: float, threads: int):
    ti.init(arch=ti.cpu, cpu_max_num_threads=threads, log_level=ti.ERROR)
    dx = scene.cell(n)
    grid = tuple(int(np.ceil(size / dx)) + 2 * BOUND for size in (WIDTH, HEIGHT, WIDTH))
    ball = scene.ball(n)
    p_vol = ball.volume
    p_mass = p_vol * scene.DENSITY
    mu, lam = scene.MU, scene.LAM
    x = ti.Vector.field(3, float, len(ball.X))
    v = ti.Vector.field(3, float, len(ball.X))
    C = ti.Matrix.field(3, 3, float, len(ball.X))
    F = ti.Matrix.field(3, 3, float, len(ball.X))
    grid_v = ti.Vector.field(3, float, grid)
    grid_m = ti.field(float, grid)

    @ti.kernel
    def substep():
        for node in ti.grouped(grid_m):
            grid_v[node] = ti.zero(grid_v[node])
            grid_m[node] = 0
        for p in x:
            Xp = x[p] / dx
            base = int(Xp - 0.5)
            fx = Xp - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            F[p] = (ti.Matrix.identity(float, 3) + dt * C[p]) @ F[p]
            U, sig, V = ti.svd(F[p])
            J = sig[0, 0] * sig[1, 1] * sig[2, 2]
            stress = 2 * mu * (F[p] - U @ V.transpose()) @ F[p].transpose()
            stress += ti.Matrix.identity(float, 3) * lam * J * (J - 1)
            stress = (-dt * p_vol * 4) * stress / dx**2
            affine = stress + p_mass * C[p]
            for offset in ti.static(ti.grouped(ti.ndrange(3, 3, 3))):
                dpos = (offset - fx) * dx
                weight = 1.0
                for i in ti.static(range(3)):
                    weight *= w[offset[i]][i]
                grid_v[base + offset] += weight * (p_mass * v[p] + affine @ dpos)
                grid_m[base + offset] += weight * p_mass
        for node in ti.grouped(grid_m):
            if grid_m[node] > 0:
                grid_v[node] /= grid_m[node]
            grid_v[node] += dt * ti.Vector([0.0, -scene.GRAVITY, 0.0])
            for d in ti.static(range(3)):
                if node[d] < BOUND and grid_v[node][d] < 0:
                    grid_v[node][d] = 0
                if node[d] > grid[d] - BOUND and grid_v[node][d] > 0:
                    grid_v[node][d] = 0
        for p in x:
            Xp = x[p] / dx
            base = int(Xp - 0.5)
            fx = Xp - base
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v = ti.zero(v[p])
            new_C = ti.zero(C[p])
            for offset in ti.static(ti.grouped(ti.ndrange(3, 3, 3))):
                dpos = (offset - fx) * dx
                weight = 1.0
                for i in ti.static(range(3)):
                    weight *= w[offset[i]][i]
                g_v = grid_v[base + offset]
                new_v += weight * g_v
                new_C += 4 * weight * g_v.outer_product(dpos) / dx**2
            v[p] = new_v
            x[p] += dt * v[p]
            C[p] = new_C

    return ball, dx, (x, v, C, F), substep


class TaichiMPM:
    """The floor is the plane of the first free row of nodes."""

    def __init__(self, n: int, dt: float, threads: int) -> None:
        ball, dx, (x, v, C, F), self.substep = kernels(n, dt, threads)
        # nodes below row BOUND do not move down: the lowest that may is row BOUND
        self.floor = (BOUND - 1) * dx
        side = BOUND * dx + 0.5 * WIDTH
        lowest = scene.RADIUS + scene.GAP
        x.from_numpy((ball.X + (side, self.floor + lowest, side)).astype(np.float32))
        v.from_numpy(np.tile(np.float32((0, -scene.SPEED, 0)), (len(ball.X), 1)))
        C.fill(0.0)
        F.from_numpy(np.tile(np.eye(3, dtype=np.float32), (len(ball.X), 1, 1)))
        self.x = x

    def advance(self, count: int) -> None:
        for _ in range(count):
            self.substep()
        ti.sync()

    def positions(self) -> np.ndarray:
        return self.x.to_numpy().astype(float) - (0.0, self.floor, 0.0)


if __name__ == "__main__":
    play.main(TaichiMPM, {"taichi": ".".join(map(str, ti.__version__))})

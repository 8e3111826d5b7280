"""Laws called on arrays of deformation gradients, through kernels as the solver's own."""

from functools import cache

import numpy as np
import taichi as ti

from gf_usd.physics.laws.registry import LAWS
from gf_usd.physics.laws.simd3x3 import LANES, rotation
from gf_usd.system.taichi_runtime import init_taichi

CONVERGED = {np.float64: 1e-15, np.float32: 1e-7}  # as TotalLagrangian sets it


@ti.func
def load(A: ti.template(), o):
    """Eight numbers from o on as a lane vector."""
    return ti.Vector([A[o], A[o + 1], A[o + 2], A[o + 3], A[o + 4], A[o + 5], A[o + 6], A[o + 7]])


def _kind(real: type):
    return ti.f64 if real is np.float64 else ti.f32


@cache
def _law_kernel(token: str, real: type):
    law, kind = LAWS[token], _kind(real)
    array = ti.types.ndarray(dtype=kind, ndim=1)

    @ti.kernel
    def run(F: array, mu: array, lam: array, psi: array, P: array, batches: ti.i32, done: kind):
        for b in range(batches):
            o = b * 72
            f = [
                load(F, o), load(F, o + 8), load(F, o + 16), load(F, o + 24), load(F, o + 32),
                load(F, o + 40), load(F, o + 48), load(F, o + 56), load(F, o + 64),
            ]  # fmt: skip
            shear = load(mu, b * LANES)
            bulk = load(lam, b * LANES)
            e = law.psi(f, shear, bulk, done)
            p = law.pk1(f, shear, bulk, done)
            for lane in ti.static(range(8)):
                psi[b * LANES + lane] = e[lane]
                for a in ti.static(range(9)):
                    P[o + 8 * a + lane] = p[a][lane]

    return run


@cache
def _rotation_kernel(real: type):
    kind = _kind(real)
    array = ti.types.ndarray(dtype=kind, ndim=1)

    @ti.kernel
    def run(F: array, R: array, batches: ti.i32, done: kind):
        for b in range(batches):
            o = b * 72
            f = [
                load(F, o), load(F, o + 8), load(F, o + 16), load(F, o + 24), load(F, o + 32),
                load(F, o + 40), load(F, o + 48), load(F, o + 56), load(F, o + 64),
            ]  # fmt: skip
            r = rotation(f, done)
            for lane in ti.static(range(8)):
                for a in ti.static(range(9)):
                    R[o + 8 * a + lane] = r[a][lane]

    return run


def _to_lanes(F: np.ndarray, real: type) -> np.ndarray:
    """(n, 3, 3) as batches of nine lane vectors, the last batch filled up with identities."""
    missing = -len(F) % LANES
    F = np.concatenate([F, np.broadcast_to(np.eye(3), (missing, 3, 3))])
    return np.ascontiguousarray(F.reshape(-1, LANES, 9).swapaxes(1, 2).ravel(), real)


def _from_lanes(flat: np.ndarray, n: int) -> np.ndarray:
    return flat.reshape(-1, 9, LANES).swapaxes(1, 2).reshape(-1, 3, 3)[:n]


def evaluate(
    token: str, F: np.ndarray, mu: float, lam: float, real: type = np.float64
) -> tuple[np.ndarray, np.ndarray]:
    """psi (n,) and P (n, 3, 3) of a registered law at F (n, 3, 3)."""
    init_taichi(f64=real is np.float64)
    flat = _to_lanes(F, real)
    batches = len(flat) // 72
    moduli = [np.full(batches * LANES, value, real) for value in (mu, lam)]
    psi, P = np.full(batches * LANES, np.nan, real), np.full_like(flat, np.nan)
    _law_kernel(token, real)(flat, *moduli, psi, P, batches, CONVERGED[real])
    return psi[: len(F)], _from_lanes(P, len(F))


def rotations(F: np.ndarray, real: type = np.float64) -> np.ndarray:
    """R (n, 3, 3) of `lanes.rotation`."""
    init_taichi(f64=real is np.float64)
    flat = _to_lanes(F, real)
    R = np.full_like(flat, np.nan)
    _rotation_kernel(real)(flat, R, len(flat) // 72, CONVERGED[real])
    return _from_lanes(R, len(F))

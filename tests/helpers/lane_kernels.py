"""Laws called on arrays of deformation gradients, through kernels as the solver's own."""

from functools import cache

import numpy as np
import taichi as ti

from gf_usd.core.materials.laws import LAWS, LawSpec, law_parameters
from gf_usd.physics.laws.registry import MODULI, ParticleLaws, law_set, load
from gf_usd.physics.laws.simd3x3 import LANES, rotation
from gf_usd.system.taichi_runtime import init_taichi

CONVERGED = {np.float64: 1e-15, np.float32: 1e-7}  # as TotalLagrangian sets it


@ti.func
def load_lanes(A: ti.template(), o):
    """Eight numbers from o on as a lane vector."""
    return ti.Vector([A[o], A[o + 1], A[o + 2], A[o + 3], A[o + 4], A[o + 5], A[o + 6], A[o + 7]])


def _kind(real: type):
    return ti.f64 if real is np.float64 else ti.f32


@ti.func
def nine(F: ti.template(), o):
    """Nine lane vectors from o on."""
    return [
        load_lanes(F, o), load_lanes(F, o + 8), load_lanes(F, o + 16), load_lanes(F, o + 24),
        load_lanes(F, o + 32), load_lanes(F, o + 40), load_lanes(F, o + 48),
        load_lanes(F, o + 56), load_lanes(F, o + 64),
    ]  # fmt: skip


@cache
def _law_kernel(spec: LawSpec, real: type):
    law, kind = load(spec), _kind(real)
    array = ti.types.ndarray(dtype=kind, ndim=1)
    count = MODULI + len(spec.parameters)

    @ti.kernel
    def run(F: array, values: array, psi: array, P: array, batches: ti.i32, done: kind):
        for b in range(batches):
            o = b * 72
            f = nine(F, o)
            q = [load_lanes(values, LANES * (count * b + k)) for k in ti.static(range(count))]
            e = law.psi(f, q, done)
            p = law.pk1(f, q, done)
            for lane in ti.static(range(8)):
                psi[b * LANES + lane] = e[lane]
                for a in ti.static(range(9)):
                    P[o + 8 * a + lane] = p[a][lane]

    return run


@cache
def _flow_kernel(spec: LawSpec, real: type):
    law, kind = load(spec), _kind(real)
    array = ti.types.ndarray(dtype=kind, ndim=1)
    count, internals = MODULI + len(spec.parameters), len(spec.internal)

    @ti.kernel
    def run(
        F: array, values: array, a: array, E: array, loss: array, batches: ti.i32, dt: kind,
        done: kind,
    ):  # fmt: skip
        for b in range(batches):
            o = b * 72
            q = [load_lanes(values, LANES * (count * b + k)) for k in ti.static(range(count))]
            before = [
                load_lanes(a, LANES * (internals * b + k)) for k in ti.static(range(internals))
            ]
            e, after, work = law.flow(nine(F, o), q, before, dt, done)
            for lane in ti.static(range(8)):
                loss[b * LANES + lane] = work[lane]
                for k in ti.static(range(9)):
                    E[o + 8 * k + lane] = e[k][lane]
                for k in ti.static(range(internals)):
                    a[LANES * (internals * b + k) + lane] = after[k][lane]

    return run


@cache
def _rotation_kernel(real: type):
    kind = _kind(real)
    array = ti.types.ndarray(dtype=kind, ndim=1)

    @ti.kernel
    def run(F: array, R: array, batches: ti.i32, done: kind):
        for b in range(batches):
            o = b * 72
            f = nine(F, o)
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
    token: str, F: np.ndarray, mu, lam, real: type = np.float64, **own: float
) -> tuple[np.ndarray, np.ndarray]:
    """psi (n,) and P (n, 3, 3) of a registered law at F (n, 3, 3).

    own : parameters of the law's own by name, else at their defaults.
    """
    init_taichi(f64=real is np.float64)
    flat = _to_lanes(F, real)
    batches = len(flat) // 72
    psi, P = np.full(batches * LANES, np.nan, real), np.full_like(flat, np.nan)
    values = _values(token, batches, mu, lam, real, own)
    _law_kernel(LAWS[token], real)(flat, values, psi, P, batches, CONVERGED[real])
    return psi[: len(F)], _from_lanes(P, len(F))


def _values(token: str, batches: int, mu, lam, real: type, own: dict[str, float]) -> np.ndarray:
    """q of the law, batch by batch; mu, lam : numbers, or one of each particle."""
    full = [own.get(p.name, p.default) for p in law_parameters([token])]
    q = np.ones((MODULI + len(full), batches * LANES), real)
    for row, value in zip(q, [mu, lam, *full]):
        row[: np.size(value) if np.size(value) > 1 else None] = value
    return np.ascontiguousarray(q.reshape(len(q), batches, LANES).swapaxes(0, 1)).ravel()


def flow(
    token: str,
    F: np.ndarray,
    a: np.ndarray,
    mu: float,
    lam: float,
    real: type = np.float64,
    dt: float = 0.0,
    **own: float,
) -> tuple[np.ndarray, np.ndarray]:
    """F (n, 3, 3) and internal variables a (n, k) after the law's return mapping."""
    E, after, _ = flow_with_loss(token, F, a, mu, lam, real, dt, **own)
    return E, after


def compile_anew() -> None:
    """Return mappings are compiled again when they are next used."""
    _flow_kernel.cache_clear()


def flow_with_loss(
    token: str,
    F: np.ndarray,
    a: np.ndarray,
    mu: float,
    lam: float,
    real: type = np.float64,
    dt: float = 0.0,
    **own: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same, and what flow dissipated (n,) [J/m^3]."""
    init_taichi(f64=real is np.float64)
    flat = _to_lanes(F, real)
    batches, k = len(flat) // 72, a.shape[1]
    wide = np.zeros((batches * LANES, k), real)
    wide[: len(a)] = a
    lanes = np.ascontiguousarray(wide.reshape(batches, LANES, k).swapaxes(1, 2)).ravel()
    E, loss = np.full_like(flat, np.nan), np.full(batches * LANES, np.nan, real)
    values = _values(token, batches, mu, lam, real, own)
    _flow_kernel(LAWS[token], real)(flat, values, lanes, E, loss, batches, dt, CONVERGED[real])
    after = lanes.reshape(batches, k, LANES).swapaxes(1, 2).reshape(-1, k)
    return _from_lanes(E, len(F)), after[: len(F)], loss[: len(F)]


def alike(token: str, n: int, mu: float, lam: float) -> ParticleLaws:
    """n particles of one law with these moduli, other parameters at their defaults."""
    own = [p.default for p in law_parameters([token])]
    q = np.tile(np.array([mu, lam, *own])[:, None], n)
    rest = np.zeros((len(LAWS[token].internal), n))
    return ParticleLaws(set=law_set((LAWS[token],)), of=np.zeros(n, int), q=q, rest=rest)


def rotations(F: np.ndarray, real: type = np.float64) -> np.ndarray:
    """R (n, 3, 3) of `lanes.rotation`."""
    init_taichi(f64=real is np.float64)
    flat = _to_lanes(F, real)
    R = np.full_like(flat, np.nan)
    _rotation_kernel(real)(flat, R, len(flat) // 72, CONVERGED[real])
    return _from_lanes(R, len(F))

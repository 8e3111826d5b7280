"""Skinning of vertices to the particles, by inverse-distance weights.

Vertex v at rest X_v has weights w_vk >= 0, sum_k w_vk = 1, on the particles k, which decrease with
distance, w ~ |X_v - X_k|^-p, and keeps its rest offset from their weighted mean
(GaussianFlesh section 3.4, eq. 6):

    delta_v = X_v - sum_k w_vk X_k          x_v = sum_k w_vk x_k + T_v delta_v

An offset is a material vector, and T_v = sum_k w_vk F_k rotates and stretches it as one: exact for
every affine map.  The paper's T_v = sum_k w_vk U_k, F = R U, stretches it without rotating it:
exact for a pure stretch, with an error of |(R - I) delta| where the body rotates.

Velocities need dT/dt, from dF/dt = dv/dX at the particles, the gradient of their velocities with
respect to rest positions (`rest_gradient`).  A pose does not depend on the frames before it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.frame import Pose
from gf_usd.core.matrices import stretch
from gf_usd.core.neighbors import nearest, operator, slopes, squared_distances

NEIGHBORS = 32  # particles per vertex of the idw skin
IDW_POWER = 4.0  # by measurement: docs/physics.md, Skins
PAPER_POWER = 2.0  # not published; fitted to the tables of the paper
GRADIENT_NEIGHBORS = 20  # enough for a rank of 3 at a corner, few enough for a local gradient
# Dense weights per chunk: they fit in a core's cache, and BLAS does not split so small a product
# among threads, which takes several times as long where cores are busy (measured).
CHUNK_BYTES = 200_000
KEPT_BYTES = 32_000_000  # of weights that are kept from frame to frame
SKIN_NOTES = {
    "paper": (
        "skin paper: offsets of vertices are stretched with the body but not rotated "
        "(GaussianFlesh eq. 6); meshes are distorted where it rotates",
    )
}


class Skin(Protocol):
    """Points skinned to a set of particles."""

    def pose(self, particles: Pose, turn: Floats | None = None) -> Pose:
        """x (n, 3) [m], v (n, 3) [m/s] and blended F (n, 3, 3) of the points.

        turn : (N, 3, 3) rotations R of the particles' F = R U; None: they are computed if needed.
        """
        ...


class InverseDistance:
    """Weights on the nearest particles, offsets transformed by the blended F.

    X : (n, 3) [m] rest positions of the points; particles : (N, 3) [m] of the particles.
    """

    def __init__(
        self, X: Floats, particles: Floats, *, k: int = NEIGHBORS, power: float = IDW_POWER
    ) -> None:
        self.W = nearest_weights(X, particles, k, power)
        self.offset = X - self.W @ particles
        self.gradient = rest_gradient(particles)

    def pose(self, particles: Pose, turn: Floats | None = None) -> Pose:
        """x = sum w x_k + F delta,  v = sum w v_k + dF/dt delta,  F = sum w F_k."""
        rate = slopes(self.gradient, particles.v)
        x, v, F, dF = blend(self.W.__matmul__, particles.x, particles.v, particles.F, rate)
        return Pose(x=x + transformed(F, self.offset), v=v + transformed(dF, self.offset), F=F)


class PaperSkin:
    """The paper's eq. 6: weights on all particles, offsets transformed by the blended stretch U.

    The weights (n x N) are stored where they fit in `KEPT_BYTES`, else recomputed at every use.
    X : (n, 3) [m] rest positions of the points; particles : (N, 3) [m] of the particles.
    """

    def __init__(
        self,
        X: Floats,
        particles: Floats,
        *,
        power: float = PAPER_POWER,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        self.weights = CloudWeights(X, particles, power, chunk_bytes)
        self.offset = X - self.weights @ particles
        self.gradient = rest_gradient(particles)

    def pose(self, particles: Pose, turn: Floats | None = None) -> Pose:
        """x = sum w x_k + U delta,  v = sum w v_k + dU/dt delta,  F = sum w F_k."""
        U, dU = stretch(particles.F, slopes(self.gradient, particles.v), turn)
        x, v, F, U, dU = blend(
            self.weights.__matmul__, particles.x, particles.v, particles.F, U, dU
        )
        return Pose(x=x + transformed(U, self.offset), v=v + transformed(dU, self.offset), F=F)


SKINS: dict[str, Callable[[Floats, Floats], Skin]] = {"idw": InverseDistance, "paper": PaperSkin}


def make_skin(name: str, X: Floats, particles: Floats) -> Skin:
    """The skin of SKINS for points X (n, 3) [m] on particles (N, 3) [m], both at rest.

    Raises UsageError for a name that is not in SKINS.
    """
    if name not in SKINS:
        raise UsageError(f"unknown skin {name!r} on particles", f"choose one of {', '.join(SKINS)}")
    return SKINS[name](X, particles)


class MeshSkin:
    """One skin for all meshes of an asset.

    points : vertices (n, 3) [m] at rest, by prim path; particles : (N, 3) [m] at rest.
    Raises UsageError for a name that `make_skin` does not have.
    """

    def __init__(self, name: str, points: Mapping[str, Floats], particles: Floats) -> None:
        self.paths = tuple(points)
        ends = np.cumsum([len(X) for X in points.values()])
        self.rows = tuple(slice(end - len(X), end) for X, end in zip(points.values(), ends))
        self.skin = make_skin(name, np.concatenate(list(points.values())), particles)

    def poses(self, particles: Pose, turn: Floats | None = None) -> dict[str, Pose]:
        """The pose of each mesh, by prim path; see `Skin.pose`."""
        whole = self.skin.pose(particles, turn)
        return {
            path: Pose(x=whole.x[rows], v=whole.v[rows], F=whole.F[rows])
            for path, rows in zip(self.paths, self.rows)
        }


def inverse_distance(squared: Floats, power: float) -> Floats:
    """w = d^-p / sum d^-p along the last axis, from squared distances (..., k).

    A point that coincides with particles follows their mean alone.
    """
    least = squared.min(-1, keepdims=True)
    # Relative to the nearest, so that no power of a distance over- or underflows in any unit.
    if least.all():
        w = least / squared
        if power != 2.0:
            w **= 0.5 * power
    else:
        on = least == 0.0
        ratio = np.where(on, 0.0, least) / np.where(squared > 0.0, squared, 1.0)
        w = np.where(on, squared == 0.0, ratio if power == 2.0 else ratio ** (0.5 * power))
    w /= w.sum(-1, keepdims=True)
    return w


def nearest_weights(X: Floats, particles: Floats, k: int, power: float) -> sparse.csr_matrix:
    """(n, N) inverse-distance weights on the k nearest particles, or on all of them if fewer."""
    k = min(k, len(particles))
    distance, near = nearest(particles, X, k)
    w = inverse_distance(distance**2, power)
    start = np.arange(0, w.size + 1, k)
    return sparse.csr_matrix((w.ravel(), near.ravel(), start), shape=(len(X), len(particles)))


class CloudWeights:
    """Inverse-distance weights (n, N) on every particle, a chunk of rows at a time.

    chunk_bytes is the size of a chunk, at least one row (8 N bytes).  Chunks are stored where all
    of them take at most `kept_bytes`; the results are bit-identical either way.
    """

    def __init__(
        self,
        X: Floats,
        particles: Floats,
        power: float,
        chunk_bytes: int,
        kept_bytes: int = KEPT_BYTES,
    ) -> None:
        self.X = np.asarray(X, float)
        self.particles = np.asarray(particles, float)
        self.power = power
        rows = max(1, chunk_bytes // (8 * len(particles)))
        self.chunks = [slice(start, start + rows) for start in range(0, len(X), rows)]
        self.kept = None
        if 8 * len(X) * len(particles) <= kept_bytes:
            self.kept = [self._weights(chunk) for chunk in self.chunks]

    def __matmul__(self, values: Floats) -> Floats:
        """(n, c) weighted sums of values (N, c)."""
        out = np.empty((len(self.X), values.shape[1]))
        for k, chunk in enumerate(self.chunks):
            weights = self.kept[k] if self.kept else self._weights(chunk)
            np.matmul(weights, values, out=out[chunk])
        return out

    def _weights(self, chunk: slice) -> Floats:
        squared = squared_distances(self.X[chunk], self.particles)
        return inverse_distance(squared, self.power)


def blend(apply: Callable[[Floats], Floats], *fields: Floats) -> tuple[Floats, ...]:
    """Weighted sums of fields (N, ...) in one pass over the weights."""
    flat = [field.reshape(len(field), -1) for field in fields]
    mixed, end, out = apply(np.concatenate(flat, 1)), 0, []
    for field, columns in zip(fields, flat):
        start, end = end, end + columns.shape[1]
        out.append(mixed[:, start:end].reshape(-1, *field.shape[1:]))
    return tuple(out)


def transformed(T: Floats, offset: Floats) -> Floats:
    """T_v delta_v, (n, 3)."""
    return np.einsum("vab,vb->va", T, offset)


def rest_gradient(particles: Floats, k: int = GRADIENT_NEIGHBORS) -> sparse.csr_matrix:
    """Least-squares gradient operator (`slopes`) over the k nearest particles, weights 1/|dX|^2."""
    distance, near = nearest(particles, particles, min(k + 1, len(particles)))
    apart = distance > 0.0  # the particle itself, and any coincident one, has no weight
    w = np.where(apart, 1.0 / np.where(apart, distance, 1.0) ** 2, 0.0)
    return operator(near, particles[near] - particles[:, None, :], w)

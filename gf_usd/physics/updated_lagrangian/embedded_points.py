"""Points embedded in the particles of an Updated Lagrangian body.

A point at rest position X is interpolated from the particles that are nearest to it at rest. Each
particle maps the point by its own deformation; the point is their weighted mean:

    x = sum_p w_p (x_p + F_p (X - X_p)),   F = sum_p w_p F_p
    v = sum_p w_p (v_p + L_p F_p (X - X_p))

with w = (1 - d^2 / R^2)^2, normalized to sum 1, and R slightly beyond the first particle that is
left out, so that the interpolation is continuous where its support changes. It is exact for affine
maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.frame import Pose
from gf_usd.core.neighbors import kd_tree
from gf_usd.physics.grid.reference.stencil import Rows

SUPPORT = 8  # particles from which a point is interpolated: about those of one cell


@dataclass(frozen=True, kw_only=True)
class EmbeddedPoints:
    """A set of points and the particles from which each is interpolated."""

    X: Floats  # (n, 3) [m] rest positions of the points
    particle: Ints  # (n, SUPPORT)
    weight: Floats  # (n, SUPPORT), rows sum to 1
    arm: Floats  # (n, SUPPORT, 3) [m] X - X_p

    def pose(self, x: Floats, v: Floats, F: Floats, L: Floats) -> Pose:
        """Pose of the points for the particles' x, v (N, 3), F, L (N, 3, 3)."""
        w, p = self.weight, self.particle
        d = np.einsum("nkab,nkb->nka", F[p], self.arm)
        return Pose(
            x=np.einsum("nk,nka->na", w, x[p] + d),
            v=np.einsum("nk,nka->na", w, v[p] + np.einsum("nkab,nkb->nka", L[p], d)),
            F=np.einsum("nk,nkab->nab", w, F[p]),
        )

    @property
    def single(self) -> bool:
        """Whether each point is attached to one particle: see `attach`."""
        return bool((self.weight[:, 0] == 1.0).all() and not self.arm[:, 0].any())

    def rows(self, particles: Rows) -> sparse.csr_matrix:
        """B (n, M): velocity of the points by that of the nodes, at rest.

        particles : W and G of the particles; W alone for attached points.
        """
        shape = (len(self.X), len(particles.X))
        start = np.arange(len(self.X) + 1) * self.weight.shape[1]

        def by_particle(values: Floats) -> sparse.csr_matrix:
            return sparse.csr_matrix((values.ravel(), self.particle.ravel(), start), shape=shape)

        B = by_particle(self.weight) @ particles.W
        for axis, G in enumerate(particles.G):
            B = B + by_particle(self.weight * self.arm[..., axis]) @ G
        return sparse.csr_matrix(B)


def embed(points: Floats, X: Floats) -> EmbeddedPoints:
    """Embed points (n, 3) [m] in particles at X (N, 3) [m].

    If a body has fewer particles than SUPPORT, some are repeated with zero weight.
    """
    k = min(SUPPORT, len(X))
    distance, near = kd_tree(X).query(points, k=min(k + 1, len(X)))
    distance, near = distance.reshape(len(points), -1), near.reshape(len(points), -1)
    R = 1.01 * distance[:, -1:] + 1e-300
    w = (1.0 - (distance[:, :k] / R) ** 2) ** 2
    weight = np.zeros((len(points), SUPPORT))
    weight[:, :k] = w / w.sum(1, keepdims=True)
    particle = np.repeat(near[:, :1], SUPPORT, axis=1)
    particle[:, :k] = near[:, :k]
    return EmbeddedPoints(
        X=points, particle=particle, weight=weight, arm=points[:, None] - X[particle]
    )


def attach(points: Floats, X: Floats) -> EmbeddedPoints:
    """Points (n, 3) [m] that move with the particle at X (N, 3) [m] that is nearest at rest.

    For flowing bodies, whose particles separate: the mean of the positions of former neighbors may
    lie outside of the body.
    """
    nearest = kd_tree(X).query(points, k=1)[1]
    particle = np.repeat(np.reshape(nearest, (len(points), 1)), SUPPORT, axis=1)
    weight = np.zeros((len(points), SUPPORT))
    weight[:, 0] = 1.0
    return EmbeddedPoints(
        X=points, particle=particle, weight=weight, arm=np.zeros((len(points), SUPPORT, 3))
    )

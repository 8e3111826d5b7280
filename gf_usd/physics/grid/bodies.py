"""The bodies of a solver: particles, mass and radius of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import Particles
from gf_usd.core.neighbors import nearest


@dataclass(frozen=True, kw_only=True)
class Bodies:
    """Every body of a solver."""

    of: Ints  # (N,) body of each particle
    mass: Floats  # (B,) [kg]
    radius: Floats  # (B,) [m] of a ball of the body's volume

    @property
    def count(self) -> int:
        """B, the number of bodies."""
        return len(self.mass)

    def nearest(self, X: Floats, particles: Floats, body: Ints) -> Ints:
        """Index of the particle (N, 3) [m] of the same body that is nearest to each point X (n, 3)
        [m].
        """
        out = np.zeros(len(X), np.int64)
        for k in range(self.count):
            at, mine = np.flatnonzero(body == k), np.flatnonzero(self.of == k)
            if len(at):
                out[at] = mine[nearest(particles[mine], X[at], 1)[1][:, 0]]
        return out


def bodies_of(particles: Particles, density: Floats) -> Bodies:
    """The bodies of particles; density : (N,) [kg/m^3]."""
    of = particles.body_of
    volume = np.bincount(of, particles.V0)
    return Bodies(
        of=of,
        mass=np.bincount(of, density * particles.V0),
        radius=np.cbrt(3.0 * volume / (4.0 * np.pi)),
    )


def node_sums(values: Floats, body: Ints, count: int) -> Floats:
    """(B, k) sums of rows (n, k) over the nodes of each of `count` bodies; body : (n,)."""
    return np.stack([np.bincount(body, column, count) for column in values.T], 1)


Start = Any  # (3,) [m/s], a callable X (n, 3) -> (n, 3) [m/s], or a list of these, one a body


def start_velocity(velocity: Start, X: Floats, body: Ints) -> Floats:
    """(n, 3) [m/s] at points X (n, 3) [m] of bodies (n,)."""
    each: Sequence[Any] = velocity if isinstance(velocity, list) else [velocity]
    out = np.zeros(X.shape)
    for k, one in enumerate(each):
        mine = body == k if len(each) > 1 else np.ones(len(X), bool)
        out[mine] = one(X[mine]) if isinstance(one, Callable) else np.asarray(one, float)
    return out


def fastest(velocity: Floats) -> float:
    """[m/s] the largest finite speed of velocities (n, 3)."""
    speed = np.linalg.norm(velocity, axis=1)
    return float(speed[np.isfinite(speed)].max(initial=0.0))

"""Deformations with a closed form, to measure skins against.

A map takes rest positions q (n, 3) in radii from the body's centre and an amplitude s, 1 at full
deformation and 0 at rest, to deformed positions.  Read as a motion, s is time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames import Pose

Map = Callable[[Floats, float], Floats]
STEP = 1e-5  # of central differences, in radii and in s: both errors are near 1e-10

BEND = 0.5  # curvature [1/r]: the fibre at one radius on the inside is half as long
TWIST = np.pi / 4.0  # [rad/r]: a quarter turn over two radii
SQUASH = 0.6  # height over rest height


def turn(q: Floats, s: float) -> Floats:
    """A rigid turn of 90 degrees about the diagonal (1, 1, 1)."""
    return rotated(q, np.ones(3) / np.sqrt(3.0), np.full(len(q), s * np.pi / 2.0))


def squash(q: Floats, s: float) -> Floats:
    """diag(c^-1/2, c, c^-1/2) q with c = SQUASH: a pure stretch that keeps the volume."""
    c = 1.0 - s * (1.0 - SQUASH)
    return q * np.array([c**-0.5, c, c**-0.5])


def bend(q: Floats, s: float) -> Floats:
    """The x axis wound on a circle: (y' sin kx, 1/k - y' cos kx, z), y' = 1/k - y, k = s BEND."""
    k = s * BEND
    x, y, z = q.T
    return np.stack([(1 / k - y) * np.sin(k * x), 1 / k - (1 / k - y) * np.cos(k * x), z], 1)


def twist(q: Floats, s: float) -> Floats:
    """A turn about y by the angle s TWIST y."""
    return rotated(q, np.array([0.0, 1.0, 0.0]), s * TWIST * q[:, 1])


def rotated(q: Floats, axis: Floats, angle: Floats) -> Floats:
    """Rodrigues' rotation of q (n, 3) about a unit axis by angles (n,) [rad]."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return q * c + np.cross(axis, q) * s + axis * (q @ axis)[:, None] * (1.0 - c)


MAPS: dict[str, Map] = {"squash": squash, "90° turn": turn, "bend": bend, "twist": twist}


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A map at the scale r [m] and the centre (3,) [m] of a body, at s = 1."""

    map: Map
    centre: Floats
    radius: float

    def x(self, X: Floats, s: float = 1.0) -> Floats:
        """(n, 3) [m] deformed positions of X (n, 3) [m]."""
        return self.centre + self.radius * self.map((X - self.centre) / self.radius, s)

    def v(self, X: Floats) -> Floats:
        """dx/ds (n, 3) [m] at s = 1."""
        return (self.x(X, 1.0 + STEP) - self.x(X, 1.0 - STEP)) / (2.0 * STEP)

    def F(self, X: Floats, s: float = 1.0) -> Floats:
        """dx/dX (n, 3, 3)."""
        d = STEP * self.radius
        sides = [(self.x(X + d * e, s), self.x(X - d * e, s)) for e in np.eye(3)]
        return np.stack([(a - b) / (2.0 * d) for a, b in sides], -1)

    def dF(self, X: Floats) -> Floats:
        """d^2x/dX ds (n, 3, 3) at s = 1."""
        # A difference of differences: a wider step keeps its rounding near 1e-7.
        d = 100.0 * STEP
        return (self.F(X, 1.0 + d) - self.F(X, 1.0 - d)) / (2.0 * d)

    def pose(self, X: Floats) -> Pose:
        """The exact pose of points X (n, 3) [m]."""
        return Pose(x=self.x(X), v=self.v(X), F=self.F(X))

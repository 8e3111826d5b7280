"""Implicit shapes f(p) < 0 inside, near unit gradient on the surface, and their smooth unions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Field = Callable[[Floats], Floats]  # (n, 3) -> (n,)

STEP = 1e-5  # [length] of the differences: rounding stays near 1e-10


def ellipsoid(p: Floats, center: tuple[float, ...], radii: tuple[float, ...]) -> Floats:
    """First-order distance g / |grad g| of g = |q / r| - 1, with q = p - center."""
    q = (p - np.array(center)) / np.array(radii)
    g = np.linalg.norm(q, axis=-1)
    slope = np.linalg.norm(q / np.array(radii), axis=-1)
    return (g - 1.0) * g / np.maximum(slope, 1e-9)


def lozenge(p: Floats, center: tuple[float, ...], radii: tuple[float, ...]) -> Floats:
    """First-order distance to rho^4 + (y/b)^2 = 1 with rho^2 = (x/a)^2 + (z/c)^2.

    A flat ellipsoid with twice the radius of curvature at its rim.
    """
    q = (p - np.array(center)) / np.array(radii)
    rho2 = q[..., 0] ** 2 + q[..., 2] ** 2
    level = rho2**2 + q[..., 1] ** 2 - 1.0
    slope = q * np.stack([4.0 * rho2, 2.0 + 0.0 * rho2, 4.0 * rho2], axis=-1) / np.array(radii)
    return level / np.sqrt(np.sum(slope**2, axis=-1) + 0.1)  # 0.1: finite at the center


def round_cone(
    p: Floats, a: tuple[float, ...], b: tuple[float, ...], ra: float, rb: float
) -> Floats:
    """Distance to the axis a-b minus a radius that runs linearly from ra to rb."""
    start, axis = np.array(a), np.array(b) - np.array(a)
    t = np.clip((p - start) @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(p - start - t[..., None] * axis, axis=-1) - (ra + (rb - ra) * t)


def join(a: Floats, b: Floats, k: float) -> Floats:
    """Smooth union: min(a, b) where |a - b| >= k, a twice differentiable fillet within."""
    h = np.maximum(k - np.abs(a - b), 0.0) / k
    return np.minimum(a, b) - k / 6.0 * h**3


def meet(a: Floats, b: Floats, k: float) -> Floats:
    """Smooth intersection, the dual of ``join``."""
    return -join(-a, -b, k)


def tilt(p: Floats, center: tuple[float, ...], degrees: float) -> Floats:
    """Points in a frame turned about the x axis through ``center``; a shape drawn there has its
    +z end raised by ``degrees``."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    q = p - np.array(center)
    turned = np.stack([q[..., 0], c * q[..., 1] - s * q[..., 2], s * q[..., 1] + c * q[..., 2]], -1)
    return turned + np.array(center)


def gradient(field: Field, p: Floats) -> Floats:
    """Central differences of ``field`` at p (n, 3)."""
    offsets = STEP * np.eye(3)
    return np.stack([field(p + d) - field(p - d) for d in offsets], axis=-1) / (2.0 * STEP)


def value_and_slope(field: Field, p: Floats) -> tuple[Floats, Floats]:
    """f (n,) and its forward differences (n, 3): good enough to aim a Newton step."""
    f = field(p)
    return f, np.stack([field(p + d) - f for d in STEP * np.eye(3)], axis=-1) / STEP


def unit_normals(field: Field, p: Floats) -> Floats:
    """Outward unit normals of the level set through each point."""
    g = gradient(field, p)
    return g / np.linalg.norm(g, axis=-1, keepdims=True)


def one_side(p: Floats) -> Floats:
    """(|x|, y, z): what is drawn at x > 0 appears on both sides."""
    return np.concatenate([np.abs(p[..., :1]), p[..., 1:]], axis=-1)

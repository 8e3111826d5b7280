"""The error of USD's interpolation between two samples, relative to a sample that is left out.

With s = (t - ta) / (tb - ta) in [0, 1], USD interpolates samples a and b as

    arrays of numbers and vectors   (1 - s) a + s b
    arrays of quaternions           slerp(a, b; s) = (sin((1 - s) w) a + sin(s w) b) / sin w,
                                    cos w = |a . b|, b negated where a . b < 0

and holds arrays of integers at a.  The errors relative to the sample c at t, in world space, are

    positions     |x - x_c|
    velocities    |v - v_c| h, with h half the time between samples: the displacement at the end of
                  a shutter of 180 degrees
    Gaussians     |V - V_c| of V = R diag(scales) R^T, Frobenius norm: an upper bound of the error
                  of the ellipsoid at one standard deviation in any direction n, where it extends
                  to |V n|
    boxes         how far the box of c extends beyond the interpolated one
    normals       the angle between them
    other values  the largest difference over the largest number

Half precision has a relative error of 2^-11.  A component of a unit quaternion then has an error of
2^-12, the quaternion 2^-11, the rotation 2^-10 rad and V sqrt(2) 2^-10 of its largest scale; a
scale has a relative error of 2^-11, and V sqrt(3) 2^-11.  USD interpolates halves in half
precision: both terms and their sum are rounded, each with the same relative error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf

from gf_usd.core.arrays import Floats, lengths
from gf_usd.core.matrices import gaussian_axes

POSITIONS, VELOCITIES, NORMALS = "positions", "velocities", "normals"
ORIENTATIONS, SCALES, SHAPES, BOX = "orientations", "scales", "shapes", "box"
# attribute -> kind of error
KINDS = {
    "points": POSITIONS,
    "positions": POSITIONS,
    "velocities": VELOCITIES,
    "gaussianFlesh:velocities": VELOCITIES,
    "normals": NORMALS,
    "primvars:normals": NORMALS,
    "orientations": ORIENTATIONS,
    "orientationsh": ORIENTATIONS,
    "scales": SCALES,
    "scalesh": SCALES,
}
LENGTHS = (POSITIONS, VELOCITIES, SHAPES, BOX)  # kinds whose error is a length
EPS = float(np.finfo(np.float32).eps)
HALF = 2.0**-11
HALF_SHAPE = (2.0 * math.sqrt(2.0) + math.sqrt(3.0)) * HALF  # of the largest scale
NEAR = 1.0 - 1e-5  # cosine above which USD's slerp is linear
Rows = Mapping[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Allowed:
    """Error tolerances of samples that are left out."""

    length: Floats  # () or (n,) [stage units] of each point
    shape: Floats  # the same for Gaussians
    angle: float  # [rad] of normals
    share: float  # relative, for all other values
    shutter: float  # [s of playback] half the time between samples


def rows_of(values: Mapping[Sdf.Path, Any]) -> dict[str, np.ndarray]:
    """The sample arrays of prims that move together, by kind.

    Of a kind that several prims have, the first by path is used: they share the array.
    """
    rows: dict[str, np.ndarray] = {}
    for path in sorted(values):
        name = path.name
        kind = f"{BOX} {path.GetPrimPath()}" if name == "extent" else KINDS.get(name) or name
        rows.setdefault(str(kind), np.asarray(values[path]))
    return rows


def interpolation_errors(
    a: Rows, b: Rows, c: Rows, s: float, allowed: Allowed, turn: Floats
) -> dict[str, float]:
    """The largest error of each kind at c, interpolated between a and b.

    Lengths [stage units], angles [rad], relative errors.

    turn : (3, 3) from the space of the prim to the world, for rows.  Ends early, with infinity,
        where an error exceeds its tolerance.
    """
    worst: dict[str, float] = {}
    plain = [kind for kind in c if kind not in (ORIENTATIONS, SCALES)]
    for kind in sorted(plain, key=lambda one: one != POSITIONS):  # the likeliest first
        error, most = _error_and_limit(kind, a[kind], b[kind], c[kind], s, allowed, turn)
        if (error > most).any():
            return {kind: np.inf}
        name = BOX if kind.startswith(BOX) else kind
        worst[name] = max(worst.get(name, 0.0), float(np.max(error, initial=0.0)))
    if ORIENTATIONS in c and SCALES in c:
        error = _shape_errors(a, b, c, s) * np.linalg.norm(turn, 2)
        if (error > allowed.shape).any():
            return {SHAPES: np.inf}
        worst[SHAPES] = float(error.max(initial=0.0))
    return worst


def _shape_errors(a: Rows, b: Rows, c: Rows, s: float) -> np.ndarray:
    """(n,) error of the shapes of Gaussians, in the unit of their scales."""
    both = (ORIENTATIONS, SCALES)
    if all(np.array_equal(x[kind], c[kind]) for x in (a, b) for kind in both):
        error = np.zeros(len(c[SCALES]))  # a shortcut for free flight and rest
    else:
        turned = slerp(a[ORIENTATIONS], b[ORIENTATIONS], s)
        between = turned, _lerp(a[SCALES], b[SCALES], s)
        error = shape_errors(between, (c[ORIENTATIONS], c[SCALES]))
    if a[SCALES].dtype == np.float16:
        largest = np.maximum(a[SCALES], b[SCALES]).max(axis=1).astype(np.float64)
        error = error + 2.0 * HALF_SHAPE * largest
    return error


def _error_and_limit(
    kind: str,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    s: float,
    allowed: Allowed,
    turn: Floats,
) -> tuple[np.ndarray, Floats | float]:
    """The error of one kind, and its tolerance."""
    if c.dtype.kind in "iub":
        return np.asarray(0.0 if np.array_equal(a, c) else np.inf), 0.0
    between = _lerp(a, b, s)
    if kind.startswith(BOX):
        out = np.maximum(between[0] - c[0], c[1] - between[1]).max()
        return np.asarray(max(float(out), 0.0)) * np.linalg.norm(turn, 2), np.min(allowed.length)
    if kind == NORMALS:
        # |u - v| = 2 sin(angle / 2) of unit vectors
        chord = lengths(_unit(between) - _unit(c.astype(np.float64)))
        return 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)), allowed.angle
    apart = between - c
    if kind == POSITIONS:
        # USD's result is rounded to single precision
        largest = max(float(np.abs(one).max(initial=0.0)) for one in (a, b))
        return lengths(apart @ turn) + EPS * largest * np.linalg.norm(turn, 2), allowed.length
    if kind == VELOCITIES:
        return lengths(apart @ turn) * allowed.shutter, allowed.length
    largest = max(float(np.abs(one).max(initial=0.0)) for one in (a, b, c))
    most = float(np.abs(apart).max(initial=0.0))
    rounding = 2.0 * HALF if c.dtype == np.float16 else 0.0
    return np.asarray(most / largest + rounding if largest else 0.0), allowed.share


def slerp(a: np.ndarray, b: np.ndarray, s: float) -> np.ndarray:
    """(n, 4) quaternions between two, as USD interpolates them."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    cosine = np.einsum("ij,ij->i", a, b)
    b = np.where(cosine[:, None] < 0.0, -b, b)
    cosine = np.abs(cosine)
    w = np.arccos(np.minimum(cosine, 1.0))
    sine = np.where(cosine > NEAR, 1.0, np.sin(w))
    first = np.where(cosine > NEAR, 1.0 - s, np.sin((1.0 - s) * w) / sine)
    second = np.where(cosine > NEAR, s, np.sin(s * w) / sine)
    return first[:, None] * a + second[:, None] * b


Gaussians = tuple[np.ndarray, np.ndarray]  # quaternions (n, 4) as NumPy has USD's, scales (n, 3)


def shape_errors(here: Gaussians, true: Gaussians) -> np.ndarray:
    """(n,) |V - V_c| between two sets of Gaussians, in the unit of their scales."""
    return np.sqrt(((_shape(*here) - _shape(*true)) ** 2).sum(axis=(1, 2)))


def _shape(xyzw: np.ndarray, scales: np.ndarray) -> np.ndarray:
    q = xyzw[:, [3, 0, 1, 2]]
    return gaussian_axes(q, scales) @ gaussian_axes(q, np.ones_like(scales)).transpose(0, 2, 1)


def _lerp(a: np.ndarray, b: np.ndarray, s: float) -> np.ndarray:
    return (1.0 - s) * a.astype(np.float64) + s * b


def _unit(rows: np.ndarray) -> np.ndarray:
    length = lengths(rows)[:, None]
    return np.divide(rows, length, out=np.zeros_like(rows), where=length > 0.0)

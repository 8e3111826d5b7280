"""Layout of contact planes in the arrays of the kernels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.planes.contact_planes import NOBODY, OBSTACLE, ContactPlanes
from gf_usd.physics.taichi_arrays import DeviceState

# To limit the number of arrays, all reals of a sample are in one row of `pair`, ...
ROW = 45
REST, DRIFT, PLACE, RATE, FORCE = 0, 3, 6, 9, 12  # X, its rate by a pin, x, v, f
POINT, NORMAL, VELOCITY = 15, 18, 21  # q (of a body's plane: from sum w x), n, v_q of an obstacle
STIFFNESS, DAMPING, FRICTION = 24, 25, 26
DEPTH, WORK = 27, 28  # deepest [m] and work of an obstacle [J] since they were cleared
SPRING, WEIGHT, REACTION = 29, 32, 35  # xi; w_k and f_k of the three carriers
HARDENING = 44  # [1/m^2] of the spring: f = k d (1 + HARDENING d^2)
# ... and its integers in one of `links`: the carriers; the start of its list; three entries of all
# lists.
LINKS = 7
PARTNER, START, PAIR_FACING = 0, 3, 4


def pack_arrays(n: int) -> dict[str, Floats]:
    """The arrays of contact between n samples for the kernels; n = 0: none."""
    return {
        "pair": np.zeros(ROW * max(1, n)),
        "links": np.full(LINKS * (n + 1), NOBODY),
    }


def link_rows(planes: ContactPlanes) -> Ints:
    """(n + 1, LINKS) the integers of n samples: see above."""
    start, order = planes.lists()
    out = np.full((len(start), LINKS), NOBODY)
    out[:-1, :START], out[:, START] = planes.carriers, start
    out[:-1, PARTNER] = planes.partner
    entries = np.zeros((len(start), 3), np.int64)
    entries.flat[: len(order)] = order
    out[:, PAIR_FACING:] = entries
    return out


def write_planes(
    pair: Floats, planes: ContactPlanes, values: Mapping[str, Floats], hardening: float
) -> None:
    """Write planes to the rows of `pair` (n, ROW), and reset the results of the kernels.

    values : of `pair_values`; hardening : [1/m^2]. REST and DRIFT are not written.
    """
    pair[:, PLACE:RATE] = 0.0
    pair[:, FORCE:POINT] = 0.0
    pair[:, DEPTH] = 0.0
    pair[:, SPRING:WEIGHT] = planes.spring
    pair[:, WEIGHT:REACTION] = planes.weights
    pair[:, REACTION:HARDENING] = 0.0
    pair[:, POINT:NORMAL] = planes.point
    pair[:, NORMAL:VELOCITY] = planes.normal
    pair[:, VELOCITY:STIFFNESS] = planes.velocity
    pair[:, STIFFNESS] = values["stiffness"]
    pair[:, DAMPING] = values["damping"]
    pair[:, FRICTION] = values["friction"]
    pair[:, HARDENING] = hardening


def upload(
    state: DeviceState, f: ContactPlanes, values: Mapping[str, Floats], hardening: float, *,
    X: Floats, drift: Floats | None, origin: Floats, dt: float,
) -> None:  # fmt: skip
    """Write planes for substeps of dt [s], and what moves their samples besides the nodes.

    values, hardening : see `write_planes`; X, drift : see `write_rest`, in the middle of the first
    substep; origin : (3,) [m] of the frame in which the samples are at X.
    """
    point = f.point - 0.5 * dt * f.velocity
    point[f.partner == OBSTACLE] -= origin
    with state.written("pair", ROW) as pair:
        write_rest(pair, X, drift)
        write_planes(pair, replace(f, point=point), values, hardening)
    state.put("links", link_rows(f))


def origin_of(X: Floats) -> Floats:
    """(3,) [m] from which REST, PLACE and the POINT of obstacles are measured, with samples at X.

    In single precision positions 5 km from the origin are exact to 0.5 mm only, and bodies that
    touch would never rest. Scenes around the world's origin keep it.
    """
    if not len(X):
        return np.zeros(3)
    low, high = X.min(0), X.max(0)
    unit = 8.0 * max(float((high - low).max()), 1e-30)
    return unit * np.round(0.5 * (low + high) / unit)


def write_rest(pair: Floats, X: Floats, drift: Floats | None) -> None:
    """Write the positions of samples without displacements, X (n, 3) [m] from `origin_of`, and
    their rate (n, 3) [m/s] by pins; None: no pin moves.
    """
    pair[:, REST:DRIFT] = X
    pair[:, DRIFT:PLACE] = 0.0 if drift is None else drift

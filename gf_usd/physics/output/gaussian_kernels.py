"""Gaussians of a frame, eight particles at once, in double precision.

A lane vector has one value of eight particles, so that one operation is two SIMD instructions,
as in `laws.simd3x3`, whose algebra is used. With one instruction, the roots and divisions of a
rotation wait for each other, and a frame takes 1.7 times as long. A particle that converges before
the others of its group is left unchanged in its lane, so that results are bit-identical to those of
one particle at a time.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.matrices import signed_polar
from gf_usd.physics.laws.simd3x3 import (
    assign,
    at,
    cofactor,
    determinant,
    let,
    product,
    put,
    transposed,
    unrolled,
)
from gf_usd.physics.per_particle import NEWTON, SETTLED, root
from gf_usd.physics.taichi_arrays import aligned, on_arrays
from gf_usd.system.taichi_runtime import ensure_running, import_taichi

ti = import_taichi()

LANES = 8
SWEEPS = 6  # Jacobi sweeps: quadratic convergence reaches f64 precision earlier
Lanes = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)


def to_lanes(values: Floats) -> NDArray[np.float64]:
    """(k G, LANES) of k values per particle (N, ...): value a of group g is in row a G + g.

    The last group is padded with the last particle.
    """
    count, width = len(values), int(np.prod(values.shape[1:]))
    groups = -(-count // LANES)
    lanes = aligned(width * groups, LANES)
    wide = lanes.reshape(width, LANES * groups)
    wide[:, :count] = values.reshape(count, width).T
    wide[:, count:] = wide[:, count - 1 : count]
    return lanes


def from_lanes(lanes: Floats, count: int, *shape: int) -> NDArray[np.float64]:
    """(N, ...) the inverse of `to_lanes`."""
    width = int(np.prod(shape))
    wide = lanes.reshape(width, lanes.size // width)[:, :count]
    return np.ascontiguousarray(wide.T).reshape(count, *shape)


def carry(
    F: Floats, count: int, given: Sequence[Floats], R: Floats | None = None
) -> tuple[NDArray[np.float64], ...]:
    """R, axes, quaternions and scales of Gaussians after a frame, in the layout of `to_lanes`.

    F : (9 G, LANES) of `count` particles; given : Q0 diag(s0), and the rotations, axes and
    quaternions of the previous frame; R : nearest rotations of F; None: they are computed.

    Newton's iteration Q <- (Q + Q^-T) / 2 (Higham 1986) is several times as fast as the SVD, which
    is used where F is inverted or nearly singular.
    """
    ensure_running()
    groups = len(F) // 9
    made, done = tuple(aligned(k * groups, LANES) for k in (9, 9, 4, 3)), aligned(groups, LANES)
    if not groups:
        return made
    done[...] = 1.0
    if R is not None:
        made[0][...] = R
    _carry(F, *given, *made, done, groups, R is not None)
    left = np.flatnonzero(done.reshape(-1)[:count] == 0.0)
    if len(left):
        own = [_of(a, left, groups) for a in (F, *given)]
        fixed = to_lanes(signed_polar(from_lanes(own[0], len(left), 3, 3)))
        for whole, part in zip(made, carry(own[0], len(left), own[1:], fixed)):
            wide = whole.reshape(len(whole) // groups, -1)
            wide[:, left] = part.reshape(len(wide), -1)[:, : len(left)]
    return made


def _of(lanes: Floats, which: Floats, groups: int) -> NDArray[np.float64]:
    """Values of some of the particles, in separate lanes."""
    return to_lanes(lanes.reshape(len(lanes) // groups, -1)[:, which].T)


@unrolled
def numbers(array, g, groups, count):
    """`count` values of group g."""
    return let([at(array, a * groups + g) for a in range(count)])


@unrolled
def keep(array, g, groups, values):
    """Store values in the layout of `numbers`."""
    for a, value in enumerate(values):
        put(at(array, a * groups + g), value)


@on_arrays
@ti.kernel
def _carry(
    F: Lanes, rest: Lanes, turn: Lanes, axes: Lanes, last: Lanes, R: Lanes, new_axes: Lanes,
    new_last: Lanes, scales: Lanes, done: Lanes, groups: ti.i32, known: ti.i32,
):  # fmt: skip
    """Advance `gaussians.GaussianTrack` by a frame; turn, axes and last are its state.

    rest : Q0 diag(s0); R : rotations of F, the next turn, given where `known`, and otherwise valid
    where done is still 1.
    """
    for g in range(groups):
        G = numbers(F, g, groups, 9)
        Q = numbers(F, g, groups, 9)
        if known == 1:
            assign(Q, numbers(R, g, groups, 9))
        else:
            done[g] = polar(Q)
            keep(R, g, groups, Q)
        turned = product(Q, transposed(numbers(turn, g, groups, 9)))
        start = product(turned, numbers(axes, g, groups, 9))
        A = product(G, numbers(rest, g, groups, 9))
        B = product(transposed(start), A)
        S = product(B, transposed(B))
        spin = diagonalize(S)
        final = product(start, spin)
        keep(new_axes, g, groups, final)
        q = quaternion(final)
        keep_gaussian(new_last, scales, numbers(last, g, groups, 4), g, groups, S, q)


@ti.func
def polar(Q: ti.template()):
    """Replace Q by the rotation of its polar decomposition, in place; 1 in the converged lanes."""
    J = determinant(Q, cofactor(Q))
    found = J * 0.0
    active = ti.select(J > 0.0, found + 1.0, found)
    step = 0
    while step < NEWTON and active.max() > 0.0:
        C = cofactor(Q)
        change = newton(Q, C, determinant(Q, C), active)
        settled = ti.select(change < SETTLED, active, 0.0 * active)
        found = found + settled
        active = active - settled
        step += 1
    return found


@unrolled
def newton(Q, C, J, active):
    """Q <- (Q + C / J) / 2 in active lanes; the largest change of an entry."""
    half, active, largest = let(0.5 / J), let(active > 0.0), None
    for a in range(9):
        new = let(0.5 * Q[a] + half * C[a])
        change = magnitude(new - Q[a])
        largest = let(change if largest is None else ti.max(largest, change))
        put(Q[a], ti.select(active, new, Q[a]))
    return largest


@unrolled
def magnitude(x):
    """|x|."""
    x = let(x)
    return ti.max(x, 0.0 - x)


@ti.func
def diagonalize(S: ti.template()):
    """S <- Q^T S Q, diagonal, for a symmetric S of which the upper half is used and modified.

    Returns Q, det Q = 1, near the identity: cyclic rotations (Jacobi 1846).
    """
    Q = identity(S[0])
    # An off-diagonal entry below rounding is noise and must not cause a rotation.
    least = 1e-14 * ti.max(S[0] + S[4] + S[8], 1e-300)
    sweep = 0
    moved = 1
    while sweep < SWEEPS and moved == 1:
        moved = 0
        for a, b in ti.static(((0, 1), (0, 2), (1, 2))):
            large = ti.select(magnitude(S[3 * a + b]) > least, 0.0 * least + 1.0, 0.0 * least)
            if large.max() > 0.0:
                moved = 1
                turn_plane(S, Q, a, b, large)
        sweep += 1
    return Q


@unrolled
def identity(like):
    """The unit matrix in lanes of the type of `like`."""
    zero = let(0.0 * like)
    return [let(zero + 1.0 if a % 4 == 0 else zero) for a in range(9)]


@unrolled
def turn_plane(S, Q, a, b, where):
    """Make S_ab zero by a rotation of at most 45 degrees in the plane of a < b, in lanes with
    `where` > 0.
    """
    where, off = let(where > 0.0), let(S[3 * a + b])
    tau = let((S[4 * b] - S[4 * a]) / (2.0 * off))
    sign = ti.select(tau >= 0.0, 0.0 * off + 1.0, 0.0 * off - 1.0)
    t = let(sign / (magnitude(tau) + ti.sqrt(1.0 + tau * tau)))
    c = let(1.0 / ti.sqrt(1.0 + t * t))
    s = let(t * c)
    put(S[4 * a], ti.select(where, S[4 * a] - t * off, S[4 * a]))
    put(S[4 * b], ti.select(where, S[4 * b] + t * off, S[4 * b]))
    put(S[3 * a + b], ti.select(where, 0.0 * off, off))
    other = 3 - a - b
    places = [(3 * min(a, other) + max(a, other), 3 * min(b, other) + max(b, other))]
    for M, first, second in (
        *((S, i, j) for i, j in places),
        *((Q, 3 * i + a, 3 * i + b) for i in range(3)),
    ):
        x, y = let(M[first]), let(M[second])
        put(M[first], ti.select(where, c * x - s * y, x))
        put(M[second], ti.select(where, s * x + c * y, y))


@unrolled
def quaternion(R):
    """Unit quaternion [w, x, y, z] of a rotation R."""
    a, b, c = R[0], R[4], R[8]
    wx, wy, wz = R[7] - R[5], R[2] - R[6], R[3] - R[1]
    xy, xz, yz = R[3] + R[1], R[2] + R[6], R[7] + R[5]
    # The largest of four squared components is at least a quarter: divide by that one.
    q = let([1 + a + b + c, wx, wy, wz])
    most = q[0]
    for k, row in enumerate(
        (
            [wx, 1 + a - b - c, xy, xz],
            [wy, xy, 1 - a + b - c, yz],
            [wz, xz, yz, 1 - a - b + c],
        ),
        1,
    ):
        row = let(row)
        larger = let(row[k] > most)
        most = let(ti.select(larger, row[k], most))
        q = [let(ti.select(larger, row[i], q[i])) for i in range(4)]
    length = let(ti.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]))
    return [one / length for one in q]


@unrolled
def keep_gaussian(new_last, scales, last, g, groups, S, q):
    """Store the square roots of S_aa, and of q and -q, which are the same rotation, the one nearer
    to the previous one.
    """
    q = let(q)
    for a in range(3):
        put(at(scales, a * groups + g), root(S[4 * a]))
    along = q[0] * last[0]
    for a in range(1, 4):
        along = along + q[a] * last[a]
    along = let(along)
    sign = let(ti.select(along < 0.0, 0.0 * along - 1.0, 0.0 * along + 1.0))
    for a in range(4):
        put(at(new_last, a * groups + g), sign * q[a])

"""Deformed Gaussians as orientation and scale, continuous in time.

A Gaussian rides as Sigma = F Sigma0 F^T (GaussianFlesh section 3.1).  USD stores it as a rotation Q
and standard deviations s, Sigma = Q diag(s^2) Q^T, which leaves axes that may swap and flip from
frame to frame; a client that interpolates would then show a spinning needle.  So each frame starts
from the last one's axes turned by the body's own rotation and turns them no further than it must:
cyclic Jacobi rotations of at most 45 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gf_usd.model import Floats, GaussianPose, Pose
from gf_usd.physics import many
from gf_usd.physics.cofactor import cofactors, entries

CHUNK = 4096  # particles at once: what is made on the way stays in a core's cache
NEWTON = 12  # steps of the polar iteration, enough for stretches of 1/100 to 100
SETTLED = 1e-9  # change after which an iterate is exact to rounding
SWEEPS = 6  # Jacobi converges quadratically: f64 digits are used up well before


class GaussianTrack:
    """Turns poses into Gaussians, one frame after another.

    rest_orientation : (N, 4) (w, x, y, z); rest_scale : (N, 3) [m].
    """

    def __init__(self, rest_orientation: Floats, rest_scale: Floats) -> None:
        self._axes = matrix_from_quaternion(rest_orientation)
        self._rest = self._axes * np.asarray(rest_scale, float)[:, None, :]  # Q0 diag(s0)
        self._turn = np.broadcast_to(np.eye(3), self._rest.shape)
        self._last = np.asarray(rest_orientation, float)

    @property
    def turn(self) -> NDArray[np.float64]:
        """(N, 3, 3) rotation of the body at the last pose."""
        return self._turn

    def state(self) -> dict[str, Floats]:
        """What the next frame starts from: axes and turn (N, 3, 3), quaternions (N, 4)."""
        return {"axes": self._axes, "turn": np.array(self._turn), "last": self._last}

    def recall(self, state: Mapping[str, Floats]) -> None:
        """Go on from `state`."""
        self._axes, self._turn, self._last = state["axes"], state["turn"], state["last"]

    def advance(self, pose: Pose) -> GaussianPose:
        """The Gaussians at a pose; call once a frame, in order."""
        R = nearest_rotation(pose.F)
        one = many.carried if many.serves(len(R)) else carried
        self._axes, q, s = one(pose.F, self._rest, R, self._turn, self._axes, self._last)
        self._turn, self._last = R, q
        return GaussianPose(positions=pose.x, velocities=pose.v, orientations=q, scales=s)


def carried(
    F: Floats, rest: Floats, R: Floats, turn: Floats, axes: Floats, last: Floats
) -> tuple[Floats, Floats, Floats]:
    """See `many.carried`."""
    start = R @ np.swapaxes(turn, 1, 2) @ axes
    B = np.swapaxes(start, 1, 2) @ (F @ rest)
    S, spin = jacobi(B @ np.swapaxes(B, 1, 2))
    axes = start @ spin
    q = quaternion_from_matrix(axes)
    q *= np.where((q * last).sum(1, keepdims=True) < 0.0, -1.0, 1.0)
    return axes, q, np.sqrt(np.maximum(np.einsum("naa->na", S), 0.0))


def nearest_rotation(F: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) R of the polar decomposition with det R = 1: that of the signed SVD.

    By Newton's iteration Q <- (Q + Q^-T) / 2 (Higham 1986), several times as fast; by the SVD
    itself where F is inverted, or so flat that the iteration would take long.
    """
    F = np.asarray(F, float)
    if many.serves(len(F)):
        out, done = many.rotations(F)
        if not done.all():
            out[~done] = _signed_svd(F[~done])
        return out
    out = np.empty(F.shape)
    for k in range(0, len(F), CHUNK):
        some = slice(k, k + CHUNK)
        out[some], done = _newton(F[some])
        if not done.all():
            out[some][~done] = _signed_svd(F[some][~done])
    return out


def _newton(F: Floats) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Iterates (n, 3, 3), and which of them (n,) are rotations to rounding."""
    q = entries(F)
    upright = done = np.linalg.det(F) > 0.0
    hopeless = ~upright
    with np.errstate(all="ignore"):  # what comes to nothing goes to the SVD
        for _ in range(NEWTON):
            new = cofactors(q)
            new /= q[0] * new[0] + q[1] * new[1] + q[2] * new[2]
            new += q
            new *= 0.5
            # The error of an iterate is the square of its change.
            q -= new
            done = np.abs(q, out=q).max(0) < SETTLED
            q = new
            if (done | hopeless).all():
                break
    return q.T.reshape(-1, 3, 3), done & upright


def _signed_svd(F: Floats) -> NDArray[np.float64]:
    U, _, Vt = np.linalg.svd(F)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    return U @ Vt


def jacobi(S: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Diagonalise symmetric S (N, 3, 3): returns Q^T S Q and Q, det Q = 1, Q near the identity."""
    # Entry by entry over all matrices: products of 3x3 matrices would cost several times as much.
    s = np.array(np.asarray(S, float).transpose(1, 2, 0), order="C")
    q = np.zeros(s.shape)
    q.reshape(9, -1)[::4] = 1.0
    # Below rounding an off-diagonal says nothing, and turning by it would be noise.
    scale = 1e-14 * np.maximum(s[0, 0] + s[1, 1] + s[2, 2], 1e-300)
    for _ in range(SWEEPS):
        moved = False
        for a, b, other in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            active = np.abs(s[a, b]) > scale
            if not active.any():
                continue
            moved = True
            off = np.where(active, s[a, b], 1.0)
            tau = (s[b, b] - s[a, a]) / (2.0 * off)
            t = np.where(tau >= 0.0, 1.0, -1.0) / (np.abs(tau) + np.sqrt(1.0 + tau * tau))
            t *= active
            cosine = 1.0 / np.sqrt(1.0 + t * t)
            sine = t * cosine
            off *= t
            s[a, a] -= off
            s[b, b] += off
            s[a, b] = s[b, a] = np.where(active, 0.0, s[a, b])
            first, second = s[a, other], s[b, other]
            s[a, other], s[b, other] = (
                cosine * first - sine * second,
                sine * first + cosine * second,
            )
            s[other, a], s[other, b] = s[a, other], s[b, other]
            first, second = q[:, a], q[:, b]
            q[:, a], q[:, b] = cosine * first - sine * second, sine * first + cosine * second
        if not moved:
            break
    return s.transpose(2, 0, 1), q.transpose(2, 0, 1)


def matrix_from_quaternion(q: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) rotation of unit quaternions (N, 4), (w, x, y, z)."""
    w, x, y, z = np.asarray(q, float).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )


def quaternion_from_matrix(R: Floats) -> NDArray[np.float64]:
    """(N, 4) unit quaternion (w, x, y, z) of rotations (N, 3, 3)."""
    r = entries(R)
    a, b, c = r[::4]
    # 4 q q^T.  The largest of four squared components is at least a quarter: divide by that one.
    products = np.empty((4, 4, len(R)))
    for k, square in enumerate((1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c)):
        products[k, k] = square
    products[0, 1:] = products[1:, 0] = r[[7, 2, 3]] - r[[5, 6, 1]]
    products[1, 2:] = products[2:, 1] = r[[3, 2]] + r[[1, 6]]
    products[2, 3] = products[3, 2] = r[7] + r[5]
    products *= 0.25
    largest = products.reshape(16, -1)[::5].argmax(0)
    q = products[largest, :, np.arange(len(R))]
    return q / np.linalg.norm(q, axis=1, keepdims=True)

"""Deformed Gaussians as orientation and scale, continuous in time; Gaussians of a capture.

A Gaussian deforms as Sigma = F Sigma0 F^T (GaussianFlesh section 3.1). USD stores a rotation Q and
standard deviations s, Sigma = Q diag(s^2) Q^T, whose axes may be permuted or flipped between
frames, so that interpolation in a client would show spurious rotations. Each frame therefore starts
from the axes of the previous one, rotated with the body, and diagonalizes by the least rotation:
cyclic Jacobi rotations of at most 45 degrees.

A captured Gaussian at X with Sigma0 and radiance coefficients h becomes

    x,    F Sigma0 F^T,    D(R) h,    F = R U

(PhysGaussian, section 3.3): its radiance rotates with the body. This is done in the space of the
Gaussians' own prim, with L the linear map from there to the world: F_local = L(t)^-1 F L(0).

A Gaussian too far from the body to be in its grid moves rigidly with the nearest point that is: x =
x_a + R (X - X_a).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import SplatPose, Splats
from gf_usd.core.frames.frame import GaussianPose, Pose
from gf_usd.core.matrices import matrix_from_quaternion
from gf_usd.physics.output.gaussian_kernels import carry, from_lanes, to_lanes
from gf_usd.physics.per_particle import nearest_rotation, rotated


class GaussianTrack:
    """Converts poses to Gaussians, one frame after another.

    rest_orientation : (N, 4) (w, x, y, z); rest_scale : (N, 3) [m].
    """

    def __init__(self, rest_orientation: Floats, rest_scale: Floats) -> None:
        axes = matrix_from_quaternion(rest_orientation)
        self._count = len(axes)
        self._rest = to_lanes(axes * np.asarray(rest_scale, float)[:, None, :])  # Q0 diag(s0)
        turn = np.broadcast_to(np.eye(3), axes.shape)
        self._lanes = tuple(to_lanes(a) for a in (turn, axes, np.asarray(rest_orientation, float)))

    @property
    def turn(self) -> NDArray[np.float64]:
        """(N, 3, 3) rotation of the body at the last pose."""
        return from_lanes(self._lanes[0], self._count, 3, 3)

    def state(self) -> dict[str, Floats]:
        """The state from which the next frame starts: axes and turn (N, 3, 3), quaternions
        (N, 4).
        """
        _, axes, last = self._lanes
        return {
            "axes": from_lanes(axes, self._count, 3, 3),
            "turn": self.turn,
            "last": from_lanes(last, self._count, 4),
        }

    def load(self, state: Mapping[str, Floats]) -> None:
        """Restore `state`."""
        self._lanes = tuple(to_lanes(state[name]) for name in ("turn", "axes", "last"))

    def advance(self, pose: Pose) -> GaussianPose:
        """The Gaussians at a pose; call once a frame, in order."""
        *self._lanes, scales = carry(to_lanes(pose.F), self._count, (self._rest, *self._lanes))
        return GaussianPose(
            positions=pose.x,
            velocities=pose.v,
            orientations=from_lanes(self._lanes[2], self._count, 4),
            scales=from_lanes(scales, self._count, 3),
        )


STRETCH = (
    4.0  # bound of the growth beyond the longest, and the decrease below the shortest rest axis
)


class CarriedSplats:
    """Converts poses of embedded points to Gaussians, one frame after another.

    splats : at rest.
    """

    def __init__(self, splats: Splats) -> None:
        self.splats = splats
        self._linear = splats.to_world[:3, :3].T
        self._track = GaussianTrack(splats.orientations, splats.scales)
        scales = np.asarray(splats.scales, float)
        self._least = scales.min(axis=1, keepdims=True) / STRETCH
        self._most = scales.max(axis=1, keepdims=True) * STRETCH
        arm = splats.points - splats.embedded_points
        self._hanging = np.flatnonzero((arm != 0.0).any(axis=1))
        self._arm = arm[self._hanging]
        self._colors = splats.degree > 0
        self.clamped = 0  # number of clamped Gaussians, summed over the frames

    def state(self) -> dict[str, Floats]:
        """The state from which the next frame starts: that of `GaussianTrack`, and the
        clamp count.
        """
        return {**self._track.state(), "clamped": np.array([self.clamped])}

    def load(self, state: Mapping[str, Floats]) -> None:
        """Restore `state`."""
        self._track.load(state)
        self.clamped = int(state["clamped"][0])

    def advance(self, pose: Pose, to_local: Floats) -> SplatPose:
        """The Gaussians at a pose of the anchors; call once a frame, in order.

        to_local : (3, 3) L(t)^-1 [local units per m], for column vectors.
        """
        x = pose.x
        if len(self._hanging):
            turn = nearest_rotation(pose.F[self._hanging])
            x = x.copy()
            x[self._hanging] += np.einsum("nab,nb->na", turn, self._arm)
        local = replace(pose, F=to_local @ pose.F @ self._linear)
        made = self._track.advance(local)
        scales = np.clip(made.scales, self._least, self._most)
        # not counted within rounding
        self.clamped += int((np.abs(scales - made.scales) > 1e-9 * self._most).any(axis=1).sum())
        harmonics = None
        if self._colors:
            harmonics = rotated(self.splats.harmonics, self._track.turn)
        return SplatPose(
            positions=x, orientations=made.orientations, scales=scales, harmonics=harmonics
        )

"""Captured Gaussians on a deforming body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from captures import ball
from scipy.spatial.transform import Rotation

from gf_usd.core.asset import Splats
from gf_usd.core.frames.frame import Pose
from gf_usd.core.matrices import gaussian_axes
from gf_usd.core.radiance import basis
from gf_usd.physics.output.gaussians import STRETCH, CarriedSplats

SINGLE = 1e-6  # the captures are float32
TURNED = 3e-6  # coefficients of size 1, turned by a kernel in single precision


def pose(x, F):
    return Pose(x=x, v=np.zeros_like(x), F=np.broadcast_to(F, (len(x), 3, 3)))


def covariance(made):
    axes = gaussian_axes(made.orientations, made.scales)
    return axes @ np.swapaxes(axes, 1, 2)


def test_at_rest_nothing_changes():
    rest = ball(50, degree=3)
    made = CarriedSplats(rest).advance(pose(rest.points, np.eye(3)), np.eye(3))
    np.testing.assert_allclose(made.positions, rest.positions)
    np.testing.assert_allclose(made.scales, rest.scales, rtol=SINGLE)
    np.testing.assert_allclose(made.orientations, rest.orientations, atol=SINGLE)
    np.testing.assert_allclose(made.harmonics, rest.harmonics, atol=TURNED)


def test_covariances_go_with_F():
    rest = ball(60)
    F = np.array([[1.3, 0.2, 0.0], [-0.1, 0.8, 0.3], [0.0, 0.1, 1.1]])
    made = CarriedSplats(rest).advance(pose(rest.points @ F.T, F), np.eye(3))
    expected = F @ rest.axes @ np.swapaxes(rest.axes, 1, 2) @ F.T
    np.testing.assert_allclose(covariance(made), expected, atol=SINGLE * expected.max())
    assert made.harmonics is None


def test_radiance_turns_with_the_body():
    """c'(d) = c(R^T d) with the rotation of F, whatever it stretches."""
    rest = ball(30, degree=3)
    R = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    stretch = np.array([[1.2, 0.1, 0.0], [0.1, 0.9, 0.05], [0.0, 0.05, 1.0]])
    F = R @ stretch
    made = CarriedSplats(rest).advance(pose(rest.points @ F.T, F), np.eye(3))
    for d in np.eye(3):
        seen = np.einsum("k,nkc->nc", basis(d[None])[0], made.harmonics)
        before = np.einsum("k,nkc->nc", basis((R.T @ d)[None])[0], rest.harmonics)
        np.testing.assert_allclose(seen, before, atol=TURNED)


def placed(rest: Splats, linear: np.ndarray) -> Splats:
    """The capture on a prim whose local-to-world map has this linear part (columns)."""
    matrix = np.eye(4)
    matrix[:3, :3] = linear.T
    matrix[3, :3] = [3.0, -1.0, 2.0]
    return replace(rest, to_world=matrix)


@pytest.mark.parametrize(
    "linear",
    [
        2.0 * Rotation.from_euler("xyz", [1.0, 0.3, -0.5]).as_matrix(),
        np.diag([1.0, 2.0, 0.5]) @ Rotation.from_euler("x", 0.7).as_matrix(),
        np.diag([-1.0, 1.0, 1.0]),
    ],
    ids=["turned and scaled", "sheared", "mirrored"],
)
def test_what_counts_is_the_world(linear):
    """In the prim's space the result is L^-1 of what happens in the world."""
    rest = placed(ball(40), linear)
    F = np.array([[1.1, 0.3, 0.0], [0.0, 0.9, 0.1], [0.2, 0.0, 1.0]])
    to_local = np.linalg.inv(linear)
    made = CarriedSplats(rest).advance(pose(rest.points, F), to_local)
    world = linear @ covariance(made) @ linear.T
    expected = F @ rest.axes @ np.swapaxes(rest.axes, 1, 2) @ F.T
    np.testing.assert_allclose(world, expected, atol=SINGLE * expected.max())


def test_a_prim_that_moves_under_its_gaussians():
    """Where only the prim turns and the body does not, the local Gaussians turn back."""
    rest = placed(ball(40, degree=1), np.eye(3))
    turn = Rotation.from_euler("z", 0.6).as_matrix()
    made = CarriedSplats(rest).advance(pose(rest.points, np.eye(3)), turn.T)
    world = turn @ covariance(made) @ turn.T
    expected = rest.axes @ np.swapaxes(rest.axes, 1, 2)
    np.testing.assert_allclose(world, expected, atol=SINGLE * expected.max())
    d = np.array([0.0, 0.6, 0.8])
    seen = np.einsum("k,nkc->nc", basis((turn.T @ d)[None])[0][:4], made.harmonics)
    before = np.einsum("k,nkc->nc", basis(d[None])[0][:4], rest.harmonics)
    np.testing.assert_allclose(seen, before, atol=TURNED)


def test_needles_are_clamped_and_counted():
    rest = ball(40)
    carried = CarriedSplats(rest)
    F = np.diag([1000.0, 1.0, 1e-9])
    for _ in range(2):
        made = carried.advance(pose(rest.points, F), np.eye(3))
    assert carried.clamped == 80
    least, most = rest.scales.min(axis=1), rest.scales.max(axis=1)
    assert (made.scales <= (STRETCH * most)[:, None] * (1 + SINGLE)).all()
    assert (made.scales >= (least / STRETCH)[:, None] * (1 - SINGLE)).all()
    assert (np.linalg.eigvalsh(covariance(made)) > 0.0).all()


def test_a_body_turned_inside_out_still_has_gaussians():
    rest = ball(40, degree=2)
    made = CarriedSplats(rest).advance(pose(rest.points, np.diag([1.0, -0.5, 1.0])), np.eye(3))
    assert np.isfinite(made.harmonics).all()
    assert (made.scales > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(made.orientations, axis=1), 1.0)


def test_orientations_do_not_flip():
    """Half a turn in small steps: each quaternion is near the one before."""
    rest = ball(40)
    carried = CarriedSplats(rest)
    last = rest.orientations
    for angle in np.linspace(0.0, np.pi, 30):
        R = Rotation.from_euler("y", angle).as_matrix()
        made = carried.advance(pose(rest.points @ R.T, R), np.eye(3))
        # the step is pi / 29, of which a quaternion has half
        assert (np.linalg.norm(made.orientations - last, axis=1) < 0.06).all()
        last = made.orientations


def test_strays_hang_stiffly_on_their_carriers():
    rest = ball(40)
    anchors = rest.points.copy()
    anchors[:2] = [0.0, 0.0, 0.0]
    rest = replace(rest, anchors=anchors)
    R = Rotation.from_euler("x", 1.0).as_matrix()
    F = R @ np.diag([2.0, 1.0, 0.5])
    at = rest.embedded_points @ F.T + [0.0, 5.0, 0.0]
    made = CarriedSplats(rest).advance(pose(at, F), np.eye(3))
    np.testing.assert_allclose(made.positions[2:], at[2:])
    arm = rest.points[:2]
    np.testing.assert_allclose(made.positions[:2], [0.0, 5.0, 0.0] + arm @ R.T, atol=SINGLE)

"""Flowing particles below everything, and the volume of the others."""

from __future__ import annotations

import numpy as np
import pytest
from solids import settings

from gf_usd.core.frames.frame import Pose
from gf_usd.core.stage import Collider, ContactSetup
from gf_usd.physics.updated_lagrangian.energies import Losses

H = 0.1  # [m] edge of a cell
Y = np.array([0.5, -0.09, -0.11, -7.0])  # [m] heights of four particles
TURN = np.tile(np.eye(3), (4, 1, 1))
POSE = Pose(x=np.stack([0.0 * Y, Y, 0.0 * Y], 1), v=np.tile([0.0, -3.0, 4.0], (4, 1)), F=TURN)
M, V0 = np.array([1.0, 2.0, 4.0, 8.0]), np.array([1.0, 3.0, 1.0, 1.0])
J = np.array([0.8, 1.0, 9.0, 9.0])
DOWN = (0.0, -9.81, 0.0)
FLOWING = np.array([True, True, True, False])


def plate(shape: str) -> Collider:
    """Sinks from -5 m to -6 m."""
    points = np.array([[-1.0, -5.0, -1.0], [1.0, -5.0, -1.0], [0.0, -5.0, 1.0]])
    return Collider(
        path="/Plate", shape=shape, points=points, triangles=np.array([[0, 2, 1]]),
        linear=np.tile(np.eye(3), (2, 1, 1)), offset=np.array([[0.0] * 3, [0.0, -1.0, 0.0]]),
    )  # fmt: skip


def test_a_particle_is_lost_a_cell_below_the_floor() -> None:
    seen = Losses(settings(floor=0.0), None, H, FLOWING).measured(POSE, M, V0, J)
    assert seen["lost"] == 1, "the last is solid, and the one before within a cell"
    assert seen["fallen_kinetic"] == pytest.approx(0.5 * 4.0 * 25.0)
    assert seen["flow_volume"] == pytest.approx((0.8 + 3.0) / 4.0)
    assert seen["flow_per_cell"] == 1.0, "one above the floor, one below"


def test_particles_are_counted_by_the_cells_that_have_any() -> None:
    x = np.array([[0.01, 0.01, 0.01], [0.02, 0.05, 0.09], [0.11, 0.0, 0.0], [0.01, 0.0, 0.0]])
    pose = Pose(x=x, v=np.zeros((4, 3)), F=TURN)
    seen = Losses(settings(floor=None), None, H, FLOWING).measured(pose, M, V0, J)
    assert seen["flow_per_cell"] == 1.5


def test_without_a_floor_it_is_lost_below_where_obstacles_come_to() -> None:
    flowing = np.full(4, True)
    setup = ContactSetup(skins=(), colliders=(plate("mesh"),))
    assert (
        Losses(settings(floor=None, gravity=DOWN), setup, H, flowing).measured(POSE, M, V0, J)[
            "lost"
        ]
        == 1
    )
    endless = ContactSetup(skins=(), colliders=(plate("mesh"), plate("plane")))
    assert (
        Losses(settings(floor=None, gravity=DOWN), endless, H, flowing).measured(POSE, M, V0, J)[
            "lost"
        ]
        == 0
    )


def test_without_anything_below_nothing_is_lost_and_solids_are_not_counted() -> None:
    assert (
        Losses(settings(floor=None, gravity=DOWN), None, H, FLOWING).measured(POSE, M, V0, J)[
            "lost"
        ]
        == 0
    )
    assert Losses(settings(floor=0.0), None, H, ~np.full(4, True)).measured(POSE, M, V0, J) == {}

"""Jumps of an animation, as at a cut."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Bone, Skeleton
from gf_usd.prepare.bodies.flesh.jumps import jump_notes

FRAMES, LEAD = 40, 10
TIMES = np.arange(FRAMES) + 1001.0 - LEAD


def skeleton(path: Floats) -> Skeleton:
    """Five joints 0.5 m apart that move together along path (F, 3) [m]."""
    corners = 0.5 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    bones = []
    for k in range(5):
        anchors = corners + (0.0, 0.5 * k, 0.0)
        bones.append(
            Bone(
                name=f"/A:J{k}", segments=np.zeros((0, 2, 3)), free=(), anchors=anchors,
                path=anchors + path[:, None],
            )
        )  # fmt: skip
    return Skeleton(bones=tuple(bones))


def run(speed: float) -> Floats:
    """[m] a run along x, `speed` a frame."""
    return np.arange(FRAMES)[:, None] * np.array([speed, 0.0, 0.0])


@pytest.mark.parametrize("speed", [0.0, 0.02, 0.6])
def test_steady_motion_does_not_jump(speed: float) -> None:
    assert jump_notes(skeleton(run(speed)), TIMES, LEAD) == ()


def test_a_fast_start_and_the_way_into_the_first_pose_are_no_jumps() -> None:
    path = run(0.0)
    path[LEAD:, 0] += 3.0  # before the animation
    path[20:, 0] += 0.2 * np.arange(20) ** 2  # at constant acceleration
    assert jump_notes(skeleton(path), TIMES, LEAD) == ()


def test_a_cut_is_named_with_the_ranges_that_avoid_it() -> None:
    path = run(0.02)
    path[20:, 2] += 1.5
    path[30:, 2] -= 1.5
    (note,) = jump_notes(skeleton(path), TIMES, LEAD)
    assert note == (
        "the animation jumps by 1.5 m between time codes 1010 and 1011, 75 times as far as in the"
        " frames beside it, and 1 more time later, which throws the flesh: bake the parts before"
        " and after a cut separately (--range :1010 and --start 1011)"
    )

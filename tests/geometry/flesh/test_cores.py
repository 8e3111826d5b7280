"""Cores around bones: how thick they are, where they end, and whose a point is."""

from __future__ import annotations

import numpy as np
import pytest
from solids import cube, solid

from gf_usd.core.stage import Bone
from gf_usd.geometry.flesh.cores import (
    CLEAR,
    MOST_CLEAR,
    WIDER,
    Core,
    _some,
    bone_cores,
    bone_pins,
)

BAR = solid(cube((0.0, -0.2, -0.2), (2.0, 0.4, 0.4)))  # 0.2 m from its axis to the skin
CELL = 0.1


def bone(name: str, *segments: tuple[float, float], free: bool = False, y: float = 0.0) -> Bone:
    ends = np.array([[(a, y, 0.0), (b, y, 0.0)] for a, b in segments])
    corners = np.vstack([np.zeros(3), np.eye(3)])
    return Bone(
        name=name, segments=ends, free=(free,) * len(segments), anchors=corners, path=corners[None]
    )


def test_depth_in_a_core_is_the_distance_to_its_side() -> None:
    core = Core(bone=0, points=np.array([[0.0, 0, 0], [1.0, 0, 0]]), radius=np.array([0.1, 0.3]))
    X = np.array([[0.5, 0.05, 0.0], [0.0, 0.0, 0.2], [1.2, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    np.testing.assert_allclose(core.depth(X), [0.15, -0.1, 0.1, 0.05], atol=1e-12)


def test_the_radius_is_a_share_of_the_way_to_the_skin_and_a_part_of_a_cell() -> None:
    cores, notes = bone_cores([bone("A", (0.5, 1.5))], BAR, 0.4, CELL)
    (core,) = cores.cores
    np.testing.assert_allclose(core.radius, 0.4 * 0.2 + WIDER * CELL, rtol=1e-6)
    assert not notes


def test_a_core_stays_clear_of_joints_but_not_of_a_free_end() -> None:
    wide = 0.4 * 0.2 + WIDER * CELL
    for free, end in ((False, 1.5 - CLEAR * wide), (True, 1.5)):
        (core,) = bone_cores([bone("A", (0.5, 1.5), free=free)], BAR, 0.4, CELL)[0].cores
        np.testing.assert_allclose(core.points[[0, -1], 0], [0.5 + CLEAR * wide, end], rtol=1e-6)
    (short,) = bone_cores([bone("A", (0.8, 1.1))], BAR, 0.4, CELL)[0].cores
    np.testing.assert_allclose(
        short.points[[0, -1], 0], [0.8 + MOST_CLEAR * 0.3, 1.1 - MOST_CLEAR * 0.3], rtol=1e-6
    )


def test_a_point_in_two_cores_is_that_of_the_deeper_one() -> None:
    cores, _ = bone_cores([bone("A", (0.4, 1.0)), bone("B", (1.0, 1.6))], BAR, 1.0, CELL)
    X = np.array([[0.95, 0.01, 0.0], [1.05, 0.01, 0.0], [1.0, 0.9, 0.0]])
    assert cores.owner(X).tolist() == [0, 1, -1]


def test_a_bone_outside_holds_nothing_and_a_thin_limb_moves_with_its_bone() -> None:
    bones = [bone("out", (0.5, 1.5), y=0.5), bone("in", (0.5, 1.5))]
    cores, notes = bone_cores(bones, BAR, 0.2, 0.5)
    assert "out: outside the flesh" in notes[0]
    assert "in: the flesh around it is too thin for the grid, which has cells of 50 cm" in notes[1]
    (pin,) = bone_pins(bones, cores)
    assert pin.name == "in"
    assert not pin.sharp
    # 0.2 of 0.2 m, and 0.71 cells
    assert pin.inside(np.array([[1.0, 0.39, 0.0], [1.0, 0.4, 0.0]])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["medial:3", "medial:4"], "medial:3, medial:4"),
        (["/Hero/Rig:hips", "/Hero/Rig:hips/spine/head"], "hips, head"),
        ([f"/Hero/Rig:hips/tail{k}" for k in range(5)], "tail0, tail1, tail2 and 2 more bones"),
        (["/A/Rig:hips", "/B/Rig:hips"], "/A/Rig:hips, /B/Rig:hips"),
    ],
)
def test_bones_are_named_by_their_joints_where_these_differ(names: list[str], text: str) -> None:
    assert _some(names) == text

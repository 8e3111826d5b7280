"""Bones of a skeleton, against UsdSkel's own skinning of the points they carry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from arm import (
    BOOT_CORNERS,
    BOOT_FACES,
    FIRST,
    LAST,
    WIDTH,
    arm,
    bound_mesh,
    captured,
    points,
    skinned,
    write,
)
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.core.errors import InputError
from gf_usd.core.stage import Bone
from gf_usd.physics.grid.pins import Motion
from gf_usd.readers import read_asset
from gf_usd.readers.usd.skeleton.bones import (
    animation_range,
    lone_skeleton,
    read_skeleton,
    skeletons,
)

EPS = 2e-6  # float32 points and quaternions of order 1


def bones_of(path: Path, times: Sequence[float], first: float = FIRST) -> tuple[Bone, ...]:
    facts = read_asset(path).facts
    return read_skeleton(path, ["/Arm/Skin"], facts, first=first, times=times).bones


def test_segments_lie_in_the_bind_pose_and_the_last_one_goes_into_the_flesh(tmp_path: Path) -> None:
    upper, lower = bones_of(write(tmp_path, arm()), [FIRST])
    assert upper.name == "/Arm/Skel:A"
    assert upper.free == (False,)
    np.testing.assert_allclose(upper.segments, [[[0, 0, 0], [1, 0, 0]]], atol=EPS)
    assert lower.free == (True,)
    ((start, end),) = lower.segments
    np.testing.assert_allclose(start, [1, 0, 0], atol=EPS)
    np.testing.assert_allclose(end[1:], 0.0, atol=EPS)
    assert 1.5 < end[0] < 2.0  # most of the way to the tip


def test_flesh_before_the_last_joint_does_not_shorten_its_segment(tmp_path: Path) -> None:
    """The points of B begin at 1.25, before the joint; their mean is 1.625, also before it."""
    bind = "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1.7, 0, 0, 1) )"
    _, lower = bones_of(write(tmp_path, arm(bind=bind)), [FIRST])
    ((start, end),) = lower.segments
    np.testing.assert_allclose(start, [1.7, 0, 0], atol=EPS)
    # 1.5 times as far as the mean of the rings at 1.75, with 0.4 m^2 of the surface around it, and
    # at 2.0, with 0.2 m^2 and the end of the arm
    mean = (1.75 * 0.4 + 2.0 * (0.2 + WIDTH**2)) / (0.4 + 0.2 + WIDTH**2)
    np.testing.assert_allclose(end, [1.7 + 1.5 * (mean - 1.7), 0, 0], atol=EPS)


def test_the_last_segment_of_a_slender_limb_ends_half_its_width_before_the_tip(
    tmp_path: Path,
) -> None:
    """The fin of a fish was held for 8 of its 14 cm, and its end hung down."""
    thin = """{
    double3 xformOp:scale = (1, 0.2, 0.2)
    uniform token[] xformOpOrder = ["xformOp:scale"]
"""
    _, lower = bones_of(write(tmp_path, arm().replace("{", thin, 1)), [FIRST])
    # the corners of a square section are half a diagonal from the axis
    assert lower.segments[0, 1, 0] == pytest.approx(2.0 - 0.2 * WIDTH * 0.5**0.5, abs=EPS)


def test_corners_that_are_repeated_for_each_face_do_not_turn_a_segment(tmp_path: Path) -> None:
    """The bone in the head of RiggedFigure, a box, ran to the corners with the most points, and the
    head hung from it by 25 degrees.
    """
    path = write(tmp_path, arm())
    shared = bones_of(path, [FIRST])
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Arm/Skin"))
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get())
    repeated = np.flatnonzero(corners % 4 == 2)  # those of one of the four edges along the arm
    of_point = np.concatenate([np.arange(len(points())), corners[repeated]])
    corners[repeated] = len(points()) + np.arange(len(repeated))
    mesh.GetPointsAttr().Set(points()[of_point].tolist())
    mesh.GetFaceVertexIndicesAttr().Set(corners.tolist())
    for name in ("jointIndices", "jointWeights"):
        values = mesh.GetPrim().GetAttribute(f"primvars:skel:{name}")
        values.Set(np.array(values.Get()).reshape(-1, 2)[of_point].ravel().tolist())
    stage.Save()
    for one, other in zip(bones_of(path, [FIRST]), shared, strict=True):
        np.testing.assert_allclose(one.segments, other.segments, atol=EPS)


def with_box(x: float) -> str:
    """The arm, and a box as wide beside its axis from x [m] on, which joint B alone carries."""
    corners = (BOOT_CORNERS - BOOT_CORNERS.min(0)) / np.ptp(BOOT_CORNERS, axis=0)
    box = WIDTH * corners + (x, 0.2, -0.5 * WIDTH)
    faces = [BOOT_FACES[k : k + 4] for k in range(0, len(BOOT_FACES), 4)]
    return arm().rstrip().removesuffix("}") + bound_mesh("Box", box, faces, [1] * 8) + "}"


def test_a_bone_does_not_leave_the_flesh_toward_a_mesh_apart_from_it(tmp_path: Path) -> None:
    """Toward a box 4 m beyond an arm of 2 m its last bone ran to 4.5 m."""
    paths = ["/Arm/Skin", "/Arm/Box"]

    def end(text: str) -> NDArray[np.float64]:
        path = write(tmp_path, text)
        facts = read_asset(path).facts
        kept = [one for one in paths if one.rsplit("/", 1)[1] in text]
        bones = read_skeleton(path, kept, facts, first=FIRST, times=[FIRST]).bones
        return bones[1].segments[0, 1]

    alone = end(arm())
    np.testing.assert_allclose(end(with_box(6.0)), alone, atol=EPS)
    # the flesh of B is 1 m long and 0.4 m wide and high: a quarter of its size is 0.29 m
    np.testing.assert_allclose(end(with_box(2.3)), alone, atol=EPS)
    assert end(with_box(2.2))[0] > alone[0] + 0.3
    assert end(with_box(1.9))[0] > alone[0] + 0.1


def test_slender_flesh_behind_a_root_has_a_bone(tmp_path: Path) -> None:
    """The head of a fish whose root joint is in its neck hung down."""
    bind = [f"( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), ({x}, 0, 0, 1) )" for x in (0.7, 1.0)]
    root = "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) )"
    text = arm(bind=bind[1])
    assert text.count(root)
    upper, _ = bones_of(write(tmp_path, text.replace(root, bind[0])), [FIRST])
    ((_, child), (start, end)) = upper.segments - upper.segments[0, 0]
    assert upper.free == (False, True)
    np.testing.assert_allclose((start[0], child[0]), (0.0, 0.3), atol=EPS)
    np.testing.assert_allclose(end, [WIDTH * 0.5**0.5 - 0.7, 0.0, 0.0], atol=EPS)


@pytest.mark.parametrize("code", [FIRST, 6.5, LAST])
def test_a_bone_carries_points_as_the_skeleton_does(tmp_path: Path, code: float) -> None:
    path = write(tmp_path, arm(lift=(0.3, 0.7)))
    rest = read_asset(path, bind_pose=True).surfaces[0].points
    posed = skinned(path, code)
    for bone, mine in zip(bones_of(path, [code]), (slice(0, 4), slice(-4, None))):
        goes = Motion(bone.anchors, bone.path).at(rest[mine], 0.0)[0]
        np.testing.assert_allclose(goes, posed[mine], atol=EPS)


def test_the_rest_shape_is_the_bind_pose_where_the_top_joint_is(tmp_path: Path) -> None:
    path = write(tmp_path, arm(lift=(0.3, 0.7)))
    surface = read_asset(path, bind_pose=True).surfaces[0]
    assert surface.skinned
    np.testing.assert_allclose(surface.points, points() + (0.0, 0.3, 0.0), atol=EPS)


def test_the_range_is_that_of_the_stage_or_of_the_samples(tmp_path: Path) -> None:
    path = write(tmp_path, arm())
    assert animation_range(path, ["/Arm/Skin"], read_asset(path).facts) == (FIRST, LAST)
    text = arm().replace(f"startTimeCode = {FIRST}\n", "").replace(f"endTimeCode = {LAST}\n", "")
    path = write(tmp_path, text.replace(f" {LAST}:", f" {LAST + 7}:"))
    assert animation_range(path, ["/Arm/Skin"], read_asset(path).facts) == (FIRST, LAST + 7)


BROKEN = {
    "no skeleton": (arm(skeleton=""), "no skeleton poses </Arm/Skin>"),
    "no inverse": (
        arm(bind="( (1, 0, 0, 0), (0, 0, 0, 0), (0, 0, 1, 0), (1, 0, 0, 1) )"),
        "1 of 2 joints cannot be inverted; the first is A/B",
    ),
    "indices": (arm(skin=str([0, 7] * len(points()))), "do not fit its 36 points and the 2 joints"),
    "order": (arm(joints='["A/B", "A"]'), "is no valid skeleton"),
    "not finite": (arm(rotation="[(1, 0, 0, 0), (nan, 0, 0, 0)]"), "to a position that is not "
    "finite"),
}  # fmt: skip


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_skeleton_is_refused_in_words(tmp_path: Path, fault: str) -> None:
    text, message = BROKEN[fault]
    path = write(tmp_path, text)
    facts = read_asset(write(tmp_path, arm())).facts
    write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_skeleton(path, ["/Arm/Skin"], facts, first=FIRST, times=[FIRST])
    assert message in caught.value.message
    assert str(path) in caught.value.message
    assert caught.value.hint


@pytest.mark.slow
def test_points_without_weights_follow_the_nearest_bones_of_the_only_skeleton(
    tmp_path: Path,
) -> None:
    path = captured(tmp_path)
    facts = read_asset(path).facts
    at = np.array([[0.3, 0.1, 0.0], [1.0, 0.15, 0.0], [1.6, 0.0, -0.1], [-0.1, 0.0, 0.0]])
    assert lone_skeleton(path) == "/Arm/Skel"
    assert not skeletons(path, ["/Arm/Person"], facts)
    loose = {"/Arm/Person": at}
    assert animation_range(path, ["/Arm/Person"], facts, loose) == (FIRST, LAST)
    found = read_skeleton(
        path, ["/Arm/Person"], facts, first=FIRST, times=[FIRST, LAST], loose=loose
    )
    weights = found.weights["/Arm/Person"].toarray()
    np.testing.assert_allclose(weights.sum(1), 1.0)
    # A's segment is [0, 1] along x, B's the next: where they meet, both are equally near.
    np.testing.assert_allclose(weights[:, 0], [1.0, 0.5, 0.0, 1.0])
    assert [bone.name for bone in found.bones] == ["/Arm/Skel:A", "/Arm/Skel:A/B"]

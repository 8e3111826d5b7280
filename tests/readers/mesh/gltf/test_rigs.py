"""Skins of glTF files as UsdSkel: the same places, whichever way the joints are written."""

from __future__ import annotations

from pathlib import Path

import arm
import gltf_arm
import numpy as np
import pytest
from gltf_arm import FRAMES, maker, posed
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from gf_usd.core.errors import InputError
from gf_usd.readers import convert, read_asset
from gf_usd.readers.usd.skeleton.bones import read_skeleton

CLOSE = 1e-5  # of an arm of 2 m: UsdSkel has float32, and scales in half precision


def converted(path: Path, **options) -> Usd.Stage:
    """The USD form of a file, with its skeletons."""
    source = convert(path, rigged=True, **options)
    assert source is not None
    return Usd.Stage.Open(str(source.write(path.with_suffix(".source.usdc"))))


def skinned(stage: Usd.Stage, name: str, code: float) -> NDArray[np.float64]:
    """(V, 3) world points of a mesh as UsdSkel poses them."""
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    for binding in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
        for skin in binding.GetSkinningTargets():
            if skin.GetPrim().GetName() == name:
                points = UsdGeom.Mesh(skin.GetPrim()).GetPointsAttr().Get(code)
                joints = cache.GetSkelQuery(binding.GetSkeleton())
                assert skin.ComputeSkinnedPoints(
                    joints.ComputeSkinningTransforms(code), points, code
                )
                M = UsdGeom.Xformable(binding.GetSkeleton()).ComputeLocalToWorldTransform(code)
                rows = np.array(M)
                return np.array(points, float) @ rows[:3, :3] + rows[3, :3]
    raise AssertionError(f"no skeleton poses {name}")


@pytest.mark.parametrize("fps", [None, 48.0])
def test_the_skin_stands_where_gltf_has_it(tmp_path: Path, fps: float | None) -> None:
    stage = converted(gltf_arm.write(tmp_path), fps=fps)
    rate = fps or 24.0
    each = rate / gltf_arm.FPS
    assert stage.GetTimeCodesPerSecond() == rate
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1.0, 1.0 + (FRAMES - 1) * each)
    for frame in np.arange(0.0, FRAMES - 0.5, 1.0 / each):
        found = skinned(stage, "Skin", 1.0 + frame * each)
        np.testing.assert_allclose(found, posed(frame), atol=CLOSE)


def test_the_bind_pose_is_the_rest_shape(tmp_path: Path) -> None:
    """As large as the posed one, although the joints are in centimeters, and straight."""
    path = gltf_arm.write(tmp_path)
    (surface,) = read_asset(path, bind_pose=True).surfaces
    turn = np.linalg.lstsq(arm.points() - arm.points()[0], surface.points - surface.points[0])[0]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=CLOSE)
    np.testing.assert_allclose(surface.points[:12], posed(0.0)[:12], atol=CLOSE)  # A's alone


def test_bones_lie_in_the_skin_and_move_as_the_joints(tmp_path: Path) -> None:
    path = gltf_arm.write(tmp_path)
    source = convert(path, rigged=True)
    assert source is not None
    asset = source.asset(bind_pose=True)
    (surface,) = asset.surfaces
    codes = [1.0 + frame for frame in range(FRAMES)]
    skeleton = read_skeleton(source.layer, [surface.path], asset.facts, first=1.0, times=codes)
    assert [bone.name.rpartition(":")[2] for bone in skeleton.bones] == ["A", "A/B"]
    (elbow,) = [bone for bone in skeleton.bones if bone.name.endswith("B")]
    far = np.argmax(arm.points()[:, 0])
    rest = np.linalg.inv((elbow.anchors[1:] - elbow.anchors[0]).T)
    local = rest @ (surface.points[far] - elbow.anchors[0])
    for frame in (0, FRAMES - 1):
        at = elbow.path[frame]
        np.testing.assert_allclose(
            at[0] + (at[1:] - at[0]).T @ local, posed(frame)[far], atol=CLOSE
        )


def test_the_same_joints_under_another_matrix_are_one_skeleton(tmp_path: Path) -> None:
    """A second skin in inches, on B alone, whose points are in another place of the file."""
    made, inch = maker(), 0.0254
    points = np.array(arm.points()) / inch + [3.0, 0.0, 0.0]
    ones = np.tile(np.array([1.0, 0, 0, 0], np.float32), (len(points), 1))
    joints = np.zeros((len(points), 4), np.uint8)
    made.mesh(
        made.primitive(points, gltf_arm.triangles(), JOINTS_0=joints, WEIGHTS_0=ones),
        name="Sleeve", skin=1,
    )  # fmt: skip
    made.tree["scenes"][0]["nodes"].append(len(made.tree["nodes"]) - 1)
    back = np.eye(4)
    back[:3, :3] *= inch
    back[3, 0] = -3.0 * inch
    bind = np.diag([1.0 / gltf_arm.SMALL] * 3 + [1.0])
    bind[3, 0] = -1.0 / gltf_arm.SMALL
    matrices = made.accessor((back @ bind).reshape(1, 16).astype(np.float32))
    made.tree["skins"].append({"joints": [4], "inverseBindMatrices": matrices})
    stage = converted(gltf_arm.write(tmp_path, made))
    skeletons = [prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Skeleton)]
    assert len(skeletons) == 1
    end = arm.points()[:, 0] > 1.3  # where the arm hangs on B alone
    for frame in (0, FRAMES - 1):
        sleeve = skinned(stage, "Sleeve", 1.0 + frame)
        np.testing.assert_allclose(sleeve[end], posed(frame)[end], atol=2.0 * CLOSE)


def test_a_mesh_on_a_joint_is_carried_by_it(tmp_path: Path) -> None:
    """An eye: no skin, on a node below B that turns nothing and is in meters again."""
    made = maker()
    cm = 1.0 / gltf_arm.SMALL
    eye = made.mesh(
        made.primitive(arm.points(), gltf_arm.triangles()),
        name="Eye", scale=[cm] * 3, translation=[-cm, 0.0, 0.0],
    )  # fmt: skip
    made.tree["nodes"][4]["children"] = [eye]
    stage = converted(gltf_arm.write(tmp_path, made))
    end = arm.points()[:, 0] > 1.3
    for frame in (0, 5):
        found = skinned(stage, "Eye", 1.0 + frame)
        np.testing.assert_allclose(found[end], posed(frame)[end], atol=CLOSE)


def test_without_animation_it_stands_as_its_nodes_do(tmp_path: Path) -> None:
    stage = converted(gltf_arm.write(tmp_path, maker(animated=False, tilt=0.0)))
    assert not stage.HasAuthoredTimeCodeRange()
    np.testing.assert_allclose(
        skinned(stage, "Skin", 1.0), arm.points() + [0.0, 1.0, 0.0], atol=CLOSE
    )


def test_points_without_weights_are_said(tmp_path: Path) -> None:
    made = maker()
    weights = made.tree["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]
    view = made.tree["bufferViews"][made.tree["accessors"][weights]["bufferView"]]
    at = view["byteOffset"]
    made.data = made.data[:at] + bytes(16) + made.data[at + 16 :]
    path = gltf_arm.write(tmp_path, made)
    stage = converted(path)
    source = convert(path, rigged=True)
    assert source is not None
    assert any("1 point without weights: moved with the first joint" in n for n in source.notes)
    np.testing.assert_allclose(skinned(stage, "Skin", 1.0)[0], posed(0.0)[0], atol=CLOSE)


BROKEN = {
    "2 joints but no inverse bind matrices": lambda made: made.tree["skins"][0].pop(
        "inverseBindMatrices"
    ),
    "0 joints but no inverse bind matrices": lambda made: made.tree["skins"][0].update(joints=[]),
    "cannot be inverted; the first is A": lambda made: made.tree["skins"][0].update(
        inverseBindMatrices=made.accessor(np.zeros((2, 16), np.float32))
    ),
    "does not hold 2 inverse bind matrices": lambda made: made.tree["skins"][0].update(
        inverseBindMatrices=made.accessor(np.zeros((1, 16), np.float32))
    ),
    "has a skin but no weights": lambda made: made.tree["meshes"][0]["primitives"][0][
        "attributes"
    ].pop("WEIGHTS_0"),
    "contains a shear": lambda made: made.tree["nodes"][3].update(
        matrix=[1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    ),
    "is its own descendant": lambda made: made.tree["nodes"][4].update(children=[2]),
}


@pytest.mark.parametrize("message", BROKEN)
def test_a_damaged_skin_is_refused(tmp_path: Path, message: str) -> None:
    made = maker(animated=message != "contains a shear")
    BROKEN[message](made)
    path = gltf_arm.write(tmp_path, made)
    with pytest.raises(InputError) as caught:
        convert(path, rigged=True)
    assert message in caught.value.message
    assert str(path) in caught.value.message
    assert caught.value.hint

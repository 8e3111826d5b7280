"""Delivered files over difficult sources: read back by other readers than the writer's own."""

from __future__ import annotations

import re
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from delivered import gltf_vertices, world_points
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt
from small_sources import SOURCES, Source
from small_stages import CUBE, bake, write

from gf_usd.core.errors import BakeError, InputError, UsageError
from gf_usd.delivery.deliver import deliver
from gf_usd.delivery.gltf.read import GlbFile
from gf_usd.layers.check.run import check_file
from gf_usd.readers import convert

TOLERANCE = 0.02
FRAMES = 4
BALL = 'upAxis = "Z"\n metersPerUnit = 0.01\n timeCodesPerSecond = 24\n defaultPrim = "Ball"'


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A moving stage: a ball of 100 points under a turned prim that squashes, turns and falls."""
    return moving_ball(tmp_path_factory.mktemp("ball") / "ball.usdc")


def moving_ball(path: Path) -> Path:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    root = UsdGeom.Xform.Define(stage, "/Ball")
    root.AddTranslateOp().Set(Gf.Vec3d(3.0, -2.0, 5.0))
    root.AddRotateZOp().Set(30.0)
    stage.SetDefaultPrim(root.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/Ball/Skin")
    mesh.AddScaleOp().Set(Gf.Vec3f(1.0, 1.0, 1.0))
    points, faces = sphere(8, 14)
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([int(i) for face in faces for i in face])
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateDisplayColorAttr([Gf.Vec3f(0.8, 0.2, 0.1)])
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(FRAMES)
    for code in range(1, FRAMES + 1):
        t = (code - 1) / (FRAMES - 1)
        moved = points * (1 + 0.2 * t, 1 + 0.2 * t, 1 - 0.3 * t)
        moved = moved + 0.1 * t * np.sin(3.0 * points[:, [1, 2, 0]]) - (0.0, 0.0, 2.0 * t)
        mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(moved.astype(np.float32)), code)
    stage.Save()
    return path


def sphere(rings: int, sides: int) -> tuple[np.ndarray, list[list[int]]]:
    theta = np.pi * np.arange(1, rings) / rings
    phi = 2 * np.pi * np.arange(sides) / sides
    grid = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones(sides)),
        ],
        -1,
    ).reshape(-1, 3)
    points = np.concatenate([grid, [(0, 0, 1.0), (0, 0, -1.0)]])
    top, bottom = len(grid), len(grid) + 1
    faces = []
    for j in range(sides):
        k = (j + 1) % sides
        faces.append([top, j, k])
        faces.append([bottom, (rings - 2) * sides + k, (rings - 2) * sides + j])
        for i in range(rings - 2):
            faces.append([i * sides + j, (i + 1) * sides + j, (i + 1) * sides + k, i * sides + k])
    return points, faces


@pytest.mark.parametrize("kind", ["joints", "shapes"])
@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_usd_positions_read_independently_are_within_the_stated_error(
    ball: Path, tmp_path: Path, kind: str, suffix: str
) -> None:
    before = ball.read_bytes()
    done = deliver(ball, tmp_path / f"out{suffix}", error=TOLERANCE, kind=kind)
    ours, theirs = world_points(ball), world_points(done.path)
    off = np.linalg.norm(theirs["/Ball/Skin"] - ours["/Ball/Skin"], axis=2).max()
    radius = done.bodies[0].radius / 0.01
    assert radius == pytest.approx(1.0, abs=0.1)  # a polyhedron in the unit sphere
    # single precision of numbers of about ten
    assert off / radius == pytest.approx(done.error, abs=1e-5)
    assert 0.0 < done.error <= TOLERANCE
    assert (done.bodies[0].joints > 0) == (kind == "joints")
    assert (done.bodies[0].shapes > 0) == (kind == "shapes")
    assert ball.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [done.path.name]
    assert done.bytes == done.path.stat().st_size


@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_gltf_positions_read_independently_are_within_the_stated_error(
    ball: Path, tmp_path: Path, kind: str
) -> None:
    done = deliver(ball, tmp_path / "out.glb", error=TOLERANCE, kind=kind)
    theirs = gltf_vertices(done.path)  # (T, N, 3) meters, Y up
    world = world_points(ball)["/Ball/Skin"] * 0.01
    ours = np.stack([world[..., 0], world[..., 2], -world[..., 1]], axis=-1)
    # vertices are split: each is the point that it coincides with at first
    gap = np.linalg.norm(theirs[0][:, None] - ours[0][None], axis=2)
    at = gap.argmin(axis=1)
    assert set(at.tolist()) == set(range(ours.shape[1]))
    radius = done.bodies[0].radius
    off = np.linalg.norm(theirs - ours[:, at], axis=2).max() / radius
    assert off == pytest.approx(done.error, abs=1e-5)
    assert 0.0 < done.error <= TOLERANCE


def test_vertices_are_split_only_where_something_differs(ball: Path, tmp_path: Path) -> None:
    done = deliver(ball, tmp_path / "out.glb", error=TOLERANCE)
    smooth = world_points(ball)["/Ball/Skin"].shape[1]
    # faces of this coarse ball meet at less than the crease angle
    assert gltf_vertices(done.path).shape[1] == smooth


def test_keys_stay_where_programs_clamp_them(ball: Path, tmp_path: Path) -> None:
    done = deliver(ball, tmp_path / "out.usda", error=TOLERANCE, kind="shapes")
    stage = Usd.Stage.Open(str(done.path))
    animation = UsdSkel.Animation(stage.GetPrimAtPath("/Ball/Skeleton/Animation"))
    weights = animation.GetBlendShapeWeightsAttr()
    keys = np.array([weights.Get(code) for code in weights.GetTimeSamples()])
    assert keys.shape == (FRAMES, done.bodies[0].shapes)
    assert keys.min() >= 0.0
    assert keys.max() <= 1.0


@pytest.mark.parametrize("name", SOURCES)
def test_bakes_of_difficult_sources(name: str, tmp_path: Path) -> None:
    asset, *_ = SOURCES[name].scene(tmp_path)
    root, *_ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    if stage.GetDefaultPrim().IsA(UsdGeom.Gprim):
        with pytest.raises(InputError, match="without a parent"):
            deliver(root.path, tmp_path / "out.usdz", error=TOLERANCE)
        return
    done = deliver(root.path, tmp_path / "out.usdz", error=TOLERANCE)
    assert done.error <= TOLERANCE
    ours, theirs = world_points(root.path), world_points(done.path)
    baked = {path for body in done.bodies for path in body.meshes}
    assert baked
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    radius = {path: body.radius / unit for body in done.bodies for path in body.meshes}
    for path in baked:
        off = np.linalg.norm(theirs[path] - ours[path], axis=2).max()
        assert off <= TOLERANCE * radius[path] * (1 + 1e-4), path


PAINTED = Source(
    f"""
def Xform "box" (
    variants = {{ string paint = "red" }}
    prepend variantSets = "paint"
)
{{
    def Mesh "skin"
    {{{CUBE}    }}
    variantSet "paint" = {{
        "red" {{
            over "skin"
            {{
                color3f[] primvars:displayColor = [(1, 0, 0)]
            }}
        }}
        "blue" {{
            over "skin"
            {{
                color3f[] primvars:displayColor = [(0, 0, 1)]
            }}
        }}
    }}
}}
"""
)


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
def test_variants_of_bake_and_source_are_kept(tmp_path: Path, suffix: str) -> None:
    root, *_ = bake(PAINTED.asset(tmp_path), tmp_path, looks=("rubber", "jelly"))
    done = deliver(root.path, tmp_path / f"out{suffix}", error=TOLERANCE)
    assert {body.variant for body in done.bodies} == {"rubber", "jelly"}
    stage = Usd.Stage.Open(str(done.path))
    box = stage.GetPrimAtPath("/box")
    assert box.GetVariantSet("gaussianFlesh").GetVariantNames() == ["jelly", "none", "rubber"]
    assert box.GetVariantSet("gaussianFlesh").GetVariantSelection() == "rubber"
    assert not stage.GetPrimAtPath("/box/GaussianFlesh")
    color = UsdGeom.Mesh(stage.GetPrimAtPath("/box/skin")).GetDisplayColorAttr()
    assert color.Get()[0] == (1, 0, 0)
    box.GetVariantSet("paint").SetVariantSelection("blue")
    assert color.Get()[0] == (0, 0, 1)
    for look in ("rubber", "jelly"):
        ours, theirs = (world_points(path, look)["/box/skin"] for path in (root.path, done.path))
        assert np.linalg.norm(ours - theirs, axis=2).max() <= TOLERANCE
    source = world_points(done.path, "none")["/box/skin"]
    assert np.array_equal(source, np.repeat(source[:1], len(source), axis=0))


def test_the_box_is_that_of_the_pose_that_is_delivered(tmp_path: Path) -> None:
    """A skeleton bends the source before the first frame: its own box holds other points."""
    asset = PAINTED.asset(tmp_path)
    (skin,) = asset.surfaces
    x, y, z = skin.points.T
    bent = np.stack([x + 0.5 * y * z, y, z + x * y], axis=1)
    posed = replace(asset, surfaces=(replace(skin, points=bent),))
    root, *_ = bake(posed, tmp_path)
    for suffix in (".usda", ".usdz"):
        done = deliver(root.path, tmp_path / f"out{suffix}", error=TOLERANCE)
        assert check_file(done.path).findings == ()
        stage = Usd.Stage.Open(str(done.path))
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/box/skin"))
        computed = UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get())
        assert mesh.GetExtentAttr().Get() == computed


def test_the_metadata_list_only_the_variants_of_the_file(tmp_path: Path) -> None:
    root, *_ = bake(PAINTED.asset(tmp_path), tmp_path, looks=("rubber", "jelly"))
    layer = Sdf.Layer.FindOrOpen(str(root.path))
    about = dict(layer.customLayerData["gaussianFlesh"])
    about["colliders"] = Vt.StringArray(["./sets/wall.obj"])
    about["colliderHashes"] = Vt.StringArray(["ab"])
    layer.customLayerData = {**layer.customLayerData, "gaussianFlesh": about}
    layer.Save()
    done = deliver(root.path, tmp_path / "out.usda", error=TOLERANCE, variant="jelly")
    metadata = Sdf.Layer.FindOrOpen(str(done.path)).customLayerData["gaussianFlesh"]
    assert list(metadata["looks"]) == ["jelly"]
    assert "variants" not in metadata
    # a delivery refers to no files of obstacles
    assert not {"colliders", "colliderHashes"} & set(metadata)


def test_the_same_bytes_each_time(ball: Path, tmp_path: Path) -> None:
    for suffix in (".usdz", ".glb", ".usda"):
        made = [
            deliver(ball, tmp_path / f"{folder}{suffix}", error=0.1).path for folder in ("a", "b")
        ]
        first, second = (path.read_bytes() for path in made)
        assert first.replace(b"a.usdc", b"b.usdc") == second
    with zipfile.ZipFile(tmp_path / "a.usdz") as package:
        # whenever it is made
        assert {one.date_time for one in package.infolist()} == {(2000, 1, 1, 12, 0, 0)}


def test_the_smaller_file_is_kept(ball: Path, tmp_path: Path) -> None:
    sizes = {
        kind: deliver(ball, tmp_path / f"{kind}.glb", error=TOLERANCE, kind=kind).bytes
        for kind in ("joints", "shapes", "auto")
    }
    assert sizes["auto"] == min(sizes["joints"], sizes["shapes"])
    assert sizes["joints"] != sizes["shapes"]


def test_limits_that_do_not_allow_the_error_are_named(ball: Path, tmp_path: Path) -> None:
    with pytest.raises(BakeError) as caught:
        deliver(ball, tmp_path / "out.glb", error=1e-4, most_joints=2, most_shapes=1)
    message = caught.value.message
    assert message.startswith(f"{ball} cannot be delivered within 0.01 % of the radius: ")
    assert "</Ball/Skin>: 1 blend shape is not enough" in message
    assert "</Ball/Skin>: 2 joints leave an error of " in message
    assert "--max-joints" in caught.value.hint
    assert "--max-shapes" in caught.value.hint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_mesh_of_too_few_points_for_joints_is_named(tmp_path: Path) -> None:
    """More joints than points do not help it; they are no advice."""
    source = moving_ball(tmp_path / "card.usdc")
    stage = Usd.Stage.Open(str(source))
    mesh = UsdGeom.Mesh.Define(stage, "/Ball/Card")
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    for code in range(1, FRAMES + 1):
        t = (code - 1) / (FRAMES - 1)
        corners = [(9, 0, t), (10, 0, 0), (10, 1 + t, t), (9, 1, -t)]
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray([Gf.Vec3f(*one) for one in corners]), code)
    stage.Save()
    target = tmp_path / "out.glb"
    with pytest.raises(BakeError) as caught:
        deliver(source, target, error=0.005, kind="joints")
    assert re.fullmatch(
        rf"{source} cannot be delivered within 0.5 % of the radius: </Ball/Card>: 4 joints leave an"
        r" error of 63 % of the radius, 6\.\d+ mm; it has 4 distinct points, and more joints"
        r" than points do not help",
        caught.value.message,
    )
    assert "--as shapes" in caught.value.hint
    assert "--max-joints" not in caught.value.hint
    assert not target.exists()
    deliver(source, target, error=0.005, kind="shapes")  # as the hint says


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"error": 0.0}, "--error"),
        ({"kind": "bones"}, "--as"),
        ({"most_joints": 0}, "--max-joints"),
        ({"variant": "steel"}, "steel"),
    ],
)
def test_wrong_options_are_refused(ball: Path, tmp_path: Path, options: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        deliver(ball, tmp_path / "out.glb", **options)
    assert list(tmp_path.iterdir()) == []


def test_an_input_is_never_replaced(ball: Path, tmp_path: Path) -> None:
    before = ball.read_bytes()
    with pytest.raises(UsageError, match="input"):
        deliver(ball, ball)
    assert ball.read_bytes() == before
    with pytest.raises(UsageError, match="end in"):
        deliver(ball, tmp_path / "out.fbx")


def test_what_stands_still_is_refused(tmp_path: Path) -> None:
    still = write(tmp_path / "still.usda", 'def Xform "a" {}\n', BALL)
    with pytest.raises(InputError, match="nothing in this file moves"):
        deliver(still, tmp_path / "out.glb")
    assert Sdf.Layer.FindOrOpen(str(still)) is not None


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_a_mesh_below_a_mesh_is_refused_where_it_would_not_move(tmp_path: Path, kind) -> None:
    """UsdSkel finds no mesh below another one."""
    bake_file = moving_ball(tmp_path / "ball.usda")
    stage = Usd.Stage.Open(str(bake_file))
    Sdf.CopySpec(stage.GetRootLayer(), "/Ball/Skin", stage.GetRootLayer(), "/Ball/Skin/Hat")
    stage.Save()
    with pytest.raises(InputError, match="</Ball/Skin/Hat> is below </Ball/Skin>, a Mesh"):
        deliver(bake_file, tmp_path / "out.usda", kind=kind)
    assert not (tmp_path / "out.usda").exists()
    assert deliver(bake_file, tmp_path / "out.glb", kind=kind).error <= 0.005


@pytest.mark.slow
def test_a_body_far_from_the_origin_has_a_hint_at_it(tmp_path: Path) -> None:
    bake_file = moving_ball(tmp_path / "ball.usda")
    stage = Usd.Stage.Open(str(bake_file))
    stage.GetPrimAtPath("/Ball").GetAttribute("xformOp:translate").Set(Gf.Vec3d(1e6, 0.0, 0.0))
    stage.Save()
    with pytest.raises(BakeError, match="differs by") as caught:
        deliver(bake_file, tmp_path / "out.usda", kind="joints")
    assert "10 km that the body is from the origin" in caught.value.hint


def test_a_file_that_is_not_there_leaves_the_target(tmp_path: Path) -> None:
    (tmp_path / "there.glb").write_text("earlier")
    with pytest.raises(InputError, match="does not exist"):
        deliver(tmp_path / "none.usda", tmp_path / "there.glb")
    assert (tmp_path / "there.glb").read_text() == "earlier"


def test_delivered_joints_are_a_skeleton_that_is_read(ball: Path, tmp_path: Path) -> None:
    """UsdSkel of the file poses its points where glTF does: joints of 16 bits are exact in both."""
    target = tmp_path / "ball.glb"
    deliver(ball, target, error=0.05, kind="joints")
    source = convert(target, rigged=True)
    assert source is not None
    stage = Usd.Stage.Open(str(source.layer))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1.0, FRAMES)
    file = GlbFile(target)
    (node,) = [k for k, row in enumerate(file.tree["nodes"]) if "mesh" in row]
    root, cache = UsdSkel.Root(stage.GetDefaultPrim()), UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    (skin,) = binding.GetSkinningTargets()
    joints = cache.GetSkelQuery(binding.GetSkeleton())
    M = np.array(UsdGeom.Xformable(binding.GetSkeleton()).ComputeLocalToWorldTransform(1.0))
    for frame in range(FRAMES):
        points = UsdGeom.Mesh(skin.GetPrim()).GetPointsAttr().Get(1.0 + frame)
        assert skin.ComputeSkinnedPoints(
            joints.ComputeSkinningTransforms(1.0 + frame), points, 1.0 + frame
        )
        found = np.array(points) @ M[:3, :3] + M[3, :3]
        np.testing.assert_allclose(found, file.vertices(node, frame), atol=1e-5)  # of 1 m: float32

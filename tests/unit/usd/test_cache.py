"""Frames written into the cache come back through a freshly composed stage."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdSkel
from small_sources import IMPLICIT, INSTANCES, MOVING, PLAIN, ROOT_MESH, SKINNED, SOURCES, Source
from small_stages import (
    RUBBER,
    bake,
    finish,
    frames_of,
    info_of,
    motion,
    particles_of,
    write_cache,
)

from gf_usd.errors import BakeError, UsageError
from gf_usd.publish import partial_path
from gf_usd.usd.cache import CacheWriter

# Float32 keeps 6e-8 of the largest number that a point passes through; local coordinates under
# scales of 50 and offsets of metres are within a hundred units here.
EPS = 2e-6


def world(stage: Usd.Stage, path: str, name: str, time_code: float) -> np.ndarray:
    """Values of a point attribute in the world, stage units."""
    prim = stage.GetPrimAtPath(path)
    matrix = np.array(UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim))
    values = np.array(prim.GetAttribute(name).Get(time_code), np.float64)
    return values @ matrix[:3, :3] + matrix[3, :3]


@pytest.fixture(params=SOURCES)
def source(request: pytest.FixtureRequest) -> Source:
    return SOURCES[request.param]


def test_world_points_come_back(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    unit = asset.facts.units.length
    scope = next(
        p.GetPath() for p in stage.Traverse() if p.GetName() == "Gaussians"
    ).GetParentPath()
    for frame in frames_of(asset, particles, info):
        time = frame.time_code
        for path, pose in frame.meshes.items():
            found = world(stage, path, "points", time) * unit
            np.testing.assert_allclose(found, pose.points, rtol=0, atol=EPS * 100 * unit)
        for name, attribute in (("Gaussians", "positions"), ("Points", "points")):
            found = world(stage, f"{scope}/{name}", attribute, time) * unit
            np.testing.assert_allclose(
                found, frame.gaussians.positions, rtol=0, atol=EPS * 100 * unit
            )


def test_every_frame_is_a_sample_and_nothing_else(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    root, _, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    start = info.settings.start
    expected = [start + k for k in range(info.settings.frames)]
    for surface in asset.surfaces:
        prim = stage.GetPrimAtPath(surface.path)
        for name in ("points", "extent", "velocities"):
            assert prim.GetAttribute(name).GetTimeSamples() == expected, name


def test_extents_bound_what_is_drawn(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    for frame in frames_of(asset, particles, info):
        time = frame.time_code
        for path in frame.meshes:
            prim = stage.GetPrimAtPath(path)
            points = np.array(prim.GetAttribute("points").Get(time))
            extent = np.array(prim.GetAttribute("extent").Get(time))
            np.testing.assert_array_equal(extent, [points.min(axis=0), points.max(axis=0)])
        twin = next(p for p in stage.Traverse() if p.GetTypeName() == "Points")
        points = UsdGeom.Points(twin)
        computed = UsdGeom.Points.ComputeExtent(
            points.GetPointsAttr().Get(time), points.GetWidthsAttr().Get()
        )
        # half a width is rounded once more here than there
        np.testing.assert_allclose(points.GetExtentAttr().Get(time), computed, rtol=1e-6)


def test_the_splats_extent_is_that_of_their_three_sigma_ellipsoids(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    splats = stage.GetPrimAtPath("/duck/GaussianFlesh/Gaussians")
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    surface = []
    for centre, turn, scale in zip(
        splats.GetAttribute("positions").Get(12),
        splats.GetAttribute("orientations").Get(12),
        splats.GetAttribute("scales").Get(12),
    ):
        matrix = np.array(Gf.Matrix3d(Gf.Quatd(turn)))  # for row vectors
        surface.append(np.array(centre) + 3.0 * (directions * np.array(scale)) @ matrix)
    cloud = np.concatenate(surface)
    low, high = np.array(splats.GetAttribute("extent").Get(12))
    size = high - low
    assert np.all(cloud >= low - 1e-5 * size)
    assert np.all(cloud <= high + 1e-5 * size)
    # 4000 directions come within 2 % of every extreme
    np.testing.assert_allclose(cloud.min(axis=0), low, atol=0.02 * size.max())
    np.testing.assert_allclose(cloud.max(axis=0), high, atol=0.02 * size.max())


def test_velocities_are_stage_units_per_second_in_local_space(tmp_path: Path) -> None:
    asset = SOURCES["several_roots"].asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    frame = list(frames_of(asset, particles, info))[3]
    for path, pose in frame.meshes.items():
        found = stage.GetPrimAtPath(path).GetAttribute("velocities").Get(frame.time_code)
        np.testing.assert_allclose(np.array(found) * 0.01, pose.velocities, atol=1e-6)
    scope = "/one/GaussianFlesh"
    for path in (f"{scope}/Gaussians.gaussianFlesh:velocities", f"{scope}/Points.velocities"):
        found = stage.GetAttributeAtPath(path).Get(frame.time_code)
        np.testing.assert_allclose(np.array(found) * 0.01, frame.gaussians.velocities, atol=1e-6)


def test_normals_come_back_and_their_indices_are_gone(tmp_path: Path) -> None:
    asset = MOVING.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    prim = stage.GetPrimAtPath("/root/arm/m")
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    assert not primvar.IsIndexed()
    assert primvar.GetInterpolation() == "vertex"
    assert not prim.GetAttribute("normals").HasAuthoredValue()
    assert prim.GetAttribute("accelerations").Get(1) is None
    for frame in frames_of(asset, particles, info):
        xforms = UsdGeom.XformCache(frame.time_code)
        matrix = np.array(xforms.GetLocalToWorldTransform(prim))[:3, :3]
        found = np.array(primvar.Get(frame.time_code), np.float64) @ np.linalg.inv(matrix).T
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        # scales of 2 to 50 spread the rounding of a float32 direction by their ratio
        np.testing.assert_allclose(found, frame.meshes["/root/arm/m"].normals, atol=5e-6)


def test_normals_that_were_not_carried_are_blocked_and_noted(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    body = replace(asset.surfaces[0], normals=None, normals_interpolation="")
    asset = replace(asset, surfaces=(body,))
    summary, _, _ = write_cache(tmp_path / "c.usdc", asset)
    assert summary.notes == (
        "</duck/geo/body>: its authored normals could not be carried along and are blocked",
    )
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "c.usdc"))
    assert layer.GetAttributeAtPath("/duck/geo/body.normals").default == Sdf.ValueBlock()


def test_gaussians_carry_colour_opacity_and_rest_state(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, particles, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    splats = stage.GetPrimAtPath("/duck/GaussianFlesh/Gaussians")
    assert splats.GetTypeName() == "ParticleField3DGaussianSplat"
    assert splats.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 0
    flat = np.array(splats.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get())
    # a renderer shows 1/2 + Y_00 f
    np.testing.assert_allclose(0.5 + flat / (2 * np.sqrt(np.pi)), particles.colour, atol=1e-6)
    np.testing.assert_allclose(splats.GetAttribute("opacities").Get(), particles.opacity, rtol=1e-6)
    for name in ("orientations", "gaussianFlesh:restOrientations"):
        turns = splats.GetAttribute(name).Get(11)
        wxyz = [[q.real, *q.imaginary] for q in turns]
        np.testing.assert_allclose(wxyz, particles.orientation, atol=1e-7)
    np.testing.assert_allclose(
        splats.GetAttribute("scales").Get(12), 1.2 * particles.scale, rtol=1e-6
    )
    for prim in (splats, stage.GetPrimAtPath("/duck/GaussianFlesh/Points")):
        assert "GaussianFleshParticlesAPI" in prim.GetAppliedSchemas()
        rest = prim.GetAttribute("gaussianFlesh:restPositions")
        assert rest.GetVariability() == Sdf.VariabilityUniform
        np.testing.assert_allclose(rest.Get(), particles.X, rtol=1e-6)
        # the stage counts mass in half kilograms
        masses = particles.V0 * 1100.0 / 0.5
        np.testing.assert_allclose(
            prim.GetAttribute("gaussianFlesh:masses").Get(), masses, rtol=1e-6
        )
        meshes = prim.GetRelationship("gaussianFlesh:sourceMeshes").GetTargets()
        assert meshes == [Sdf.Path("/duck/geo/body")]


def test_each_body_has_its_own_material(tmp_path: Path) -> None:
    asset = MOVING.asset(tmp_path)
    write_cache(tmp_path / "c.usdc", asset, bodies=2)
    stage = Usd.Stage.Open(str(tmp_path / "c.usdc"))
    splats = stage.GetPrimAtPath("/root/GaussianFlesh/Gaussians")
    materials = splats.GetRelationship("gaussianFlesh:materials").GetTargets()
    scope = Sdf.Path("/root/GaussianFlesh/Materials")
    assert materials == [scope.AppendChild("rubber"), scope.AppendChild("rubber_2")]
    assert set(splats.GetAttribute("gaussianFlesh:materialIndices").Get()) == {0, 1}
    assert not splats.HasAPI(UsdShade.MaterialBindingAPI)


def test_a_material_is_bound_for_physics_in_stage_units(tmp_path: Path) -> None:
    asset = MOVING.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    splats = stage.GetPrimAtPath("/root/GaussianFlesh/Gaussians")
    material, _ = UsdShade.MaterialBindingAPI(splats).ComputeBoundMaterial("physics")
    prim = material.GetPrim()
    assert prim.GetPath() == "/root/GaussianFlesh/Materials/rubber"
    physics = UsdPhysics.MaterialAPI(prim)
    # centimetres and kilograms: kg/m^3 * 1e-6, kg/(m s^2) * 1e-2
    assert physics.GetDensityAttr().Get() == pytest.approx(RUBBER.density * 1e-6)
    assert prim.GetAttribute("physics:youngsModulus").Get() == pytest.approx(2e5 * 1e-2)
    assert prim.GetAttribute("physics:poissonsRatio").Get() == pytest.approx(0.45)
    assert physics.GetDynamicFrictionAttr().Get() == pytest.approx(0.7)
    assert physics.GetStaticFrictionAttr().Get() == pytest.approx(0.7)
    assert physics.GetRestitutionAttr().Get() == pytest.approx(0.6)
    assert prim.GetAttribute("gaussianFlesh:law").Get() == "neoHookean"
    assert prim.GetAttribute("gaussianFlesh:look").Get() == "rubber"
    assert prim.GetAttribute("gaussianFlesh:dampingTime").Get() == pytest.approx(0.002)


@pytest.mark.parametrize("binding", ["on the mesh", "on the SkelRoot"])
def test_baked_skin_is_not_skinned_again(binding: str, tmp_path: Path) -> None:
    asset = SKINNED.asset(tmp_path)
    if binding == "on the SkelRoot":
        layer = Sdf.Layer.FindOrOpen(str(asset.facts.path))
        skin, above = (layer.GetPrimAtPath(p) for p in ("/root/figure/skin", "/root/figure"))
        above.SetInfo("apiSchemas", skin.GetInfo("apiSchemas"))
        for name in [p.name for p in skin.properties if "skel:" in p.name]:
            Sdf.CopySpec(
                layer, skin.path.AppendProperty(name), layer, above.path.AppendProperty(name)
            )
            skin.RemoveProperty(skin.properties[name])
        layer.Save()
    theirs = Usd.Stage.Open(str(asset.facts.path))
    assert skinned_prims(theirs) == ["/root/figure/skin"]
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    assert skinned_prims(stage) == []
    # USD's own baker leaves the points alone
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/root/figure")))
    for frame in frames_of(asset, particles, info):
        found = world(stage, "/root/figure/skin", "points", frame.time_code)
        expected = frame.meshes["/root/figure/skin"].points
        np.testing.assert_allclose(found, expected, atol=EPS * 10)


def skinned_prims(stage: Usd.Stage) -> list[str]:
    root, cache = UsdSkel.Root(stage.GetPrimAtPath("/root/figure")), UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    bindings = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    return [str(q.GetPrim().GetPath()) for b in bindings for q in b.GetSkinningTargets()]


def test_boxes_above_the_mesh_follow_it(tmp_path: Path) -> None:
    for source, path in ((SKINNED, "/root/figure/skin"), (PLAIN, "/duck/geo/body")):
        asset = source.asset(tmp_path, f"{path.count('/')}{path[1:5]}.usda")
        root, particles, info = bake(asset, tmp_path)
        stage = Usd.Stage.Open(str(root.path))
        for frame in frames_of(asset, particles, info):
            boxes = UsdGeom.BBoxCache(frame.time_code, ["default", "render"], useExtentsHint=True)
            box = boxes.ComputeWorldBound(stage.GetPseudoRoot()).ComputeAlignedRange()
            points = frame.meshes[path].points
            np.testing.assert_allclose(box.GetMin(), points.min(axis=0), atol=EPS * 10)
            np.testing.assert_allclose(box.GetMax(), points.max(axis=0), atol=EPS * 10)


def test_other_skins_of_the_skeleton_stay_in_its_box(tmp_path: Path) -> None:
    asset = SKINNED.asset(tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(asset.facts.path))
    hat = Sdf.Path("/root/figure/hat")
    Sdf.CopySpec(layer, "/root/figure/skin", layer, hat)
    layer.GetAttributeAtPath(hat.AppendProperty("extent")).default = [(0, 0, 0), (9, 9, 9)]
    layer.Save()
    write_cache(tmp_path / "c.usdc", asset)
    cache = Usd.Stage.Open(str(tmp_path / "c.usdc"))
    # the skeleton lifts the hat by 7 at the last frame
    extent = cache.GetAttributeAtPath("/root/figure.extent").Get(5)
    np.testing.assert_allclose(extent[1], (9, 16, 9), rtol=1e-6)


def test_instances_with_baked_proxies_end_only_in_the_bake(tmp_path: Path) -> None:
    asset = INSTANCES.asset(tmp_path)
    root, _, _ = bake(replace(asset, surfaces=asset.surfaces[:1]), tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    assert asset.surfaces[0].path == "/root/left/seat"
    assert not stage.GetPrimAtPath("/root/left").IsInstance()
    assert len(stage.GetAttributeAtPath("/root/left/seat.points").GetTimeSamples()) == 5


def test_an_implicit_shape_becomes_a_smooth_mesh_with_creases(tmp_path: Path) -> None:
    asset = IMPLICIT.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/root/box"))
    assert mesh.GetPrim().GetTypeName() == "Mesh"
    assert mesh.GetOrientationAttr().Get() == "rightHanded"
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetNormalsInterpolation() == "faceVarying"
    for frame in frames_of(asset, particles, info):
        a = motion(np.zeros(3), frame.index / info.settings.fps)[2]
        normals = np.array(mesh.GetNormalsAttr().Get(frame.time_code), np.float64)
        # the top of the box: its faces stay flat under the affine motion
        expected = np.array([0, 0, 1]) @ np.linalg.inv(a)
        expected /= np.linalg.norm(expected)
        np.testing.assert_allclose(normals[4:8], np.tile(expected, (4, 1)), atol=1e-6)


def test_changing_topology_is_pinned_to_the_surface(tmp_path: Path) -> None:
    body = ROOT_MESH.body.replace(
        "int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]",
        "int[] faceVertexCounts.timeSamples = { 0: [4, 4, 4, 4, 4, 4], 3: [3] }",
    )
    asset = Source(body, ROOT_MESH.head).asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    assert list(stage.GetAttributeAtPath("/blob.faceVertexCounts").Get(4)) == [4] * 6


def test_another_rate_than_the_source_keeps_its_animation_in_step(tmp_path: Path) -> None:
    body, head = MOVING.body, MOVING.head.replace("timeCodesPerSecond = 24", "")
    asset = Source(body, head).asset(tmp_path)
    info = info_of(asset)
    fast = replace(info.settings, time_codes_per_second=60.0, fps=60.0, start=2.5)
    info = replace(info, settings=fast)
    particles = particles_of(asset)
    cache = tmp_path / "c.usdc"
    root = finish(cache, asset, particles, info)
    stage = Usd.Stage.Open(str(root.path))
    for frame in frames_of(asset, particles, info):
        found = world(stage, "/root/arm/m", "points", frame.time_code) * 0.01
        np.testing.assert_allclose(found, frame.meshes["/root/arm/m"].points, atol=EPS)


def test_wrong_frames_are_refused_in_words(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    info, particles = info_of(asset), particles_of(asset)
    first, second = list(frames_of(asset, particles, info))[:2]
    path = "/duck/geo/body"
    pose = first.meshes[path]
    short = replace(first, meshes={path: replace(pose, points=pose.points[:3])})
    lost = pose.points.copy()
    lost[2, 1] = np.nan
    astray = replace(first, meshes={path: replace(pose, points=lost)})
    few = replace(first, gaussians=replace(first.gaussians, scales=np.ones((3, 3))))
    cases = (
        (short, f"points of <{path}> at time code 10 have shape (3, 3), not (8, 3)."),
        (astray, f"points of <{path}> at time code 10 hold 1 numbers that are not finite."),
        (
            few,
            "scales of </duck/GaussianFlesh/Gaussians> at time code 10 have shape (3, 3), "
            "not (40, 3).",
        ),
        (replace(first, meshes={}), f"frame 0 has meshes none, the asset has <{path}>."),
    )
    with CacheWriter(tmp_path / "c.usdc", asset, particles, info) as writer:
        for frame, message in cases:
            with pytest.raises(BakeError) as caught:
                writer.write(frame)
            assert caught.value.message == message
        writer.write(second)
        with pytest.raises(BakeError, match="frame 0 has time code 10, after 11"):
            writer.write(first)


def test_the_asset_is_never_written_to(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    before = asset.facts.path.read_bytes()
    with pytest.raises(UsageError, match="is the asset itself"):
        write_cache(asset.facts.path, asset)
    bake(asset, tmp_path)
    assert asset.facts.path.read_bytes() == before


def test_a_failure_leaves_the_frames_so_far_under_the_partial_name(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    info, particles = info_of(asset), particles_of(asset)
    path = tmp_path / "c.usdc"
    frames = list(frames_of(asset, particles, info))

    def stop_after_two() -> None:
        with CacheWriter(path, asset, particles, info) as writer:
            writer.write(frames[0])
            writer.write(frames[1])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_after_two()
    assert not path.exists()
    stage = Usd.Stage.Open(str(partial_path(path)))
    assert stage.GetAttributeAtPath("/duck/geo/body.points").GetTimeSamples() == [10, 11]
    assert stage.GetEndTimeCode() == 11


def test_a_folder_that_cannot_be_is_named(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(BakeError, match=r"c\.partial\.usdc cannot be created") as caught:
        write_cache(tmp_path / "file" / "c.usdc", asset)
    assert str(tmp_path / "file") in caught.value.hint


ENDLESS = """
import sys
from dataclasses import replace
from pathlib import Path
sys.path.insert(0, {tests!r})
from small_sources import PLAIN
from small_stages import frames_of, info_of, particles_of
from gf_usd.usd.cache import CacheWriter
asset = PLAIN.asset(Path({folder!r}))
info = info_of(asset, frames=100000)
particles = particles_of(asset, 2000)
with CacheWriter(Path({folder!r}) / "c.usdc", asset, particles, info, save_every=1) as writer:
    for frame in frames_of(asset, particles, info):
        writer.write(frame)
        print(frame.index, flush=True)
        {then}
"""


def run_endless(folder: Path, then: str = "") -> subprocess.Popen[str]:
    code = ENDLESS.format(tests=str(Path(__file__).parent), folder=str(folder), then=then)
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL")
def test_a_killed_writer_leaves_nothing_under_the_final_name(tmp_path: Path) -> None:
    for frames in (0, 3):
        process = run_endless(tmp_path)
        for _ in range(frames + 1):
            process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert not (tmp_path / "c.usdc").exists()
        assert partial_path(tmp_path / "c.usdc").exists()
    # and the next bake writes over what is left
    write_cache(tmp_path / "c.usdc", PLAIN.asset(tmp_path))
    assert (tmp_path / "c.usdc").exists()


@pytest.mark.skipif(os.name == "nt", reason="no file size limit")
def test_a_full_disk_is_an_error_in_words(tmp_path: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (300000, 300000))"
    process = run_endless(tmp_path, limit)
    _, errors = process.communicate(timeout=60)
    assert "c.partial.usdc could not be saved." in errors
    assert "hint: check the space left on the disk" in errors
    assert not (tmp_path / "c.usdc").exists()

"""A bake of a production shot, which helpers/production_shot.py describes, loses nothing of it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from compare_stages import additions, differences, with_variant, world_points
from production_shot import START, write_shot
from pxr import Sdf, Usd, UsdGeom

import gf_usd
from gf_usd.layers.check.run import check_file
from gf_usd.pipeline.result import BakeResult
from gf_usd.readers import read_asset
from gf_usd.readers.usd_physics.scene import read_physics

PROPS = "/World/Props"
CRATE, TALL, BALL = f"{PROPS}/Crate/Box", f"{PROPS}/Mirror/Tall/Box", f"{PROPS}/Inches/Skin"
TYRE, KNOB = f"{PROPS}/Wheel/Tyre", f"{PROPS}/Knob"
SEAT, LEG = "/World/Chairs/A/Seat", "/World/Chairs/B/Left/Post"
MESHES = (CRATE, TALL, BALL, TYRE, SEAT, LEG)
BAKED = (*MESHES, KNOB)
FREED = ("/World/Chairs/A", "/World/Chairs/B", "/World/Chairs/B/Left")
STILL_INSTANCES = (
    "/World/Chairs/A/Left",
    "/World/Chairs/A/Right",
    "/World/Chairs/B/Right",
    "/World/Chairs/C",
)
# float32 points of up to 120 stage units, under transforms with scales of up to 100
EPS = 2e-4
MOVES = {"points", "velocities", "extent", "normals", "accelerations"}
BECOMES_MESH = {"faceVertexCounts", "faceVertexIndices", "orientation", "subdivisionScheme"}


@dataclass(frozen=True)
class Baked:
    """The shot and its bake."""

    shot: Path
    result: BakeResult
    before: dict[str, str]  # digests of every file of the shot

    @property
    def source(self) -> Usd.Stage:
        return Usd.Stage.Open(str(self.shot))

    def stage(self, variant: str = "rubber") -> Usd.Stage:
        return with_variant(self.result.root, variant)


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    folder = tmp_path_factory.mktemp("production")
    shot = write_shot(folder / "in")
    before = digests(folder / "in")
    result = gf_usd.bake(
        shot,
        output=f"{folder / 'out'}/",
        prims=(PROPS, SEAT, "/World/Chairs/B/Left"),
        particles=700,
        frames=3,
        floor="none",
    )
    return Baked(shot, result, before)


def test_every_layer_is_byte_identical(baked: Baked) -> None:
    assert len(baked.before) == 8
    assert digests(baked.shot.parent) == baked.before


def test_none_is_the_source(baked: Baked) -> None:
    none = baked.stage("none")
    assert differences(baked.source, none) == {}
    added = additions(baked.source, none)
    assert {name for name in added if not name.startswith("/_gaussianFleshSource")} == set()


def test_without_payloads_all_is_the_source_without_its_payloads(baked: Baked) -> None:
    source = Usd.Stage.Open(str(baked.shot), Usd.Stage.LoadNone)
    result = Usd.Stage.Open(str(baked.result.root), Usd.Stage.LoadNone)
    assert not source.GetPrimAtPath(BALL)
    # the health of the whole bake is in the root layer
    assert set(differences(source, result)) == {"/World schemas"}


def deliberate(name: str) -> bool:
    """Whether a bake is meant to change what has this name."""
    where, _, what = name.partition(" ")
    path, _, attribute = where.partition(".")
    if path in BAKED and attribute in MOVES:
        return True
    if path == KNOB:
        return attribute in BECOMES_MESH or (not attribute and what in ("", "typeName"))
    if path in FREED:
        return what == "instance"
    # boxes above what moves are true no longer
    if attribute == "extentsHint":
        return any(prim.startswith(f"{path}/") for prim in BAKED)
    ours = where.startswith(("/_gaussianFleshSource", "/World/GaussianFlesh"))
    health = attribute.startswith("gaussianFlesh:health:") or what in ("schemas", "apiSchemas")
    return ours or (path == "/World" and health)


def test_a_bake_changes_only_what_moves(baked: Baked) -> None:
    changed = {*differences(baked.source, baked.stage()), *additions(baked.source, baked.stage())}
    assert {name for name in changed if not deliberate(name)} == set()
    # ... and that it does change
    assert {f"{path}.points samples" for path in MESHES} <= changed


@pytest.mark.parametrize(
    ("path", "name"),
    [
        (CRATE, "creaseIndices"),
        (CRATE, "holeIndices"),
        (CRATE, "primvars:dust"),
        (f"{CRATE}/Lid", "indices"),
        ("/World/Scatter", "positions"),
        ("/ShotCam", "xformOp:translate"),
    ],
)
def test_a_loss_would_be_noticed(baked: Baked, path: str, name: str) -> None:
    stage = baked.stage()
    stage.GetPrimAtPath(path).GetAttribute(name).Block()
    lost = differences(baked.source, stage)
    assert any(not deliberate(found) and found.startswith(f"{path}.{name} ") for found in lost)


def test_every_part_starts_where_the_source_has_it(baked: Baked) -> None:
    source, result = baked.source, baked.stage()
    for path in MESHES:
        ours, theirs = (world_points(stage, path, START) for stage in (result, source))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=EPS, err_msg=path)
    box = UsdGeom.BBoxCache(START, ["default", "render"]).ComputeWorldBound
    for stage in (source, result):
        knob = box(stage.GetPrimAtPath(KNOB)).ComputeAlignedRange()
        # its chords lie within 0.1 % of the radius of 7, and the group is turned by 3 degrees
        np.testing.assert_allclose(knob.GetMidpoint(), (0.0, 70.0, 0.0), atol=2.5)


def test_animation_continues_beneath_the_bake(baked: Baked) -> None:
    source, result = baked.source, baked.stage()
    for code in (102.0, 103.0):
        for path in MESHES:
            theirs, ours = (
                UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath(path))
                for stage in (source, result)
            )
            assert ours == theirs
    # Under an animated group, turned and mirrored, they move as the animation did a frame
    # before the start, and fall: 1/2 g t^2 of one frame.
    for path in (TALL, SEAT):
        rest = world_points(source, path, START)
        before = (rest - world_points(source, path, START - 1.0)).mean(axis=0)
        moved = world_points(result, path, 102.0) - rest
        np.testing.assert_allclose(
            moved.mean(axis=0), before + (0.0, -0.5 * 981.0 / 24.0**2, 0.0), rtol=0, atol=0.05
        )


def test_baked_instances_are_freed_and_the_others_stay(baked: Baked) -> None:
    result = baked.stage()
    assert not any(result.GetPrimAtPath(path).IsInstance() for path in FREED)
    assert all(result.GetPrimAtPath(path).IsInstance() for path in STILL_INSTANCES)
    prototypes = {str(result.GetPrimAtPath(p).GetPrototype().GetPath()) for p in STILL_INSTANCES}
    assert len(prototypes) == 2  # the chair, and one leg for the three that are left
    cache = Sdf.Layer.FindOrOpen(str(baked.result.cache))
    assert [cache.GetPrimAtPath(path).GetInfo("instanceable") for path in FREED] == [False] * 3
    assert any(
        "each of </World/Chairs/A> and 2 more is an instance" in note for note in baked.result.notes
    )


def test_instancers_are_left_alone_and_said(baked: Baked) -> None:
    asset = read_asset(baked.shot)
    assert dict(asset.skipped) == {
        "/World/Stand/Proxy": "purpose proxy",
        "/World/Stand/Guide": "purpose guide",
        "/World/Stand/Hidden": "invisible",
        "/World/Stand/Late": "invisible at 101, visible from 103",
        "/World/Scatter": "PointInstancer: its instances are not made soft",
        "/World/Library/Stone": "prototype of </World/Scatter>: its instances are not made soft",
    }
    assert {s.path for s in asset.surfaces} >= set(BAKED)
    stage = baked.stage()
    scatter = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Scatter"))
    assert len(scatter.ComputeInstanceTransformsAtTime(START, START)) == 3


def test_a_cage_moves_and_its_limit_surface_is_still_made_from_it(baked: Baked) -> None:
    stage = baked.stage()
    cage = UsdGeom.Mesh(stage.GetPrimAtPath(CRATE))
    assert cage.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.catmullClark
    assert list(cage.GetHoleIndicesAttr().Get()) == [5]
    assert len(cage.GetCreaseIndicesAttr().Get()) == 3
    assert not cage.GetNormalsAttr().HasAuthoredValue()
    assert len(cage.GetPointsAttr().Get(102)) == 26


def test_samples_of_the_bake_take_the_place_of_the_sources(baked: Baked) -> None:
    stage = baked.stage()
    ball = UsdGeom.Mesh(stage.GetPrimAtPath(BALL))
    assert ball.GetPointsAttr().Get() is None
    for attribute in (ball.GetPointsAttr(), ball.GetVelocitiesAttr(), ball.GetNormalsAttr()):
        assert attribute.GetTimeSamples() == [101.0, 102.0, 103.0]
    np.testing.assert_allclose(
        np.linalg.norm(ball.GetNormalsAttr().Get(102), axis=1), 1.0, atol=1e-6
    )


def test_the_variants_of_the_source_still_switch(baked: Baked) -> None:
    for variant in ("none", "rubber"):
        stages = baked.source, baked.stage(variant)
        colors = []
        for stage in stages:
            stage.SetEditTarget(stage.GetSessionLayer())
            sets = stage.GetPrimAtPath(f"{PROPS}/Mirror/Tall").GetVariantSets()
            assert sets.GetVariantSelection("shape") == "tall"
            assert sets.SetSelection("paint", "blue")
            colors.append(stage.GetAttributeAtPath(f"{TALL}.primvars:displayColor").Get())
        assert colors[0] == colors[1]
        assert colors[0][0][0] == pytest.approx(0.5)


def test_animation_before_the_start_gives_the_velocity_at_the_start(baked: Baked) -> None:
    asset = read_asset(baked.shot, prims=(PROPS,))
    physics = read_physics(
        baked.shot, asset.facts, [s.path for s in asset.surfaces], rest=None, times=[101.0, 102.0]
    )
    moving = {body.path: body.moving for body in physics.bodies}
    for path in (CRATE, TALL, BALL, TYRE):
        now, before = (world_points(baked.source, path, code) for code in (START, START - 1.0))
        # float32 points of up to 70 stage units, times 24 frames per second
        given = moving[path]
        assert given is not None
        np.testing.assert_allclose(given, (now - before) * 0.24, rtol=0, atol=5e-5)
        assert np.abs(given).max() > 0.3  # 2 cm a frame, upwards


def test_the_result_passes_the_check(baked: Baked) -> None:
    assert baked.result.findings == ()
    found = check_file(baked.result.root).findings
    assert [f for f in found if f.severity == "error"] == []

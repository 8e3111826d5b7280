"""What is reported of a bake with --flesh: bones hold it, so nothing of a fall on a floor is."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from arm import arm, cached, captured, write
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdSkel
from small_bakes import Done

from gf_usd.core.errors import InputError
from gf_usd.physics.frame_loop import Solver
from gf_usd.pipeline.prepared import prepare, solver_of
from gf_usd.prepare.plan import Plan

FEW = {"particles": 300, "preroll": 6, "flesh": True}


def plan_of(path: Path, **options: object) -> Plan:
    return prepare(path, **FEW, output=path.parent / "out.usda", **options).plan


def solver(plan: Plan) -> Solver:
    return solver_of(plan, plan.variants[0])


def test_flesh_that_its_bones_carry_spreads_on_no_floor(tmp_path: Path) -> None:
    """Jelly of the arm, 0.4 m high, weighs more than 3 times its Young's modulus at 8 g."""
    path = write(tmp_path, arm(bend=(0.0, 0.0)))
    options = {"material": "jelly", "gravity": "80"}
    loose = prepare(path, particles=300, output=tmp_path / "out.usda", **options).plan
    note = "cannot carry its own weight"
    assert note in " ".join(loose.notes)
    assert note not in " ".join(plan_of(path, **options).notes)


@pytest.mark.slow
def test_an_animation_that_is_followed_is_not_reported_as_left(tmp_path: Path) -> None:
    source = write(tmp_path, arm())
    path = tmp_path / "cache.usda"
    path.write_text(cached(source), encoding="utf-8")
    note = "starts from its pose at the first frame"
    assert note not in " ".join(plan_of(path).notes)
    loose = prepare(path, particles=300, output=tmp_path / "out.usda").plan
    assert note in " ".join(loose.notes)


@pytest.mark.parametrize(("y", "turn"), [(0.5, 0.0), (-0.5, 0.0), (0.5, 180.0)])
def test_the_floor_that_is_proposed_cuts_through_no_pose(
    tmp_path: Path, y: float, turn: float
) -> None:
    """--floor 0 ended a bake of a character about the origin at its first frame; under the bind
    pose alone, the arm swung through it."""
    path = write(tmp_path, arm())
    stage = Usd.Stage.Open(str(path))
    root = stage.GetDefaultPrim()
    UsdGeom.Xformable(root).AddTranslateOp().Set(Gf.Vec3d(0.0, y, 0.0))
    UsdGeom.Xformable(root).AddRotateXOp().Set(turn)  # by 180 degrees it swings down
    stage.Save()
    plan = plan_of(path)
    (note,) = (note for note in plan.notes if note.startswith("there is no floor"))
    lowest = min(float(s.face_points[:, 1].min()) for s in plan.asset.surfaces)
    skel = next(prim for prim in stage.Traverse() if prim.IsA(UsdSkel.Root))
    times = Gf.Interval(stage.GetStartTimeCode(), stage.GetEndTimeCode())
    assert UsdSkel.BakeSkinning(UsdSkel.Root(skel), times)
    for prim in filter(UsdGeom.Mesh, stage.Traverse()):
        points = UsdGeom.Mesh(prim).GetPointsAttr()
        for code in points.GetTimeSamples():
            world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code)
            lowest = min(lowest, *(world.Transform(Gf.Vec3d(p))[1] for p in points.Get(code)))
    assert (lowest < 0.0) == ((y, turn) != (0.5, 0.0))
    text = re.fullmatch(
        r"there is no floor under the animation; --floor (\S+?)"
        r"(, under its poses in these frames,)? adds one",
        note,
    )
    assert text is not None
    # three digits, rounded down
    assert float(text[1]) == pytest.approx(min(lowest, 0.0), rel=0.01)
    assert float(text[1]) <= min(lowest, 0.0)
    assert bool(text[2]) == (lowest < 0.0)


def test_the_floor_that_is_proposed_is_under_animated_points(tmp_path: Path) -> None:
    """It was under the rest shape, which is the first of the poses."""
    source = write(tmp_path, arm())
    path = tmp_path / "cache.usda"
    path.write_text(cached(source), encoding="utf-8")
    stage = Usd.Stage.Open(str(path))
    mesh = next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    sinks = UsdGeom.Xformable(mesh).AddTranslateOp(opSuffix="sinks")
    sinks.Set(Gf.Vec3d(0.0, 0.0, 0.0), stage.GetStartTimeCode())
    sinks.Set(Gf.Vec3d(0.0, -1.4567, 0.0), stage.GetEndTimeCode())
    stage.Save()
    plan = plan_of(path)
    points = UsdGeom.Mesh(mesh).GetPointsAttr().Get(stage.GetEndTimeCode())
    last = min(point[1] for point in points) - 1.4567
    rest = min(float(s.face_points[:, 1].min()) for s in plan.asset.surfaces)
    assert last < rest - 1.0
    (note,) = (note for note in plan.notes if note.startswith("there is no floor"))
    height, where = note.removesuffix(" adds one").split("--floor ")[1].split(", ", 1)
    assert float(height) == pytest.approx(last, rel=0.01)
    assert float(height) <= last
    assert where == "under its poses in these frames,"


@pytest.mark.slow
def test_no_floor_is_proposed_where_there_are_obstacles(tmp_path: Path) -> None:
    path = write(tmp_path, arm())
    stage = Usd.Stage.Open(str(path))
    ground = UsdGeom.Cube.Define(stage, "/Arm/Ground")
    UsdGeom.XformCommonAPI(ground).SetTranslate(Gf.Vec3d(0.0, -3.0, 0.0))
    UsdPhysics.CollisionAPI.Apply(ground.GetPrim())
    stage.Save()
    assert not any(note.startswith("there is no floor") for note in plan_of(path).notes)


@pytest.mark.slow
def test_the_floor_that_is_proposed_is_under_poses_next_to_a_capture_without_any(
    tmp_path: Path,
) -> None:
    """It was under the rest shape of all, since one of the surfaces has no joint weights."""
    path = captured(tmp_path, 800)
    stage = Usd.Stage.Open(str(path))
    sinking = Sdf.Layer.FindOrOpen(str(write(tmp_path, arm(lift=(0.0, -1.5)))))
    for prim in ("/Arm/Skin", "/Arm/Anim"):
        Sdf.CopySpec(sinking, prim, stage.GetRootLayer(), prim)
    stage.Save()
    (note,) = (note for note in plan_of(path).notes if note.startswith("there is no floor"))
    assert note == (  # 0.2 below the bone that sinks by 1.5
        "there is no floor under the animation; --floor -1.7, under its poses in these frames and"
        " the rest shape of </Arm/Person>, adds one"
    )


@pytest.mark.slow
@pytest.mark.parametrize("animated", ["transform", "mesh"])
def test_an_animation_of_captured_gaussians_is_refused(tmp_path: Path, animated: str) -> None:
    """Without a skeleton it ended in a traceback, as did that of a mesh beside them."""
    path = captured(tmp_path, 800)
    stage = Usd.Stage.Open(str(path))
    person = stage.GetPrimAtPath("/Arm/Person")
    for prim in ("/Arm/Skel", "/Arm/Anim"):
        stage.RemovePrim(prim)
    if animated == "transform":
        sinks = UsdGeom.Xformable(person).AddTranslateOp()
        sinks.Set(Gf.Vec3d(0.0, 0.0, 0.0), 1.0)
        sinks.Set(Gf.Vec3d(0.0, -1.0, 0.0), 13.0)
    else:
        (tmp_path / "cache.usda").write_text(cached(write(tmp_path, arm())), encoding="utf-8")
        points = Sdf.Layer.FindOrOpen(str(tmp_path / "cache.usda"))
        Sdf.CopySpec(points, "/Arm/Skin", stage.GetRootLayer(), "/Arm/Skin")
    stage.Save()
    with pytest.raises(InputError, match="captured Gaussians themselves is not followed") as caught:
        plan_of(path)
    assert "</Arm/Person>" in caught.value.message
    assert "whose nearest bones they follow" in caught.value.hint


@pytest.mark.slow
def test_there_is_no_drop(gf_usd: Callable[..., Done], here: Path) -> None:
    write(here, arm())
    few = ("arm.usda", "--particles", "300")
    for command in (("inspect",), ("bake", "--dry-run")):
        flesh, loose = gf_usd(*command, *few, "--flesh"), gf_usd(*command, *few)
        assert (flesh.status, loose.status) == (0, 0)
        lines = [line for line in flesh.out.splitlines() if "first contact" in line]
        assert len(lines) == 1
        assert "no drop, first contact" in lines[0] or "drop        none, first" in lines[0]
        assert "no drop" not in loose.out
        assert "none, first" not in loose.out


@pytest.mark.slow
@pytest.mark.acceptance
def test_frames_before_the_animation_are_distinguished(
    gf_usd: Callable[..., Done], here: Path
) -> None:
    path = write(here, arm())
    done = gf_usd("bake", path, "--flesh", "--particles", "300", "--preroll", "6", "--frames", "2")
    assert done.status == 0, done.err
    assert " particles, 8 frames (the first 6 are pre-roll and are not written), " in done.err


@pytest.mark.slow
def test_no_hint_to_lower_a_drop_where_there_is_none(tmp_path: Path) -> None:
    path = write(tmp_path, arm())
    assert "--drop" not in solver(plan_of(path))._hint()
    falls = prepare(path, particles=300, output=tmp_path / "out.usda").plan
    assert "lower the impact (--drop)" in solver(falls)._hint()

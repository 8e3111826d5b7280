"""--settle-only: the pose at rest as a static asset."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux

import gf_usd
from gf_usd.core.errors import BakeError, UsageError
from gf_usd.core.frames.frame import Health
from gf_usd.core.materials.dimensionless import G0, time_scale
from gf_usd.core.stage import Collider
from gf_usd.core.units import bytes_text
from gf_usd.layers.stage import freeze_at_last_sample, freeze_source
from gf_usd.physics.total_lagrangian.settling import CALM, LOW
from gf_usd.pipeline.cost.solvers import Demand
from gf_usd.pipeline.measures.rest import Rest
from gf_usd.prepare.options.texts import Length, parse_frames
from gf_usd.prepare.settings import settled_frames, shot_frames

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
BODY = "/Sphere/Geom/Body"
SMALL: dict[str, Any] = {"material": "clay", "particles": 300}


def test_rest_is_less_than_a_ten_millionth_of_m_g_r_for_a_time_T() -> None:
    rest = Rest(0.25 * time_scale(2.0), 2.0)
    still = Health(mass=3.0, kinetic=0.9e-7 * 3.0 * G0 * 2.0)
    moving = Health(mass=3.0, kinetic=1.1e-7 * 3.0 * G0 * 2.0)
    assert [rest.reached(h, 5) for h in (still, still, still)] == [False] * 3
    assert not rest.reached(moving, 5)
    assert [rest.reached(still, 5) for _ in range(4)] == [False, False, False, True]


def test_nothing_rests_while_an_obstacle_is_to_move() -> None:
    rest = Rest(0.5 * time_scale(2.0), 2.0, moving_frames=3)
    still = Health(mass=3.0, kinetic=0.0)
    assert [rest.reached(still, i) for i in range(5)] == [False] * 4 + [True]


def test_what_fell_past_every_obstacle_does_not_keep_the_others_from_resting() -> None:
    rest = Rest(time_scale(2.0), 2.0)
    fell = Health(mass=3.0, kinetic=50.0, fallen=1, fallen_kinetic=50.0)
    moves = replace(fell, fallen_kinetic=49.0)
    assert [rest.reached(h, 5) for h in (moves, moves, fell, fell)] == [False] * 3 + [True]


@pytest.mark.parametrize(
    ("fallen", "bodies", "text"),
    [
        (0, 1, "clay: at rest at frame 2"),
        (1, 1, "clay: ends at frame 2: the body has fallen past every obstacle"),
        (3, 3, "clay: ends at frame 2: all 3 bodies have fallen past every obstacle"),
        (1, 3, "clay: at rest at frame 2 (without 1 of 3 bodies, which fell)"),
    ],
)
def test_a_body_that_fell_is_not_said_to_rest(fallen: int, bodies: int, text: str) -> None:
    frames = [Health(mass=3.0, kinetic=50.0, fallen=fallen, fallen_kinetic=50.0)] * 2
    summary = {"fallen_bodies": fallen, "fallen_of": bodies} if fallen else {"fallen_bodies": 0}
    rest = Rest(time_scale(2.0), 2.0)
    assert rest.message("clay", frames, 9, settled=True, summary=summary) == text


@pytest.mark.parametrize("frame_time", [1.0, 3.0, 50.0])
def test_one_frame_at_rest_is_no_rest(frame_time: float) -> None:
    """However short T is against a frame: what is about to fall is at rest in the first one."""
    rest = Rest(frame_time * time_scale(2.0), 2.0)
    still, moving = (Health(mass=3.0, kinetic=energy) for energy in (0.0, 1.0))
    assert [rest.reached(h, i) for i, h in enumerate((still, moving, still, moving))] == [False] * 4
    assert [rest.reached(still, 4), rest.reached(still, 5)] == [False, True]


@pytest.mark.slow
def test_a_body_so_small_that_a_frame_is_longer_than_T_falls(tmp_path: Path) -> None:
    asset = tmp_path / "small.usda"
    stage = Usd.Stage.CreateNew(str(asset))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.001)
    ball = UsdGeom.Sphere.Define(stage, "/Ball")
    ball.CreateRadiusAttr(5.0)
    stage.SetDefaultPrim(ball.GetPrim())
    stage.Save()
    found = gf_usd.bake(asset, material="clay", particles=200, output=tmp_path / "out.usda")
    assert found.frames > 3
    assert found.health["first_contact_frame"] is not None
    assert found.health["shift_max_m"] > 0.01


def test_an_obstacle_stays_from_its_last_move_on() -> None:
    offset = np.zeros((6, 3))
    offset[:3, 1], offset[3:, 1] = (0.0, 1.0, 0.0), 2.0
    corners = np.zeros((3, 3))
    one = Collider(
        path="/C", shape="mesh", points=corners, triangles=np.array([[0, 1, 2]]),
        linear=np.tile(np.eye(3), (6, 1, 1)), offset=offset,
    )  # fmt: skip
    assert one.still_from == 3
    assert replace(one, offset=offset[-1:], linear=one.linear[:1]).still_from == 0
    assert replace(one, deformed=np.zeros((6, 3, 3))).still_from == 5


def test_a_layer_that_is_held_still_has_its_last_sample_at_all_times() -> None:
    layer = Sdf.Layer.CreateAnonymous()
    layer.startTimeCode, layer.endTimeCode = 1.0, 2.0
    stage = Usd.Stage.Open(layer)
    points = UsdGeom.Points.Define(stage, "/P")
    for time in (1.0, 2.0):
        points.GetPointsAttr().Set([(time, 0.0, 0.0)], time)
        points.GetVelocitiesAttr().Set([(1.0, 0.0, 0.0)], time)
    points.GetWidthsAttr().Set([1.0])
    freeze_at_last_sample(layer)
    assert not any(a.GetNumTimeSamples() for a in points.GetPrim().GetAttributes())
    assert points.GetPointsAttr().Get() == [(2.0, 0.0, 0.0)]
    assert points.GetVelocitiesAttr().Get() is None
    assert points.GetWidthsAttr().Get() == [1.0]
    assert not layer.HasStartTimeCode()
    assert not layer.HasEndTimeCode()


def swaying(stage: Usd.Stage, path: str) -> UsdGeom.XformCommonAPI:
    """A light that is one unit farther along x in each frame."""
    sway = UsdGeom.XformCommonAPI(UsdLux.SphereLight.Define(stage, path))
    for time in range(1, 10):
        sway.SetTranslate((float(time), 0.0, 0.0), float(time))
    return sway


def test_other_animation_is_frozen_at_the_time_of_the_pose_at_rest() -> None:
    source = Usd.Stage.CreateInMemory()
    for path in ("/A/Light", "/A/Baked", "/B/Light"):
        swaying(source, path)
    layer = Sdf.Layer.CreateAnonymous()
    baked = Sdf.CreatePrimInLayer(layer, "/A/Baked")
    Sdf.AttributeSpec(baked, "xformOp:translate", Sdf.ValueTypeNames.Double3).default = (7, 7, 7)
    notes = freeze_source(layer, source, [Sdf.Path("/A")], Usd.TimeCode(4.0))
    assert notes == (
        "</A/Light> is animated and is kept in its pose at the time everything is at rest",
        "</B/Light> is animated by its source and keeps moving while the baked prims are at rest",
    )
    layer.subLayerPaths = [source.GetRootLayer().identifier]
    held = Usd.Stage.Open(layer)
    for name, x in (("Light", 4.0), ("Baked", 7.0)):
        op = held.GetAttributeAtPath(f"/A/{name}.xformOp:translate")
        assert (op.Get()[0], op.Get(9.0)[0], op.GetNumTimeSamples()) == (x, x, 0)


@pytest.mark.parametrize(
    "more", [{"range": (1, 2)}, {"handles": 2}, {"samples_per_frame": 2}, {"clip_frames": 5}]
)
def test_options_of_frames_cannot_be_combined_with_settle_only(
    tmp_path: Path, more: dict[str, Any]
) -> None:
    with pytest.raises(UsageError, match="settle_only=True cannot be combined with"):
        gf_usd.bake(SPHERE, output=tmp_path / "s.usda", settle_only=True, **SMALL, **more)


@pytest.mark.parametrize(
    ("kinetic", "moving_frames", "reason"),
    [
        (2.0, 0, "the kinetic energy of the last one is"),
        (0.5, 0, "at the end the bodies have been at rest for"),
        (0.5, 9, "an obstacle moves until the last one"),
    ],
)
def test_the_reason_that_is_given_is_what_keeps_it_from_rest(
    kinetic: float, moving_frames: int, reason: str
) -> None:
    """It named an energy below the limit, which is rest, where the time at rest was too short."""
    rest = Rest(0.5 * time_scale(2.0), 2.0, moving_frames)
    last = Health(mass=3.0, kinetic=kinetic * 1e-7 * 3.0 * G0 * 2.0)
    assert not rest.reached(last, 4)
    assert reason in rest.message("clay", [last], 5, settled=False, summary={})
    assert reason in rest.refusal("clay", last, 5, SPHERE).message


def test_what_is_not_at_rest_is_refused_with_its_energy(tmp_path: Path) -> None:
    few: dict[str, Any] = {"particles": 60, "frames": 5}
    with pytest.raises(BakeError, match="not at rest within 5 frames: the kinetic energy"):
        gf_usd.bake(SPHERE, output=tmp_path / "s.usda", settle_only=True, **few)
    assert not (tmp_path / "s.usda").exists()


@pytest.mark.slow
def test_the_pose_at_rest_is_that_of_the_frame_in_which_all_rests(tmp_path: Path) -> None:
    still = gf_usd.bake(
        SPHERE, output=tmp_path / "still.usda", settle_only=True, internal=True, **SMALL
    )
    assert still.frames == 1
    rests = still.bakes[0].health["frames"]
    assert f"clay: at rest at frame {rests}" in still.notes
    moving = gf_usd.bake(
        SPHERE, output=tmp_path / "moving.usda", frames=rests, internal=True, **SMALL
    )
    one, many = (Usd.Stage.Open(str(result.root)) for result in (still, moving))
    assert not one.HasAuthoredTimeCodeRange()
    paths = (BODY, "/Sphere/GaussianFlesh/Points", "/Sphere/GaussianFlesh/Gaussians")
    for prim in map(one.GetPrimAtPath, paths):
        assert not any(a.GetNumTimeSamples() for a in prim.GetAttributes())
        last = many.GetPrimAtPath(prim.GetPath())
        for name in ("points", "extent", "gaussianFlesh:plasticStrain"):
            value, sampled = prim.GetAttribute(name), last.GetAttribute(name)
            if value and value.HasValue():
                expected = np.asarray(sampled.Get(many.GetEndTimeCode()))
                np.testing.assert_array_equal(np.asarray(value.Get()), expected)
    points = np.asarray(one.GetPrimAtPath(BODY).GetAttribute("points").Get())
    assert points[:, 1].min() == pytest.approx(0.0, abs=0.05)
    assert not [fault for fault in still.findings if fault["level"] == "error"]


@pytest.mark.slow
def test_no_other_prim_of_the_stage_moves_with_settle_only(tmp_path: Path) -> None:
    asset = tmp_path / "lit.usda"
    source = Usd.Stage.CreateNew(str(asset))
    UsdGeom.SetStageUpAxis(source, "Y")
    UsdGeom.SetStageMetersPerUnit(source, 1.0)
    ball = source.DefinePrim("/Sphere")
    ball.GetReferences().AddReference(str(SPHERE))
    source.SetDefaultPrim(ball)
    source.SetStartTimeCode(1.0)
    source.SetEndTimeCode(9.0)
    swaying(source, "/Sphere/Light")
    source.Save()
    done = gf_usd.bake(asset, output=tmp_path / "s.usda", settle_only=True, **SMALL)
    stage = Usd.Stage.Open(str(done.root))
    assert not stage.HasAuthoredTimeCodeRange()
    assert not any(a.GetNumTimeSamples() for p in stage.TraverseAll() for a in p.GetAttributes())
    # it rests after the last sample of the animation
    assert stage.GetAttributeAtPath("/Sphere/Light.xformOp:translate").Get() == (9.0, 0.0, 0.0)
    assert (
        "</Sphere/Light> is animated and is kept in its pose at the time everything is at rest"
        in done.notes
    )


def test_frames_until_rest_are_parsed() -> None:
    assert parse_frames("48") == parse_frames(48) == Length(frames=48, rest=False)
    assert parse_frames("rest") == Length(frames=None, rest=True)
    assert parse_frames("rest:480") == Length(frames=480, rest=True)
    for wrong in ("soon", "rest:", "rest:x", "1.5", "rest:0", "-1"):
        with pytest.raises(UsageError, match="--frames is"):
            parse_frames(wrong)


@pytest.mark.parametrize("more", [{"range": (1, 2)}, {"handles": 2}])
def test_options_of_length_cannot_be_combined_with_until_rest(
    tmp_path: Path, more: dict[str, Any]
) -> None:
    with pytest.raises(UsageError, match="rest cannot be combined with"):
        gf_usd.bake(SPHERE, output=tmp_path / "s.usda", frames="rest", **SMALL, **more)


@pytest.mark.slow
def test_a_bake_until_rest_is_the_longer_one_up_to_there(tmp_path: Path) -> None:
    done = gf_usd.bake(SPHERE, output=tmp_path / "rest.usda", frames="rest", only="mesh", **SMALL)
    (bake,) = done.bakes
    assert bake.at_rest == bake.frames
    # it is looked at where it ends, not where it may have ended
    assert (bake.health["inside_at_end_share"], bake.health["inside_at_end_m"]) == (0.0, 0.0)
    assert any(note == f"clay: at rest at frame {bake.frames}" for note in done.notes)
    stage = Usd.Stage.Open(str(done.root))
    assert stage.GetEndTimeCode() == bake.frames
    longer = gf_usd.bake(
        SPHERE, output=tmp_path / "long.usda", frames=bake.frames + 3, only="mesh", **SMALL
    )
    other = Usd.Stage.Open(str(longer.root))
    for time in (1.0, float(bake.frames)):
        np.testing.assert_array_equal(
            stage.GetPrimAtPath(BODY).GetAttribute("points").Get(time),
            other.GetPrimAtPath(BODY).GetAttribute("points").Get(time),
        )


@pytest.mark.slow
def test_a_bake_that_does_not_rest_in_time_is_complete_up_to_there(tmp_path: Path) -> None:
    done = gf_usd.bake(SPHERE, output=tmp_path / "s.usda", frames="rest:6", only="mesh", **SMALL)
    (bake,) = done.bakes
    assert (bake.frames, bake.at_rest) == (6, None)
    assert any("clay: not at rest within 6 frames: the kinetic" in note for note in done.notes)


FEW: dict[str, Any] = {"material": "clay", "particles": 60}


def test_without_a_stated_length_a_bake_ends_at_rest() -> None:
    shot = gf_usd.inspect(SPHERE, range=(1, None), **FEW).plan.settings.frames
    open_end = gf_usd.inspect(SPHERE, **FEW).plan
    assert open_end.choices.until_rest
    assert open_end.settings.frames == settled_frames(shot)
    assert shot_frames(open_end.settings.frames) == shot


@pytest.mark.parametrize(
    "more",
    [
        {"frames": 12}, {"range": (1, None)}, {"handles": 2}, {"floor": False}, {"gravity": 0},
        {"fields": "wind:1,0,0"}, {"pins": "box:-9,-9,-9,9,-0.5,9"}, {"solver": "ul"},
        {"preset": "paper"}, {"no_settling": True},
    ],
)  # fmt: skip
def test_pins_fields_and_stated_lengths_end_without_rest(more: dict[str, Any]) -> None:
    assert not gf_usd.inspect(SPHERE, **(FEW | more)).plan.choices.until_rest


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "value"), [("REST_WORK", 100.0), ("REST_SECONDS", 1.0)])
def test_what_would_take_too_long_to_rest_ends_with_the_shot(monkeypatch, limit, value) -> None:
    monkeypatch.setattr(f"gf_usd.pipeline.prepared.{limit}", value)
    plans = []
    for ratio in (1.0, 7.0):
        monkeypatch.setattr("gf_usd.pipeline.prepared.cpu_time_ratio", lambda: ratio)  # noqa: B023
        plans.append(gf_usd.inspect(SPHERE, **FEW).plan)
    plan = plans[0]
    assert not plan.choices.until_rest
    assert (
        plan.settings.frames == gf_usd.inspect(SPHERE, range=(1, None), **FEW).plan.settings.frames
    )
    (note,) = (note for note in plan.notes if "not until rest" in note)
    assert note.startswith(f"{plan.settings.frames} frames are simulated")
    assert re.search(
        r"usually takes about \d+ frames, at most \d+; use frames rest for that$", note
    )
    assert plan.notes == plans[1].notes, "reports do not depend on the speed of the machine"


def test_a_bake_limited_to_a_shot_is_examined_once(monkeypatch) -> None:
    monkeypatch.setattr("gf_usd.pipeline.prepared.REST_WORK", 100.0)
    examined = []
    of = Demand.of
    monkeypatch.setattr(Demand, "of", lambda solver: examined.append(solver) or of(solver))
    limited = gf_usd.inspect(SPHERE, **FEW)
    assert limited.cost is not None
    assert len(examined) == 1
    shot = gf_usd.inspect(SPHERE, range=(1, None), **FEW)
    assert shot.cost is not None
    assert limited.cost["per_material"] == shot.cost["per_material"]


@pytest.mark.parametrize("clips", [False, True])
def test_the_cache_of_a_shot_is_split_by_its_own_size(monkeypatch, clips: bool) -> None:
    whole = gf_usd.inspect(SPHERE, **FEW).plan
    shot = shot_frames(whole.settings.frames) * whole.frame_bytes
    monkeypatch.setattr("gf_usd.pipeline.prepared.REST_WORK", 100.0)
    monkeypatch.setattr("gf_usd.core.frames.choices.LARGE", (0.5 if clips else 2.0) * shot)
    plan = gf_usd.inspect(SPHERE, **FEW).plan
    assert bool(plan.choices.clip_frames) == clips
    notes = [note for note in plan.notes if "is split into value clips" in note]
    assert [f"about {bytes_text(shot)}," in note for note in notes] == [True] * clips


@pytest.mark.slow
def test_a_bake_ends_at_rest_and_reports_the_frame(tmp_path: Path) -> None:
    done = gf_usd.bake(SPHERE, output=tmp_path / "s.usda", only="mesh", **SMALL)
    (bake,) = done.bakes
    assert bake.at_rest == bake.frames < settled_frames(105)
    taken = bake.health["settling_dissipation_J"]
    assert 0.0 < taken < CALM * bake.health["energy_scale_J"]
    assert taken == pytest.approx(sum(row["settling_dissipation"] for row in bake.per_frame))
    cache = Usd.Stage.Open(str(done.root))
    health = cache.GetPrimAtPath("/Sphere").GetAttribute("gaussianFlesh:health:settlingDissipation")
    assert health.Get(float(bake.frames)) == pytest.approx(
        bake.per_frame[-1]["settling_dissipation"]
    )
    alone = gf_usd.bake(
        SPHERE, output=tmp_path / "t.usda", only="mesh", frames=bake.frames, no_settling=True,
        rolling_resistance=0, **SMALL,
    )  # fmt: skip
    (other,) = alone.bakes
    assert "settling_dissipation_J" not in other.health
    assert other.per_frame[-1]["kinetic"] > bake.per_frame[-1]["kinetic"]


TABLE = f"""#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{{
    def Xform "Ball" ( prepend apiSchemas = ["GaussianFleshBakeAPI"]
                       references = @{SPHERE}@ )
    {{
        uniform bool gaussianFlesh:enabled = 1
        double3 xformOp:translate = (0, 1.02, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def Cube "Table" ( prepend apiSchemas = ["PhysicsCollisionAPI"] )
    {{
        double size = 1
        double3 xformOp:translate = (3, -0.5, 0)
        float3 xformOp:scale = (20, 1, 6)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }}
}}
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A ball on a table that is 20 m long, and no floor."""
    path = tmp_path / "table.usda"
    path.write_text(TABLE, encoding="utf-8")
    return path


def test_on_obstacles_rest_says_how_long(table: Path) -> None:
    plan = gf_usd.inspect(table, **FEW).plan
    assert plan.settings.floor is None
    assert plan.choices.until_rest


@pytest.mark.slow
def test_without_gravity_slow_motion_is_left_as_it_is(tmp_path: Path) -> None:
    speed = 0.05  # [m/s], which is calm: v^2 / 2 is a hundredth of CALM g0 r
    done = gf_usd.bake(
        SPHERE, output=tmp_path / "s.usda", only="mesh", gravity=0, frames=40,
        velocity=(speed, 0.0, 0.0), **FEW,
    )  # fmt: skip
    first, last = done.bakes[0].per_frame[0], done.bakes[0].per_frame[-1]
    # a float32 velocity is off by at most half an ulp a substep
    steps = sum(row["substeps"] for row in done.bakes[0].per_frame)
    assert last["momentum"][0] == pytest.approx(first["momentum"][0], rel=2.0**-24 * (1 + steps))
    assert first["momentum"][0] == pytest.approx(speed * first["mass"], rel=1e-6)


@pytest.mark.slow
def test_a_ball_of_rubber_comes_to_rest(tmp_path: Path) -> None:
    done = gf_usd.bake(
        SPHERE, output=tmp_path / "s.usda", only="mesh", particles=300, material="rubber"
    )
    (bake,) = done.bakes
    assert bake.at_rest
    # what is taken is of bounces of half a radius and less
    assert bake.health["settling_dissipation_J"] < LOW * bake.per_frame[0]["mass"] * G0


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_ball_that_rolls_on_a_table_stops_on_it_or_falls(table: Path, tmp_path: Path) -> None:
    """It stops after 5/7 v^2 / (2 c g) as on the floor; faster, it falls off the end at 13 m."""
    common = {"only": "mesh", "particles": 300, "material": "metal", "friction": 1.0}
    slow = gf_usd.bake(
        table, output=tmp_path / "s.usda", velocity=(1.5, 0.0, 0.0), rolling_resistance=0.1,
        **common,
    )  # fmt: skip
    (bake,) = slow.bakes
    assert bake.at_rest
    x = [row["center"][0] for row in bake.per_frame]
    way = (5.0 / 7.0 * 1.5) ** 2 / (10.0 / 7.0 * 0.1 * G0)
    assert 0.5 * way < x[-1] - x[0] < 1.5 * way
    assert bake.health["fallen_bodies"] == 0
    assert not [w for _, w in slow.warnings if w.about == "fallen"]
    fast = gf_usd.bake(
        table, output=tmp_path / "f.usda", velocity=(14.0, 0.0, 0.0), rolling_resistance=0.0,
        **common,
    )  # fmt: skip
    (bake,) = fast.bakes
    assert bake.at_rest  # nothing is left that could
    assert bake.health["fallen_bodies"] == 1
    (warning,) = [w for _, w in fast.warnings if w.about == "fallen"]
    assert "the body fell past every obstacle" in warning.message
    assert (
        f"metal: ends at frame {bake.frames}: the body has fallen past every obstacle" in fast.notes
    )


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_ball_that_rolls_comes_to_a_stop(tmp_path: Path) -> None:
    """v falls by 5/7 c g: in v^2 / (10/7 c g) of way; a soft ball rolls on a flat, and less far."""
    c, speed = 0.1, 1.5
    done = gf_usd.bake(
        SPHERE, output=tmp_path / "s.usda", only="mesh", particles=600, material="metal", drop=0,
        velocity=(speed, 0.0, 0.0), friction=1.0, rolling_resistance=c, frames="rest",
    )  # fmt: skip
    (bake,) = done.bakes
    assert bake.at_rest
    x = [row["center"][0] for row in bake.per_frame]
    rolling = 5.0 / 7.0 * speed  # once friction has made it roll
    way = rolling**2 / (10.0 / 7.0 * c * G0)
    assert 0.5 * way < x[-1] - x[0] < 1.5 * way

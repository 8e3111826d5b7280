"""--flesh: a character is soft around its bones, from the bind pose into its animation."""

from __future__ import annotations

from pathlib import Path

import gltf_arm
import numpy as np
import pytest
from arm import (
    FIRST,
    LAST,
    WIDTH,
    arm,
    cached,
    captured,
    drawn,
    points,
    skinned,
    swinging,
    write,
)
from pxr import Usd
from small_bakes import BLOCK

import gf_usd
from gf_usd.physics.grid.goals import NodeGoals
from gf_usd.pipeline.frames.period import PERIODIC
from gf_usd.prepare.options.texts import MOST_CYCLES
from gf_usd.prepare.prepare import prepare

FEW = {"particles": 400, "preroll": 12, "progress": None}


@pytest.mark.slow
def test_a_baked_arm_keeps_its_animation_and_is_skinned_once(tmp_path: Path) -> None:
    path = write(tmp_path, arm())
    out = tmp_path / "out.usda"
    result = gf_usd.bake(path, flesh=True, output=out, material="rubber", **FEW)
    assert (result.frames, result.health["rollbacks"]) == (LAST - FIRST + 1, 0)
    assert not result.findings
    stage = Usd.Stage.Open(str(out))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (FIRST, LAST)
    mesh = stage.GetPrimAtPath("/Arm/Skin")
    assert not mesh.GetRelationship("skel:skeleton").GetTargets()
    assert mesh.GetAttribute("points").GetTimeSamples() == [float(k) for k in range(1, 14)]
    # rubber of 0.2 MPa bends under its weight by rho g L^4 / (8 E I) of 8 mm with half of it free,
    # and the flesh inside of a sharp bend goes other ways than skinning has it
    for code in (FIRST, LAST):
        away = drawn(stage, code) - skinned(path, code)
        assert np.linalg.norm(away, axis=1).max() < 0.25 * WIDTH
        assert np.sqrt((away**2).sum(1).mean()) < 0.1 * WIDTH
    assert "no floor" in " ".join(result.notes)


def test_frames_before_the_animation_are_simulated_but_not_written(tmp_path: Path) -> None:
    path = write(tmp_path, arm())
    out = tmp_path / "out.usda"
    result = gf_usd.bake(path, flesh=True, output=out, range="3:4", handles=1, **FEW)
    stage = Usd.Stage.Open(str(out))
    samples = stage.GetPrimAtPath("/Arm/Skin").GetAttribute("points").GetTimeSamples()
    assert samples == [2.0, 3.0, 4.0, 5.0]
    assert result.frames == 4


def test_the_skin_of_a_gltf_file_is_flesh(tmp_path: Path) -> None:
    """Bones, frames and rest shape are those of the file, and goals draw to where glTF poses it."""
    path = gltf_arm.write(tmp_path)
    options = {"particles": 300, "goal_frequency": 4.0, "output": tmp_path / "out.usda"}
    plan, source = prepare(path, flesh=True, draw=None, **options)
    assert source is not None
    assert [pin.name for pin in plan.pins] == ["/arm/Skeleton:A", "/arm/Skeleton:A/B"]
    assert (plan.settings.fps, plan.settings.frames - plan.settings.first) == (24.0, LAST)
    assert plan.goals is not None
    (surface,) = plan.asset.surfaces
    ends = np.flatnonzero(np.abs(points()[:, 0] - 1.0) > 0.9)  # each hangs on one joint
    pose = plan.goals.pose(surface.points[ends])
    for frame in (0, LAST - FIRST):
        wanted = gltf_arm.posed(frame)[ends]
        # of single precision, and of the last joint's weight on samples that lie near
        np.testing.assert_allclose(pose(plan.settings.first + frame), wanted, atol=1e-3)


@pytest.mark.slow
def test_a_baked_gltf_file_is_a_layer_over_its_skeleton(tmp_path: Path) -> None:
    path, out = gltf_arm.write(tmp_path), tmp_path / "out.usda"
    result = gf_usd.bake(path, flesh=True, output=out, material="rubber", **FEW)
    assert (result.frames, result.findings) == (LAST - FIRST + 1, ())
    stage = Usd.Stage.Open(str(out))
    assert not stage.GetPrimAtPath("/arm/Skin").GetRelationship("skel:skeleton").GetTargets()
    assert stage.GetPrimAtPath("/arm/Skeleton/Animation").IsValid()
    for frame in (0, LAST - FIRST):
        away = drawn(stage, FIRST + frame, "/arm/Skin") - gltf_arm.posed(frame)
        assert np.sqrt((away**2).sum(1).mean()) < 0.1 * WIDTH  # as of the arm in USD


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"flesh": True, "pins": ["box:0,0,0,1,1,1"]}, "flesh=True cannot be combined with pins"),
        ({"flesh": True, "drop": "1"}, "flesh=True cannot be combined with drop"),
        ({"flesh": True, "solver": "ul"}, "does not support flesh=True"),
        ({"bone_radius": 0.4}, "bone_radius=0.4 is for flesh=True"),
        ({"squish": 0.5}, "squish=0.5 is for flesh=True"),
        ({"preroll": 4}, "preroll=4 is for flesh=True"),
        ({"loop": 2}, "loop=2 is for flesh=True"),
        ({"loop": True}, "loop='auto' is for flesh=True"),
        ({"flesh": True, "loop": "often"}, "loop is 'often'"),
        ({"flesh": True, "loop": 0}, "loop is 0"),
        ({"flesh": True, "loop": 2, "frames": 4}, "loop=2 writes one cycle"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    tmp_path: Path, options: dict[str, object], message: str
) -> None:
    with pytest.raises(gf_usd.GfUsdError) as caught:
        gf_usd.bake(write(tmp_path, arm()), **options)
    assert message in caught.value.message
    assert caught.value.hint


def test_an_asset_without_a_skeleton_is_refused(tmp_path: Path) -> None:
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    for name, text, message in (
        ("block.usda", BLOCK, "no skeleton poses"),
        ("triangle.obj", triangle, "skeletons of .obj files are not supported"),
    ):
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(gf_usd.GfUsdError) as caught:
            gf_usd.bake(path, flesh=True, output=tmp_path / "out.usda")
        assert message in caught.value.message
        assert str(path) in caught.value.message


@pytest.mark.slow
def test_flesh_follows_a_cache_of_points(tmp_path: Path) -> None:
    """As it follows the skeleton that the points were made by."""
    source = write(tmp_path, arm())
    path, out = tmp_path / "cache.usda", tmp_path / "out.usda"
    path.write_text(cached(source), encoding="utf-8")
    result = gf_usd.bake(path, flesh=True, output=out, material="rubber", **FEW)
    assert (result.frames, result.health["rollbacks"]) == (LAST - FIRST + 1, 0)
    assert not result.findings
    assert any("pieces along its medial axis follow" in note for note in result.notes)
    stage = Usd.Stage.Open(str(out))
    for code in (FIRST, LAST):
        away = drawn(stage, code) - skinned(source, code)
        assert np.linalg.norm(away, axis=1).max() < 0.25 * WIDTH  # as of the arm with a skeleton
        assert np.sqrt((away**2).sum(1).mean()) < 0.1 * WIDTH


def paint(goal: float) -> str:
    return f"float primvars:gaussianFlesh:goal = {goal!r}"


@pytest.mark.parametrize(
    ("more", "given", "frequency"),
    [("", None, None), ("", 2.0, 2.0), (paint(0.2), None, 2.0), (paint(0.2), 6.0, 3.0)],
)
def test_goals_are_springs_of_the_frequency_asked_for_or_painted(
    tmp_path: Path, more: str, given: float | None, frequency: float | None
) -> None:
    path = write(tmp_path, arm(more=more))
    options = {"particles": 300, "goal_frequency": given, "output": tmp_path / "out.usda"}
    plan, _ = prepare(path, flesh=True, draw=None, **options)
    if frequency is None:
        assert plan.goals is None
        return
    assert plan.goals is not None
    rate = plan.goals.rate(np.array([[0.5, 0.0, 0.0]]))
    np.testing.assert_allclose(rate, 2.0 * np.pi * frequency, rtol=1e-6)
    assert ("painted goals" in " ".join(plan.notes)) == (bool(more) and given is None)


@pytest.mark.parametrize("on_subset", [False, True])
def test_a_goal_with_time_samples_changes_the_springs(tmp_path: Path, on_subset: bool) -> None:
    """0.2, half the frequency, up to the middle; straight from there to 0.8, twice of it."""
    keys = "float primvars:gaussianFlesh:goal.timeSamples = { 1: 0.2, 7: 0.2, 13: 0.8 }"
    path = write(tmp_path, arm(more=subset(list(range(34)), keys) if on_subset else keys))
    options = {"particles": 300, "goal_frequency": 2.0, "output": tmp_path / "out.usda"}
    plan, _ = prepare(path, flesh=True, draw=None, **options)
    assert plan.goals is not None
    assert plan.goals.rates is not None
    assert plan.goals.moving
    w = plan.goals.rates(np.array([[0.5, 0.0, 0.0]]))
    first = plan.settings.first
    for frame, goal in (
        (0, 0.2),
        (first, 0.2),
        (first + 6, 0.2),
        (first + 9, 0.5),
        (first + 12, 0.8),
    ):
        wanted = 2.0 * np.pi * 2.0 * np.sqrt(goal / (1.0 - goal))
        np.testing.assert_allclose(w(frame), wanted, rtol=1e-5)
    assert any("time samples" in note for note in plan.notes)
    nodes = NodeGoals(plan.goals, np.array([[0.5, 0.0, 0.0]]), dt=1e-4)
    k = [nodes.between(first + frame, 1.0 / 24.0)[6] for frame in (6, 12)]
    np.testing.assert_allclose(k, np.square(2.0 * np.pi * 2.0 * np.array([0.5, 2.0])), rtol=1e-5)


def subset(faces: list[int], goal: str) -> str:
    """A GeomSubset of the arm's skin with a goal."""
    return f"""def GeomSubset "Forearm"
        {{
            uniform token elementType = "face"
            int[] indices = {faces}
            {goal}
        }}"""


FOREARM = [1, *range(18, 34)]  # the end and the sides with x >= 1


@pytest.mark.parametrize(("whole", "upper"), [("", 2.0), (paint(0.2), 1.0)])
def test_a_goal_of_a_subset_goes_before_that_of_the_mesh(
    tmp_path: Path, whole: str, upper: float
) -> None:
    """0.8 doubles the frequency under these faces, and what lies elsewhere is as without them."""
    path = write(tmp_path, arm(more=f"{whole}\n{subset(FOREARM, paint(0.8))}"))
    options = {"particles": 300, "goal_frequency": 2.0, "output": tmp_path / "out.usda"}
    plan, _ = prepare(path, flesh=True, draw=None, **options)
    assert plan.goals is not None
    rate = plan.goals.rate(np.array([[0.3, 0.0, 0.0], [1.7, 0.0, 0.0]]))
    np.testing.assert_allclose(rate, 2.0 * np.pi * np.array([upper, 4.0]), rtol=1e-2)


@pytest.mark.parametrize(
    ("faces", "goal", "message"),
    [
        (FOREARM, paint(1.5), "1 of 1 values out of range; the first is 1.5"),
        (FOREARM, "float[] primvars:gaussianFlesh:goal = [0, 1]", "has 2 values on a subset of"),
        ([0, 34], paint(0.5), "range from 0 to 34, but the mesh has 34 faces"),
    ],
)
def test_a_goal_of_a_subset_that_is_none_is_refused(
    tmp_path: Path, faces: list[int], goal: str, message: str
) -> None:
    path = write(tmp_path, arm(more=subset(faces, goal)))
    with pytest.raises(gf_usd.InputError) as caught:
        gf_usd.bake(path, flesh=True, output=tmp_path / "out.usda", **FEW)
    assert message in caught.value.message
    assert "</Arm/Skin/Forearm>" in caught.value.message
    assert caught.value.hint


def test_limits_are_shares_of_the_distance_to_the_bone(tmp_path: Path) -> None:
    """The middle of a side of the upper arm: 0.2 m from its bone, or the edge of a cell."""
    options = {"particles": 300, "squish": 0.75, "stretch": 0.4, "output": tmp_path / "out.usda"}
    plan, _ = prepare(write(tmp_path, arm()), flesh=True, draw=None, **options)
    assert plan.goals is not None
    limits, X = plan.goals.limits, np.array([[0.5, 0.5 * WIDTH, 0.0]])
    assert limits is not None
    np.testing.assert_allclose(plan.goals.rate(X), 0.0)  # limits bring no springs
    r = max(0.5 * WIDTH, 2.0 * plan.particles.lattice)
    np.testing.assert_allclose(limits.toward(X), 0.25 * r, rtol=1e-6)
    np.testing.assert_allclose(limits.away(X), 0.4 * r, rtol=1e-6)
    place, n = limits.carried(X)(0.0)
    np.testing.assert_allclose((place, n), (X, [[0.0, 1.0, 0.0]]), atol=1e-6)


@pytest.mark.slow
def test_flesh_that_hangs_keeps_its_limit(tmp_path: Path) -> None:
    """Without it, jelly around thin bones leaves its skinned pose by more."""
    path, away = write(tmp_path, arm()), {}
    options = {"material": "jelly", "bone_radius": 0.2, "particles": 400}
    for stretch in (None, 0.2):
        out = tmp_path / f"out{stretch}.usda"
        result = gf_usd.bake(
            path, flesh=True, output=out, stretch=stretch, gravity=19.6, preroll=12,
            progress=None, **options,
        )  # fmt: skip
        assert result.health["rollbacks"] == 0
        way = drawn(Usd.Stage.Open(str(out)), LAST) - skinned(path, LAST)
        away[stretch] = np.linalg.norm(way, axis=1)
    plan, _ = prepare(
        path, flesh=True, draw=None, stretch=0.2, output=tmp_path / "o.usda", **options
    )
    assert plan.goals is not None
    assert plan.goals.limits is not None
    limit = plan.goals.limits.away(points())
    # at twice gravity s = 0.46: there is room, but for the inner side of the elbow, where the flesh
    # of both bones presses on each other
    inner = np.abs(points()[:, 0] - 1.0) < 0.3
    assert (away[0.2] <= limit)[~inner].all()
    assert (away[0.2] <= 1.3 * limit).all()
    assert (away[None] > limit).mean() > 0.5


def test_a_goal_out_of_range_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, arm(more=paint(1.5)))
    with pytest.raises(gf_usd.GfUsdError) as caught:
        gf_usd.bake(path, flesh=True, output=tmp_path / "out.usda", **FEW)
    assert "</Arm/Skin>" in caught.value.message
    assert "1 of 1 values out of range; the first is 1.5" in caught.value.message


@pytest.mark.slow
def test_a_repeated_cycle_is_nearer_to_periodic(tmp_path: Path) -> None:
    path = write(tmp_path, swinging())
    left = []
    for times in (2, 4):
        out = tmp_path / f"out{times}.usda"
        result = gf_usd.bake(
            path, flesh=True, output=out, material="jelly", loop=times, gravity=0.0, **FEW
        )
        assert result.frames == LAST - FIRST + 1
        assert result.health["loop_cycles"] == times
        left.append(result.health["loop_difference_m"])
        stage = Usd.Stage.Open(str(out))
        # the end of the cycle is its start, but for what is not periodic yet; vertices lie beyond
        # the particles
        close = np.linalg.norm(drawn(stage, LAST) - drawn(stage, FIRST), axis=1).max()
        assert close < 10.0 * left[-1]
    assert left[1] < 0.5 * left[0]


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_cycle_that_ends_by_itself_is_the_one_that_so_many_times_make(tmp_path: Path) -> None:
    path = write(tmp_path, swinging())
    options = {"material": "jelly", "gravity": 0.0, **FEW}
    options |= {"goal_frequency": 3.0, "samples_per_frame": 2}
    auto = gf_usd.bake(path, flesh=True, output=tmp_path / "auto.usda", loop=True, **options)
    times, share = auto.health["loop_cycles"], auto.health["loop_difference_share"]
    assert 2 < times < MOST_CYCLES
    # two cycles differed by no more before the last one was made, and differences shrink
    assert share <= PERIODIC
    first = auto.bakes[0].per_frame[0]["time_code"]
    assert first + (auto.health["frames"] - 1) == LAST
    counted = gf_usd.bake(path, flesh=True, output=tmp_path / "counted.usda", loop=times, **options)
    assert counted.health["frames"] == auto.health["frames"]
    assert counted.health["loop_difference_share"] == share
    stages = [Usd.Stage.Open(str(tmp_path / f"{name}.usda")) for name in ("auto", "counted")]
    for code in np.arange(FIRST, LAST + 0.5, 0.5).tolist():
        one, other = (drawn(stage, code) for stage in stages)
        np.testing.assert_array_equal(one, other)
    seam = np.linalg.norm(drawn(stages[0], LAST) - drawn(stages[0], FIRST), axis=1).max()
    assert seam < 10.0 * auto.health["loop_difference_m"]  # vertices lie beyond the particles


def test_an_animation_that_does_not_close_is_no_cycle(tmp_path: Path) -> None:
    path = write(tmp_path, arm(lift=(0.0, 1.0)))
    with pytest.raises(gf_usd.InputError, match="is not cyclic") as caught:
        gf_usd.bake(path, flesh=True, output=tmp_path / "out.usda", loop=2, **FEW)
    assert caught.value.hint


@pytest.mark.slow
def test_a_capture_next_to_a_skeleton_follows_its_bones(tmp_path: Path) -> None:
    path = captured(tmp_path)
    out = tmp_path / "out.usda"
    result = gf_usd.bake(path, flesh=True, output=out, material="rubber", **FEW)
    assert (result.frames, result.health["rollbacks"]) == (LAST - FIRST + 1, 0)
    assert not result.findings
    assert any("each point follows the nearest bones of /Arm/Skel" in n for n in result.notes)
    stage = Usd.Stage.Open(str(out))
    positions = stage.GetPrimAtPath("/Arm/Person").GetAttribute("positions")
    source = Usd.Stage.Open(str(path))
    rest = np.asarray(source.GetPrimAtPath("/Arm/Person").GetAttribute("positions").Get())
    # B turns by 60 degrees about (1, 0, 0): its flesh goes there, as that of the skinned arm does.
    turn = np.deg2rad(60.0)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    far = rest[:, 0] > 1.4
    wanted = (rest[far] - [1.0, 0.0, 0.0]) @ R.T + [1.0, 0.0, 0.0]
    away = np.asarray(positions.Get(LAST))[far] - wanted
    assert np.sqrt((away**2).sum(1).mean()) < 0.1 * WIDTH

"""Retimed bakes: the analytic motion of `small_stages` at other times, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt
from small_sources import INSTANCES, MOVING, PLAIN, SEVERAL_ROOTS, SKINNED, Source
from small_stages import CUBE, CUBE_POINTS, EPS, bake, motion, open_with, world

from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.frames.choices import Choices
from gf_usd.delivery.resample import sample_as_played
from gf_usd.delivery.retime import Retimed, retime
from gf_usd.layers.check.run import check_file
from gf_usd.system.atomic_files import partial_path

FRAMES, FPS = 7, 24.0
BODY = "/duck/geo/body"
# The motion is a squash of 5 rad/s, turned at 2 rad/s, of points within 1.8 m: its fourth
# derivative is below (5 + 2)^4 1.4 1.8 m/s^4.
FOURTH = 7.0**4 * 1.4 * 1.8
POSITION = FOURTH / FPS**4 / 384.0  # of Hermite's cubic
SPEED = FOURTH / FPS**3 * np.sqrt(3.0) / 216.0


PUSHED = Source(
    f"""
def Xform "duck"
{{
    def Mesh "skin"
    {{ {CUBE} }}
    def Xform "wall"
    {{
        double3 xformOp:translate.timeSamples = {{ 10: (0, 0, 0), 20: (10, 0, 0) }}
        uniform token[] xformOpOrder = ["xformOp:translate"]
        token visibility.timeSamples = {{ 10: "inherited", 13: "invisible" }}
        vector3f[] velocities.timeSamples = {{ 10: [(24, 0, 0)], 20: [(24, 0, 0)] }}
    }}
}}
""",
    PLAIN.head,
)
"""A body, and a prim that only the source animates."""

GROWS = f"points.timeSamples = {{ 1: {CUBE_POINTS}, 9: {CUBE_POINTS.replace('1', '9')} }}"
BLOB = Source(
    f"""def Mesh "blob"
{{ {CUBE.replace(f"points = {CUBE_POINTS}", GROWS)} }}
""",
    MOVING.head,
)
"""A body that is a root prim."""

FLAGS = """
def Xform "flag" (
    instanceable = true
    references = </_flag>
)
{
}
class Xform "_flag"
{
    def Xform "cloth"
    {
        double3 xformOp:translate.timeSamples = { 10: (0, 0, 0), 20: (10, 0, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return baked(PLAIN, tmp_path)


def baked(source: Source, folder: Path, **options: object) -> Path:
    return bake(source.asset(folder), folder, frames=FRAMES, **options)[0].path


def values(stage: Usd.Stage, name: str, code: float, path: str = BODY) -> np.ndarray:
    return np.array(stage.GetPrimAtPath(path).GetAttribute(name).Get(code), np.float64)


def rest_of(stage: Usd.Stage) -> np.ndarray:
    return values(stage, "points", 10.0) - motion(np.zeros((1, 3)), 0.0)[0]


def particles(stage: Usd.Stage) -> str:
    (found,) = [p for p in stage.Traverse() if p.GetAttribute("positions")]
    return str(found.GetPath())


@pytest.mark.parametrize("clips", [0, 3], ids=["one file", "clips"])
def test_slow_motion_is_the_motion_at_half_the_time(tmp_path: Path, clips: int) -> None:
    before = baked(PLAIN, tmp_path, choices=Choices(clip_frames=clips))
    done = retime(before, tmp_path / "slow.usda", speed=0.5)
    assert (done.frames, done.start, done.end) == (2 * FRAMES - 1, 10.0, 8.0 + 2 * FRAMES)
    old, new = open_with(before, "rubber"), Usd.Stage.Open(str(done.path))
    assert (new.GetStartTimeCode(), new.GetEndTimeCode()) == (done.start, done.end)
    rest = rest_of(old)
    splats = particles(new)
    for k in range(2 * FRAMES - 1):
        x, v, _ = motion(rest, k / 2.0 / FPS)
        # float32 keeps 6e-8 of coordinates of about a meter
        assert np.abs(values(new, "points", 10.0 + k) - x).max() < POSITION + EPS
        assert np.abs(values(new, "velocities", 10.0 + k) - v / 2.0).max() < SPEED + EPS
        quaternions = values(new, "orientations", 10.0 + k, splats)
        assert np.linalg.norm(quaternions, axis=1) == pytest.approx(1.0, abs=1e-6)
    for k in range(FRAMES):  # at the frames of the bake, what it has
        for name in ("points", "normals", "extent"):
            assert np.array_equal(
                values(new, name, 10.0 + 2 * k), values(old, name, 10.0 + k), equal_nan=True
            )
    assert not check_file(done.path).findings
    assert old.GetPrimAtPath(BODY).GetAttribute("points").GetNumTimeSamples() == FRAMES


def test_linear_interpolation_would_be_coarser(root: Path) -> None:
    # The bound of the test above separates the cubic from a straight line.
    stage = open_with(root, "rubber")
    rest = rest_of(stage)
    straight = (values(stage, "points", 12.0) + values(stage, "points", 13.0)) / 2.0
    assert np.abs(straight - motion(rest, 2.5 / FPS)[0]).max() > 10.0 * (POSITION + EPS)


def test_keys_hold_and_play_backwards(root: Path, tmp_path: Path) -> None:
    keys = [(1.0, 10.0), (4.0, 13.0), (6.0, 13.0), (9.0, 10.0)]
    done = retime(root, tmp_path / "again.usda", keys=keys)
    assert (done.frames, done.start, done.end) == (9, 1.0, 9.0)
    old, new = open_with(root, "rubber"), Usd.Stage.Open(str(done.path))
    for code, at, rate in [
        (1, 10, 1),
        (3, 12, 1),
        (4, 13, 0),
        (5, 13, 0),
        (7, 12, -1),
        (9, 10, -1),
    ]:
        assert np.array_equal(values(new, "points", code), values(old, "points", at))
        speeds = rate * values(old, "velocities", at)
        assert values(new, "velocities", code) == pytest.approx(speeds, abs=1e-6)


def test_fast_motion_skips_frames(root: Path, tmp_path: Path) -> None:
    done = retime(root, tmp_path / "fast.usda", speed=2.0)
    assert (done.frames, done.end) == (4, 13.0)
    old, new = open_with(root, "rubber"), Usd.Stage.Open(str(done.path))
    for k in range(4):
        assert np.array_equal(values(new, "points", 10.0 + k), values(old, "points", 10.0 + 2 * k))


def test_a_box_holds_what_is_between_its_frames(root: Path, tmp_path: Path) -> None:
    done = retime(root, tmp_path / "slow.usda", speed=0.1)
    stage = Usd.Stage.Open(str(done.path))
    for k in range(done.frames):
        low, high = values(stage, "extent", 10.0 + k)
        points = values(stage, "points", 10.0 + k)
        assert (points >= low - EPS).all()
        assert (points <= high + EPS).all()


@pytest.mark.parametrize(
    "source", [MOVING, SKINNED, SEVERAL_ROOTS], ids=["moving", "skin", "roots"]
)
def test_the_source_plays_at_the_same_speed(tmp_path: Path, source: Source) -> None:
    before = baked(source, tmp_path)
    done = retime(before, tmp_path / "slow.usda", speed=0.5)
    old, new = open_with(before, "rubber"), open_with(done.path, "rubber")
    start = old.GetStartTimeCode()
    meshes = [p for p in old.Traverse() if p.IsA(UsdGeom.Mesh)]
    assert meshes
    for prim in meshes:
        path = str(prim.GetPath())
        for k in range(FRAMES):
            then = world(old, path, "points", start + k)
            assert world(new, path, "points", start + 2 * k) == pytest.approx(then, abs=1e-5)


def test_every_variant_has_a_cache(tmp_path: Path) -> None:
    before = baked(PLAIN, tmp_path, looks=("rubber", "jelly"))
    done = retime(before, tmp_path / "slow.usda", speed=0.5)
    names = {path.name for path in done.caches}
    assert names == {"slow.rubber.cache.usdc", "slow.jelly.cache.usdc"}
    for name in ("rubber", "jelly"):
        stage = open_with(done.path, name)
        assert stage.GetPrimAtPath(BODY).GetAttribute("points").GetNumTimeSamples() == done.frames
    none = open_with(done.path, "none")
    assert none.GetPrimAtPath(BODY).GetAttribute("points").GetNumTimeSamples() == 0


def test_it_can_lie_in_another_folder(root: Path, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    done = retime(root, tmp_path / "there" / "slow.usda", speed=0.5)
    text = done.path.read_text()
    assert str(tmp_path) not in text
    assert "../duck.usda" in text
    assert "./slow.cache.usdc" in text
    assert Usd.Stage.Open(str(done.path)).GetPrimAtPath(BODY).GetAttribute("normals").Get(11.0)


def with_obstacles(root: Path) -> None:
    """Add an obstacle file to the metadata of a bake."""
    layer = Sdf.Layer.FindOrOpen(str(root))
    about = dict(layer.customLayerData["gaussianFlesh"])
    about["colliders"] = Vt.StringArray(["./sets/wall.obj"])
    about["colliderHashes"] = Vt.StringArray(["ab"])
    layer.customLayerData = {**layer.customLayerData, "gaussianFlesh": about}
    layer.Save()


def test_files_of_obstacles_are_found_from_another_folder(root: Path, tmp_path: Path) -> None:
    with_obstacles(root)
    target = tmp_path / "elsewhere" / "deeper" / "slow.usda"
    target.parent.mkdir(parents=True)
    retime(root, target, speed=0.5)
    about = Sdf.Layer.FindOrOpen(str(target)).customLayerData["gaussianFlesh"]
    named = (target.parent / about["colliders"][0]).resolve()
    assert named == (root.parent / "sets" / "wall.obj").resolve()
    assert list(about["colliderHashes"]) == ["ab"]


def refused(kind: type[Exception], message: str, *given: object, **options: object) -> None:
    with pytest.raises(kind, match=message):
        retime(*given, **options)


def test_what_makes_no_sense_is_refused_and_nothing_is_written(root: Path, tmp_path: Path) -> None:
    there = sorted(tmp_path.iterdir())
    slow = tmp_path / "slow.usda"
    refused(UsageError, "either --speed or --keys is needed, but not both", root, slow)
    refused(
        UsageError,
        "either --speed or --keys is needed, but not both",
        root,
        slow,
        speed=1.0,
        keys=[(1, 1), (2, 2)],
    )
    refused(UsageError, "--speed is 0", root, slow, speed=0.0)
    refused(UsageError, "--speed is nan", root, slow, speed=float("nan"))
    refused(UsageError, "--keys is 1:10", root, slow, keys=[(1.0, 10.0)])
    refused(UsageError, "--keys is 2:10,1:11", root, slow, keys=[(2.0, 10.0), (1.0, 11.0)])
    refused(UsageError, r"--keys 5:99 is outside the time codes 10 to 16", root, slow,
            keys=[(1.0, 10.0), (5.0, 99.0)])  # fmt: skip
    refused(UsageError, "does not end in", root, tmp_path / "slow.usdz", speed=0.5)
    refused(UsageError, "is not a folder", root, tmp_path / "no" / "slow.usda", speed=0.5)
    refused(UsageError, "is an input", root, root, speed=0.5)
    refused(UsageError, "is an input", root, root.with_suffix(".usdc"), speed=0.5)
    refused(InputError, "no caches", tmp_path / "duck.usda", slow, speed=0.5)
    refused(InputError, "gone.usda does not exist", tmp_path / "gone.usda", slow, speed=0.5)
    refused(InputError, "is a folder", tmp_path, slow, speed=0.5)
    assert sorted(tmp_path.iterdir()) == there


@pytest.mark.parametrize(
    "source", [MOVING, SKINNED, SEVERAL_ROOTS, PUSHED], ids=["moving", "skin", "roots", "obstacle"]
)
def test_the_source_follows_keys(tmp_path: Path, source: Source) -> None:
    """What bodies hit and what carries them is where it was, at each time of the result."""
    before = baked(source, tmp_path)
    old = open_with(before, "rubber")
    start = old.GetStartTimeCode()
    keys = [(start, start), (start + 2.0, start + 2.0), (start + 6.0, start + 4.0),
            (start + 8.0, start + 2.0)]  # fmt: skip
    done = retime(before, tmp_path / "ramp.usda", keys=keys)
    assert done.notes == ()
    assert {*check_file(done.path).findings} <= {*check_file(before).findings}
    new = open_with(done.path, "rubber")
    meshes = [str(p.GetPath()) for p in old.Traverse() if p.IsA(UsdGeom.Mesh)]
    assert meshes
    # half frames are where the caches are resampled by cubics, which has a test of its own
    for code, then in ((0, 0), (1, 1), (2, 2), (4, 3), (6, 4), (7, 3), (8, 2)):
        for path in meshes:
            wanted = world(old, path, "points", start + then)
            assert world(new, path, "points", start + code) == pytest.approx(wanted, abs=1e-5)


def test_what_only_the_source_moves_follows_keys_between_its_samples(tmp_path: Path) -> None:
    before = baked(PUSHED, tmp_path)
    keys = [(10.0, 10.0), (20.0, 15.0), (25.0, 15.0)]
    stage = Usd.Stage.Open(str(retime(before, tmp_path / "ramp.usda", keys=keys).path))
    wall = stage.GetPrimAtPath("/duck/wall")
    for code in range(10, 26):
        then = min(10.0 + 0.5 * (code - 10.0), 15.0)
        assert wall.GetAttribute("xformOp:translate").Get(code)[0] == pytest.approx(then - 10.0)
        # stage units per second of playback: half as fast, then held
        speed = 0.5 * 24.0 if code < 20 else 0.0
        assert wall.GetAttribute("velocities").Get(code)[0][0] == pytest.approx(speed)
        shown = wall.GetAttribute("visibility").Get(code) != "invisible"
        assert shown == (then < 13.0)
    again = retime(Path(stage.GetRootLayer().realPath), tmp_path / "again.usda",
                   keys=[(1.0, 20.0), (11.0, 10.0)])  # fmt: skip
    stage = Usd.Stage.Open(str(again.path))
    wall = stage.GetPrimAtPath("/duck/wall")
    backwards = [wall.GetAttribute("xformOp:translate").Get(code)[0] for code in range(1, 12)]
    assert backwards == pytest.approx([5.0 - 0.5 * k for k in range(11)])


@pytest.mark.parametrize("source", [MOVING, BLOB], ids=["moving", "root mesh"])
def test_without_a_bake_its_source_follows_keys(tmp_path: Path, source: Source) -> None:
    """A cache has these points; the mesh kept its speed where there is none."""
    before = baked(source, tmp_path)
    done = retime(before, tmp_path / "ramp.usda", keys=[(1.0, 1.0), (5.0, 3.0)])
    again = retime(done.path, tmp_path / "again.usda", keys=[(1.0, 5.0), (5.0, 1.0)])
    assert done.notes == again.notes == ()
    for variant in ("rubber", "none"):
        old, new, back = (open_with(p, variant) for p in (before, done.path, again.path))
        (mesh,) = [str(prim.GetPath()) for prim in old.Traverse() if prim.IsA(UsdGeom.Mesh)]
        for code in (1.0, 3.0, 5.0):
            wanted = world(old, mesh, "points", 1.0 + 0.5 * (code - 1.0))
            assert world(new, mesh, "points", code) == pytest.approx(wanted, abs=1e-5)
            assert world(back, mesh, "points", 6.0 - code) == pytest.approx(wanted, abs=1e-5)


def test_what_one_of_several_caches_has_follows_keys_in_all_variants(tmp_path: Path) -> None:
    before = baked(PUSHED, tmp_path, looks=("rubber", "jelly"))
    cache = Sdf.Layer.FindOrOpen(str(tmp_path / "duck.jelly.cache.usdc"))
    wall = Sdf.CreatePrimInLayer(cache, "/duck/wall")
    moved = Sdf.AttributeSpec(wall, "xformOp:translate", Sdf.ValueTypeNames.Double3)
    for code in range(10, 17):
        cache.SetTimeSample(moved.path, code, Gf.Vec3d(0.0, code - 10.0, 0.0))
    cache.Save()
    done = retime(before, tmp_path / "ramp.usda", keys=[(10.0, 10.0), (16.0, 13.0)])
    for variant, axis in (("rubber", 0), ("jelly", 1), ("none", 0)):
        stage = open_with(done.path, variant)
        for code in (10.0, 12.0, 16.0):
            at = values(stage, "xformOp:translate", code, "/duck/wall")
            assert at == pytest.approx(0.5 * (code - 10.0) * np.eye(3)[axis])


def test_samples_in_the_root_layer_that_win_over_a_cache_follow_keys(root: Path) -> None:
    layer = Sdf.Layer.FindOrOpen(str(root))
    body = Sdf.CreatePrimInLayer(layer, BODY)
    box = Sdf.AttributeSpec(body, "extent", Sdf.ValueTypeNames.Float3Array)
    for code in (10.0, 16.0):
        layer.SetTimeSample(box.path, code, Vt.Vec3fArray(2, Gf.Vec3f(code)))
    layer.Save()
    done = retime(root, root.with_name("ramp.usda"), keys=[(10.0, 10.0), (16.0, 13.0)])
    for variant in ("rubber", "none"):
        stage = open_with(done.path, variant)
        assert values(stage, "extent", 14.0) == pytest.approx(12.0)


def test_splines_follow_keys(tmp_path: Path) -> None:
    turning = PUSHED.body.replace(
        "token visibility",
        """double turn.spline = { bezier, 10: 0; post linear, 20: 10; post linear }
        token visibility""",
    )
    before = baked(Source(turning, PUSHED.head), tmp_path)
    done = retime(before, tmp_path / "ramp.usda", keys=[(10.0, 10.0), (16.0, 13.0)])
    stage = Usd.Stage.Open(str(done.path))
    for code in range(10, 17):
        turn = stage.GetPrimAtPath("/duck/wall").GetAttribute("turn").Get(code)
        assert turn == pytest.approx(0.5 * (code - 10.0))


def test_each_attribute_of_the_source_is_sampled_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sampled: list[Sdf.Path] = []

    def noted(layer: Sdf.Layer, path: Sdf.Path, *rest: Any) -> None:
        sampled.append(path)
        sample_as_played(layer, path, *rest)

    monkeypatch.setattr("gf_usd.delivery.retime.sample_as_played", noted)
    before = baked(PUSHED, tmp_path, looks=("rubber", "jelly"))
    retime(before, tmp_path / "ramp.usda", keys=[(10.0, 10.0), (16.0, 13.0)])
    assert sorted(path.name for path in sampled) == [
        "velocities",
        "visibility",
        "xformOp:translate",
    ]


def test_samples_in_other_variants_are_refused(root: Path, tmp_path: Path) -> None:
    layer = Sdf.Layer.FindOrOpen(str(root))
    path = "/duck{gaussianFlesh=rubber}{display=mesh}geo"
    shown = Sdf.AttributeSpec(Sdf.CreatePrimInLayer(layer, path), "x", Sdf.ValueTypeNames.Double)
    layer.SetTimeSample(shown.path, 10.0, 1.0)
    layer.Save()
    refused(InputError, "is animated but not baked", root, tmp_path / "ramp.usda",
            keys=[(10.0, 10.0), (16.0, 13.0)])  # fmt: skip


def test_what_keys_cannot_retime_is_named(tmp_path: Path) -> None:
    done = retime(
        baked(Source(PUSHED.body + FLAGS, PUSHED.head), tmp_path), tmp_path / "ramp.usda",
        keys=[(10.0, 10.0), (16.0, 13.0)],
    )  # fmt: skip
    (note,) = done.notes
    assert note.startswith("</flag/cloth>: its animation is inside an instance")


def test_it_is_said_in_which_variants_keys_cannot_retime_something(tmp_path: Path) -> None:
    """A cache ends the instances that it has points of."""
    growing = INSTANCES.body.replace(f"points = {CUBE_POINTS}", GROWS)
    growing = growing.replace("rel material:binding = </_materials/red>", "")  # ends them as well
    before = baked(Source(growing, MOVING.head), tmp_path)
    done = retime(before, tmp_path / "ramp.usda", keys=[(1.0, 1.0), (5.0, 3.0)])
    assert [note.split(" inside ")[0] for note in done.notes] == [
        f"</root/{side}/seat>: in the variant none its animation is" for side in ("left", "right")
    ]


def test_a_full_disk_leaves_nothing_under_a_partial_name(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gf_usd.delivery.retime.write_placed", full)
    with pytest.raises(OSError, match="No space"):
        retime(root, tmp_path / "slow.usda", speed=0.5)
    for name in ("slow.usda", "slow.cache.usdc"):
        assert not (tmp_path / name).exists()
        assert not partial_path(tmp_path / name).exists()


def test_the_result_says_what_was_done(root: Path, tmp_path: Path) -> None:
    done: Retimed = retime(root, tmp_path / "slow.usda", speed=0.25)
    layer = Sdf.Layer.FindOrOpen(str(done.path))
    data = layer.customLayerData["gaussianFlesh"]
    assert data["retime"] == {"speed": 0.25}
    assert data["command"] == "gf-usd bake duck.usda"
    (reference,) = layer.GetPrimAtPath("/duck").referenceList.prependedItems
    assert reference.layerOffset == Sdf.LayerOffset(10.0 * (1 - 4.0), 4.0)
    assert reference.layerOffset * 10.0 == 10.0

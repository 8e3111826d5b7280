"""Which states a bake writes: samples per frame, a range, handles."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pxr import Sdf, Usd
from small_bakes import names, strict

from gf_usd.layers.check.run import check_file

SMALL = ("--particles", "300", "--drop", "20", "-q", "--json")
BLOCK = "/World/Block"
SPLATS = "/World/GaussianFlesh/Gaussians"
# Points are floats of up to 250 here.
ROUNDING = 2e-5


def positions(path: Path, prim: str = BLOCK) -> dict[float, np.ndarray]:
    stage = Usd.Stage.Open(str(path))
    name = "positions" if prim == SPLATS else "points"
    attribute = stage.GetAttributeAtPath(f"{prim}.{name}")
    return {t: np.array(attribute.Get(t)) for t in attribute.GetTimeSamples()}


def velocities(path: Path) -> dict[float, np.ndarray]:
    stage = Usd.Stage.Open(str(path))
    attribute = stage.GetAttributeAtPath(f"{BLOCK}.velocities")
    return {t: np.array(attribute.Get(t)) for t in attribute.GetTimeSamples()}


@pytest.fixture
def baked(gf_usd, here: Path, block: Path):
    """Bake under a name; returns its root layer and what it printed."""

    def run(name: str, *options: str) -> tuple[Path, dict]:
        done = gf_usd("bake", block, *SMALL, "-o", f"{name}.usda", *options)
        assert done.status == 0, done.err
        return here / f"{name}.usda", strict(done.out)

    return run


@pytest.mark.slow
def test_samples_between_frames_are_simulated_states(baked) -> None:
    whole, _ = baked("whole", "--frames", "14")
    fine, result = baked("fine", "--frames", "14", "--samples-per-frame", "4")
    coarse, subs = positions(whole), positions(fine)
    assert list(subs) == [101.0 + k / 4.0 for k in range(13 * 4 + 1)]
    # In free fall the position is the integrator's parabola whatever its step; g = 981 cm/s^2.
    for code in (101.25, 102.5, 103.75):
        t = (code - 101.0) / 48.0
        fallen = subs[101.0][:, 2] - subs[code][:, 2]
        np.testing.assert_allclose(fallen, 0.5 * 981.0 * t * t, atol=ROUNDING * 10)
    # It lands after 9.7 frames.  Then the step differs a little (frames are cut into whole
    # substeps), so the two part by what the integrator errs.
    assert max(np.abs(subs[t] - coarse[t]).max() for t in coarse) < 0.05
    between = 0.5 * (coarse[112.0] + coarse[113.0])
    assert np.abs(subs[112.5] - between).max() > 0.05
    assert result["frames"] == 14
    assert len(positions(fine, SPLATS)) == 13 * 4 + 1
    stage = Usd.Stage.Open(str(fine))
    assert (stage.GetFramesPerSecond(), stage.GetTimeCodesPerSecond()) == (48.0, 48.0)
    assert check_file(fine).ok


@pytest.mark.slow
def test_health_stays_that_of_frames(baked, here: Path) -> None:
    # without flight, whose frames have no substeps
    options = ("--frames", "14", "--no-shortcuts")
    _, one = baked("one", *options)
    _, four = baked("four", *options, "--samples-per-frame", "4")
    reports = [strict((here / f"{name}.report.json").read_text()) for name in ("one", "four")]
    frames = [report["bakes"][0]["per_frame"] for report in reports]
    assert [len(rows) for rows in frames] == [14, 14]
    assert [row["time_code"] for row in frames[1]] == [101.0 + k for k in range(14)]
    a, b = one["bakes"][0]["health"], four["bakes"][0]["health"]
    assert a["frames"] == b["frames"] == 14
    assert a["first_contact_frame"] == b["first_contact_frame"]
    # as many substeps but for the rounding up to whole ones, four times a frame
    assert a["substeps"] <= b["substeps"] <= a["substeps"] + 4 * 13
    # the deepest of the same fall; a tenth for the instants at which it is looked at
    assert b["deepest_penetration_m"] == pytest.approx(a["deepest_penetration_m"], rel=0.1)
    assert sum(row["substeps"] for row in frames[1]) == b["substeps"]


def test_velocities_of_samples_are_per_second(baked) -> None:
    fine, _ = baked("fine", "--frames", "4", "--samples-per-frame", "2")
    seen = velocities(fine)
    for code in (101.5, 103.5):
        np.testing.assert_allclose(seen[code][:, 2], -981.0 * (code - 101.0) / 48.0, rtol=1e-4)


@pytest.mark.slow
def test_a_range_writes_a_part_of_the_same_motion(baked) -> None:
    whole, _ = baked("whole", "--frames", "14")
    part, result = baked("part", "--frames", "14", "--range", "108:112")
    all_of, some = positions(whole), positions(part)
    assert list(some) == [108.0, 109.0, 110.0, 111.0, 112.0]
    for code, points in some.items():
        np.testing.assert_array_equal(points, all_of[code])
    assert result["frames"] == 5
    assert result["bakes"][0]["frames"] == 5
    # everything that was simulated is judged, from the start
    assert result["bakes"][0]["health"]["frames"] == 12
    layer = Sdf.Layer.FindOrOpen(str(part))
    # the source's own range is 101 to 110
    assert (layer.startTimeCode, layer.endTimeCode) == (101.0, 112.0)


@pytest.mark.slow
def test_a_range_alone_says_how_long_is_simulated(baked) -> None:
    part, _ = baked("part", "--range", "103:118")
    assert list(positions(part)) == [float(t) for t in range(103, 119)]
    open_end, _ = baked("open", "--range", "103:", "--frames", "5")
    assert list(positions(open_end)) == [103.0, 104.0, 105.0]
    open_start, _ = baked("start", "--range", ":103")
    assert list(positions(open_start)) == [101.0, 102.0, 103.0]


@pytest.mark.slow
def test_handles_hold_before_and_continue_after(baked) -> None:
    longer, _ = baked("longer", "--frames", "8")
    handled, result = baked("handled", "--frames", "6", "--handles", "2")
    all_of, some = positions(longer), positions(handled)
    assert list(some) == [float(t) for t in range(99, 109)]
    for code in (99.0, 100.0):
        np.testing.assert_array_equal(some[code], all_of[101.0])
        assert not velocities(handled)[code].any()
    for code in all_of:
        np.testing.assert_array_equal(some[code], all_of[code])
    assert result["frames"] == 10
    assert result["bakes"][0]["health"]["frames"] == 8
    layer = Sdf.Layer.FindOrOpen(str(handled))
    assert (layer.startTimeCode, layer.endTimeCode) == (99.0, 110.0)
    assert check_file(handled).ok


def test_range_handles_and_samples_together(baked) -> None:
    part, result = baked("part", "--range", "102:103", "--handles", "2", "--samples-per-frame", "2")
    assert list(positions(part)) == [100.0 + 0.5 * k for k in range(11)]
    assert result["frames"] == 6
    held = positions(part)
    np.testing.assert_array_equal(held[100.5], held[101.0])
    assert np.abs(held[101.5] - held[101.0]).max() > 0.01


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--range", "90:105"), "--range 90:105 begins before the simulation, which starts at"),
        (("--range", "105:90"), "--range is '105:90'"),
        (("--range", "7"), "--range is '7'"),
        (("--range", "a:b"), "--range is 'a:b'"),
        (("--range", "101.2:101.8"), "--range 101.2:101.8 contains no frame"),
        (("--range", "101:120", "--frames", "5"), "ends after the last of --frames 5, at time"),
        (("--handles", "-1"), "--handles is -1"),
        (("--samples-per-frame", "0"), "--samples-per-frame is 0"),
        (("--samples-per-frame", "2", "--wls"), "--samples-per-frame 2 cannot be combined with"),
    ],
)
def test_what_makes_no_sense_is_refused(
    gf_usd, here: Path, block: Path, options: tuple[str, ...], message: str
) -> None:
    done = gf_usd("bake", block, *SMALL, *options)
    assert done.status == 2
    assert message in done.err
    assert names(here) == []


@pytest.mark.slow
def test_a_pin_follows_the_animation_between_frames(gf_usd, here: Path, tmp_path: Path) -> None:
    from small_bakes import BLOCK as TEXT

    moving = TEXT.replace(
        'def Mesh "Block"\n    {',
        'def Mesh "Block"\n    {\n        double3 xformOp:translate.timeSamples = '
        "{ 101: (0, 0, 0), 105: (40, 0, 0) }\n"
        '        uniform token[] xformOpOrder = ["xformOp:translate"]\n'
        '        def GeomSubset "top" { uniform token elementType = "face"\n'
        "            int[] indices = [1]\n        }",
    )
    path = tmp_path / "moving.usda"
    path.write_text(moving)
    done = gf_usd(
        "bake", path, *SMALL, "--frames", "4", "--pin", f"{BLOCK}/top",
        "--samples-per-frame", "2", "--floor", "none", "-o", "pinned.usda",
    )  # fmt: skip
    assert done.status == 0, done.err
    stage = Usd.Stage.Open("pinned.usda")
    points = stage.GetAttributeAtPath(f"{BLOCK}.points")
    rest = np.array(points.Get(101.0))
    top = rest[:, 2] > 220.0
    for code in points.GetTimeSamples():
        # held points stay at rest in the moving frame of the mesh, between frames as well
        np.testing.assert_allclose(np.array(points.Get(code))[top], rest[top], atol=1e-3)


@pytest.mark.slow
def test_a_report_draws_health_where_it_was(baked) -> None:
    from gf_usd.readers.pictures.recording import BakedMotion
    from gf_usd.view.report.curves import _health_curve
    from gf_usd.view.report.record import load_report, make_record

    root, _ = baked("part", "--range", "103:105", "--handles", "3", "--samples-per-frame", "2")
    recording = BakedMotion(root).recording()
    record = make_record(recording, *load_report(root))
    curve = _health_curve(
        SimpleNamespace(recording=recording),
        record,
        "energy",
        [row["energy"] for row in record.frames],
    )
    # written from 100; simulated, and judged, from 101
    assert curve["x"] == pytest.approx([k / 48.0 for k in range(1, 9)])
    assert curve["y"] == [row["energy"] for row in record.frames]

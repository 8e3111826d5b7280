"""gf-usd preview as films, sheets and colors, from the command line to the file."""

from __future__ import annotations

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from previews import FALLING_BOX
from previews import preview as run

import gf_usd.system.usd_schema  # noqa: F401  (before any test here opens a stage: one of them bakes)
from gf_usd.api.drawing.options import Span, parse_limits, parse_span, time_codes
from gf_usd.core.errors import InputError, UsageError

# 24 frames per second, from time code 1 to 3: three frames
BOX = FALLING_BOX.replace("endTimeCode = 3", "endTimeCode = 3\n timeCodesPerSecond = 24")


@pytest.fixture
def stage(tmp_path):
    path = tmp_path / "box.usda"
    path.write_text(BOX, encoding="utf-8")
    return path


def pixels(path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def mp4(path) -> tuple[dict, list[np.ndarray]]:
    reader = imageio_ffmpeg.read_frames(str(path))
    facts = next(reader)
    width, height = facts["size"]
    return facts, [np.frombuffer(f, np.uint8).reshape(height, width, 3).astype(int) for f in reader]


@pytest.mark.slow
def test_a_film_is_its_frames_in_real_time(stage, tmp_path):
    done = run(stage, "-o", tmp_path / "a.mp4", "--size", "160x120")
    assert done.exit_code == 0, done.output
    facts, frames = mp4(tmp_path / "a.mp4")
    assert facts["size"] == (160, 120)
    assert facts["fps"] == 24.0
    assert len(frames) == 3
    for i, code in ((0, 1), (2, 3)):
        still = tmp_path / f"{code}.png"
        assert run(stage, "-o", still, "--frame", code, "--size", "160x120").exit_code == 0
        # 4:2:0 blurs the red of the box along its outline only
        assert np.median(np.abs(frames[i] - pixels(still))) <= 2
        assert np.abs(frames[i] - pixels(still)).mean() < 4.0
    assert np.abs(frames[2] - frames[0]).max() > 100


@pytest.mark.slow
def test_quiet_prints_no_frames(stage, tmp_path):
    done = run(stage, "-o", tmp_path / "a.gif", "--size", "80x60", "-q")
    assert (done.exit_code, done.output) == (0, "")


@pytest.mark.slow
def test_range_rate_and_odd_sizes_of_a_film(stage, tmp_path):
    out = tmp_path / "a.mp4"
    done = run(stage, "-o", out, "--size", "81x61", "--time-codes", "2:3:0.25", "--fps", "10")
    assert done.exit_code == 0, done.output
    assert "H.264 needs an even width and height: 82x62" in done.output
    facts, frames = mp4(out)
    assert (facts["size"], facts["fps"], len(frames)) == ((82, 62), 10.0, 5)


def test_a_gif_shows_what_the_pictures_show(stage, tmp_path):
    out = tmp_path / "a.gif"
    assert run(stage, "-o", out, "--size", "120x90", "--time-codes", "1:3").exit_code == 0
    assert run(stage, "-o", tmp_path / "1.png", "--frame", "1", "--size", "120x90").exit_code == 0
    with Image.open(out) as film:
        assert film.n_frames == 3
        # the dither, the grouping of codes and the nearest of 255 colors: a few codes
        error = np.abs(np.asarray(film.convert("RGB")).astype(int) - pixels(tmp_path / "1.png"))
    assert error.mean() < 3.0


def test_a_gif_is_thinned_to_what_browsers_play(stage, tmp_path):
    done = run(stage, "-o", tmp_path / "a.gif", "--size", "60x40", "--time-codes", "1:3:0.25")
    # a quarter of a time code at 24 a second are 96 frames per second: every second one is kept
    assert "at most 50 frames per second: 48 are kept" in done.output
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 5


def test_a_sheet_has_a_tile_for_each_frame(stage, tmp_path):
    out = tmp_path / "a.png"
    arguments = ("--sheet", "3", "--columns", "3", "--size", "120x90")
    assert run(stage, "-o", out, *arguments).exit_code == 0
    page = pixels(out)
    gap, band = 2, 19  # captions of 11 pixels
    assert page.shape[:2] == (band + 90 + 2 * gap, 3 * 120 + 4 * gap)
    tiles = [page[gap + band : -gap, gap + i * (120 + gap) :][:, :120] for i in range(3)]
    rows = [np.flatnonzero((t[..., 0] > 2 * t[..., 1]).any(axis=1)).mean() for t in tiles]
    assert rows[0] < rows[1] < rows[2]


@pytest.mark.parametrize("order", ["inherited invisible", "invisible inherited"])
def test_a_time_at_which_nothing_is_visible_is_an_empty_tile(stage, tmp_path, order):
    first, last = order.split()
    seen = f'{{ 1: "{first}", 3: "{last}" }}'
    hidden = BOX.replace("size = 2\n", f"size = 2\n token visibility.timeSamples = {seen}\n")
    stage.write_text(hidden, encoding="utf-8")
    arguments = ("--sheet", "2", "--columns", "2", "--size", "120x90")
    done = run(stage, "-o", tmp_path / "a.png", *arguments)
    assert done.exit_code == 0, done.output
    assert "note: pictures of times at which nothing is visible are empty" in done.output
    page = pixels(tmp_path / "a.png")
    tiles = [page[21:111, 2 + i * 122 :][:, :120] for i in range(2)]
    red = [int((tile[..., 0] > 2 * tile[..., 1]).sum()) for tile in tiles]
    assert red[order.split().index("inherited")] > 200
    assert red[order.split().index("invisible")] == 0
    corners = [tile[80:, :10].mean() for tile in tiles]  # of the same floor and background
    assert corners[0] == pytest.approx(corners[1], abs=8.0)


def test_the_stage_keeps_its_camera(tmp_path):
    path = tmp_path / "seen.usda"
    camera = """
def Camera "cam" {
    float focalLength = 50
    double3 xformOp:translate = (0, 0, 30)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
    path.write_text(BOX + camera, encoding="utf-8")
    out = tmp_path / "a.png"
    assert run(path, "-o", out, "--camera", "/cam", "--size", "120x90").exit_code == 0
    picture = pixels(out)
    red = np.argwhere(picture[..., 0] > 2 * picture[..., 1])
    # straight above the box, whose top of 2 x 2 is 25 away: 2 * 50 / 15.2908 / 25 of the height
    side = 90 * 2 * 50 / 15.2908 / 25
    assert red.mean(axis=0) == pytest.approx((44.5, 59.5), abs=0.6)
    assert np.ptp(red, axis=0) + 1 == pytest.approx((side, side), abs=2)
    with pytest.raises(InputError, match="there is no camera </none>"):
        raise run(path, "--camera", "/none").exception


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "a.mp4", "--frame", "1"), "--frame does not apply to the other options"),
        (("--time-codes", "1:2"), "--time-codes does not apply"),
        (("--fps", "12"), "--fps does not apply"),
        (("--columns", "2"), "--columns does not apply"),
        (("--color-range", "0:1"), "--color-range does not apply"),
        (("-o", "a.gif", "--sheet", "4"), "--sheet writes a PNG"),
        (("--sheet", "0"), "--sheet 0 is too small"),
        (("-o", "a.mp4", "--fps", "0"), "--fps 0.0 is not a frame rate"),
        (("-o", "a.mp4", "--time-codes", "0:2"), "outside the motion"),
        (("-o", "a.mp4", "--time-codes", "3:1"), "ends before it begins"),
        (("-o", "a.mp4", "--time-codes", "1"), "is not a range"),
        (("-o", "a.mp4", "--time-codes", "1:2:0"), "the step is not above 0"),
        (("-o", "a.mp4", "--time-codes", "1:3:1e-9"), "more than the limit of 100000"),
        (("-o", "none/a.mp4",), "none is not a folder"),
        (("-o", "a.mkv",), "does not end in .png, .mp4 or .gif"),
        (("--color", "heat"), "unknown --color heat"),
        (("--color", "strain", "--color-range", "1:1"), "--color-range 1:1 is empty"),
        (("--color", "strain", "--color-range", "big"), "--color-range big is not a range"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_words(stage, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    error = run(stage, *arguments).exception
    assert isinstance(error, UsageError)
    assert message in error.message
    assert error.hint
    assert [path.name for path in tmp_path.iterdir()] == ["box.usda"]


def test_a_still_makes_no_film(tmp_path):
    path = tmp_path / "still.usda"
    path.write_text('#usda 1.0\ndef Cube "box" {\n}\n', encoding="utf-8")
    error = run(path, "-o", tmp_path / "a.mp4").exception
    assert isinstance(error, UsageError)
    assert "does not move" in error.message


@pytest.mark.slow
def test_a_bake_in_colors_has_a_legend_next_to_the_body(gf_usd, here, block):
    done = gf_usd("bake", block, "--particles", 300, "--frames", 8, "--drop", 0, "--stress", "-q")
    assert done.status == 0, done.err
    pictures = {}
    for color, more in (("none", ()), ("strain", ()), ("stress", ("--color-range", "0:1e3"))):
        out = here / f"{color}.png"
        arguments = ("--color", color, *more, "--size", "320x240")
        done = gf_usd("preview", here / "block.rubber.usda", "-o", out, "--frame", 105, *arguments)
        assert done.status == 0, done.err
        pictures[color] = pixels(out)
    for color in ("strain", "stress"):
        left = pictures[color][:, :60]
        yellow = (left[..., 0] > 200) & (left[..., 1] > 180) & (left[..., 2] < 120)
        assert yellow.sum() > 20
        assert not np.array_equal(pictures[color], pictures["none"])
    none = pictures["none"][:, :60]
    assert not ((none[..., 0] > 200) & (none[..., 2] < 120)).any()


def test_spans_and_ranges_are_read():
    assert parse_span("1:24:2") == Span(first=1.0, last=24.0, step=2.0)
    assert parse_span(":12") == Span(first=None, last=12.0, step=None)
    assert parse_limits("-1:0.5") == (-1.0, 0.5)
    known = (1.0, 2.0, 10.0)
    assert time_codes(parse_span("3:"), known, 2.0, stage) == [3.0, 5.0, 7.0, 9.0]
    assert len(time_codes(None, known, 0.1, stage)) == 91


# a red cube of 2 that leaves the top of a gray one at once and falls to -60
FALLING = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
)
def Cube "Stand" {
    double size = 4
    double3 xformOp:translate = (0, -2, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Cube "Ball" {
    double size = 2
    color3f[] primvars:displayColor = [(0.8, 0.02, 0.02)]
    double3 xformOp:translate.timeSamples = {
        1: (0, 1, 0), 2: (2, 1, 0), 3: (3.2, -1, 0), 4: (3.2, -10, 0), 5: (3.2, -30, 0),
        6: (3.2, -60, 0)
    }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


def test_the_tiles_of_a_sheet_end_where_all_that_moves_has_left_the_picture(tmp_path):
    path = tmp_path / "falling.usda"
    path.write_text(FALLING)
    arguments = ("--sheet", "3", "--columns", "3", "--size", "120x90")
    done = run(path, "-o", tmp_path / "a.png", *arguments)
    assert done.exit_code == 0, done.output
    page = pixels(tmp_path / "a.png")
    tiles = [page[21:111, 2 + i * 122 :][:, :120] for i in range(3)]
    assert all((tile[..., 0] > 2 * tile[..., 1]).sum() > 50 for tile in tiles)
    # a range that is asked for is kept: the last of its tiles has no ball
    run(path, "-o", tmp_path / "b.png", *arguments, "--time-codes", "1:6")
    last = pixels(tmp_path / "b.png")[21:111, 2 + 2 * 122 :][:, :120]
    assert (last[..., 0] > 2 * last[..., 1]).sum() == 0

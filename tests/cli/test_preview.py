"""gf-usd preview, from the command line to the pixels."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from previews import FALLING_BOX
from previews import preview as run

from gf_usd.api.drawing.options import parse_size
from gf_usd.core.errors import UsageError


@pytest.fixture
def stage(tmp_path):
    path = tmp_path / "box.usda"
    path.write_text(FALLING_BOX, encoding="utf-8")
    return path


def red_rows(path) -> np.ndarray:
    pixels = np.asarray(Image.open(path)).astype(int)
    return np.flatnonzero((pixels[..., 0] > 2 * pixels[..., 1]).any(axis=1))


@pytest.mark.slow
def test_a_picture_of_each_frame_with_one_camera(stage, tmp_path):
    rows = {}
    for frame in (1, 3):
        out = tmp_path / f"{frame}.png"
        done = run(stage, "-o", out, "--frame", frame, "--size", "120x160")
        assert done.exit_code == 0, done.output
        assert Image.open(out).size == (120, 160)
        rows[frame] = red_rows(out)
    # the camera holds the whole fall: the box moves down the picture and never leaves it
    assert rows[1].min() > 0
    assert rows[3].max() < 159
    assert rows[3].mean() > rows[1].mean() + 30


def test_the_same_command_gives_the_same_bytes(stage, tmp_path):
    for name in ("a.png", "b.png"):
        assert run(stage, "-o", tmp_path / name, "--size", "80x60").exit_code == 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_the_default_name_is_in_this_folder(stage, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert run(stage, "--size", "40x30").exit_code == 0
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["box.png"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--frame", "7"), "outside the motion"),
        (("--size", "big"), "--size big is not a size"),
        (("--size", "0x10"), "--size 0x10 is not a size"),
        (("--size", "10x9000"), "10x9000 pixels cannot be rendered"),
        (("--show", "fog"), "Unknown --show fog"),
        (("-o", "out.jpg"), "does not end in .png, .mp4 or .gif"),
    ],
)
def test_wrong_options_are_refused_in_words(stage, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    error = run(stage, *arguments).exception
    assert isinstance(error, UsageError)
    assert message in error.message
    assert error.hint
    assert [path.name for path in tmp_path.iterdir()] == ["box.usda"]


def test_sizes_are_read():
    assert parse_size("640x480") == (640, 480)
    assert parse_size(" 64 X 48 ") == (64, 48)

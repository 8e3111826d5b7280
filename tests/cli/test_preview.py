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


def test_quiet(stage, tmp_path):
    done = run(stage, "-o", tmp_path / "a.png", "--size", "80x60", "-q")
    assert (done.exit_code, done.output) == (0, "")
    assert (tmp_path / "a.png").exists()


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
        (("--show", "fog"), "unknown --show fog"),
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


WALLED = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
    startTimeCode = 1
    endTimeCode = 3
)
def Mesh "soft" {
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [3, 3, 3, 3]
    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]
    color3f[] primvars:displayColor = [(0.8, 0.05, 0.05)]
    point3f[] points.timeSamples = {
        1: [(-1,-1,1), (1,-1,1), (0,1,1), (0,0,3)],
        3: [(-1,-1,0), (1,-1,0), (0,1,0), (0,0,2)],
    }
}
def ParticleField3DGaussianSplat "Gaussians" {
    rel gaussianFlesh:sourceMeshes = </soft>
    token visibility = "invisible"
}
def Cube "wall" {
    double size = 1
    double3 xformOp:translate = (0, -3, 2)
    double3 xformOp:scale = (30, 0.2, 4)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}
def Cube "back" {
    double size = 1
    double3 xformOp:translate = (0, BACK, 2)
    double3 xformOp:scale = (30, 0.2, 9)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}
def Camera "front" {
    double3 xformOp:translate = (0, -20, 1.5)
    float3 xformOp:rotateXYZ = (90, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
}
"""


@pytest.mark.slow
def test_a_body_behind_a_wall_is_drawn_from_a_side_that_shows_it(tmp_path):
    path, out = tmp_path / "walled.usda", tmp_path / "walled.png"
    path.write_text(WALLED.replace("BACK", "40"), encoding="utf-8")
    done = run(path, "-o", out, "--size", "80x60")
    assert "note: obstacles hide the body from the usual camera" in done.output
    assert "148 degrees to the right" in done.output
    assert len(red_rows(out)) > 10
    done = run(path, "-o", out, "--size", "80x60", "--camera", "/front")
    assert "in 2 of 2 frames that were examined; hint: leave out --camera" in done.output
    assert len(red_rows(out)) == 0


@pytest.mark.slow
def test_a_body_that_no_view_shows_is_reported(tmp_path):
    path, out = tmp_path / "walled.usda", tmp_path / "walled.png"
    lid = '\ndef Cube "lid" { double size = 60\ndouble3 xformOp:translate = (0, 0, 35)\n'
    lid += 'uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
    path.write_text(WALLED.replace("BACK", "3") + lid, encoding="utf-8")
    done = run(path, "-o", out, "--size", "80x60")
    assert done.exit_code == 0
    hidden = "note: the body is hidden by obstacles or outside of the picture in 2 of 2 frames"
    assert f"{hidden} that were examined; hint: choose a view with --camera PRIM" in done.output

"""Captures through the command line: every format, sequences, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from captures import ball, define, write_ply
from pxr import Usd, UsdGeom
from small_bakes import BLOCK, names

from gf_usd.core.matrices import gaussian_axes
from gf_usd.core.radiance import Y_0
from gf_usd.readers.splats.ply import read_splat_ply
from gf_usd.readers.splats.raw import ROW
from gf_usd.readers.splats.spz import read_spz

SMALL = ("--particles", "200", "--frames", "4", "--drop", "0.1")
SINGLE = 1e-6


def write_splat(path: Path, splats) -> Path:
    rows = np.zeros(len(splats), ROW)
    rows["at"], rows["scale"] = splats.positions, splats.scales
    rgb = 255 * (0.5 + Y_0 * splats.harmonics[:, 0])
    rows["rgba"][:, :3], rows["rgba"][:, 3] = np.rint(rgb), 255
    rows["turn"] = np.clip(np.rint(128 * splats.orientations + 128), 0, 255)
    path.write_bytes(rows.tobytes())
    return path


def write_usd(path: Path, *sets, unit=1.0) -> Path:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    UsdGeom.SetStageUpAxis(stage, "Y")
    for number, splats in enumerate(sets):
        define(stage, f"/ball{number or ''}", splats)
    stage.Save()
    return path


def positions(root: str, prim: str, time: float) -> np.ndarray:
    stage = Usd.Stage.Open(root)
    return np.asarray(stage.GetPrimAtPath(prim).GetAttribute("positions").Get(time))


@pytest.fixture
def rest():
    """What survives a .splat file: rotations of whole 128ths."""
    out = ball(300)
    turns = np.rint(128 * out.orientations) / 128
    return replace(out, orientations=turns / np.linalg.norm(turns, axis=1, keepdims=True))


@pytest.mark.slow
def test_one_capture_in_three_formats_moves_alike(gf_usd, here, tmp_path, rest):
    files = {
        "ply": (write_ply(tmp_path / "a.ply", rest), "/a/Splats"),
        "splat": (write_splat(tmp_path / "b.splat", rest), "/b/Splats"),
        "usd": (write_usd(tmp_path / "c.usda", rest), "/ball"),
    }
    found = {}
    for name, (path, prim) in files.items():
        done = gf_usd("bake", path, "--material", "jelly", *SMALL)
        assert done.status == 0, done.err
        found[name] = positions(f"{path.stem}.jelly.usda", prim, 4.0)
    assert np.abs(found["usd"] - (rest.positions + np.array([0, 0.1, 0]))).max() > 0.01
    for other in ("splat", "usd"):
        np.testing.assert_allclose(found[other], found["ply"], atol=SINGLE)


@pytest.mark.slow
def test_the_result_is_a_sound_layer_over_the_capture(gf_usd, here, tmp_path):
    path = write_ply(tmp_path / "ball.ply", ball(300, degree=2))
    done = gf_usd("bake", path, "--material", "jelly", *SMALL)
    assert done.status == 0, done.err
    assert "a surface was constructed around 300 of 300 Gaussians" in done.err
    assert names(here) == [
        "ball.jelly.cache.usdc", "ball.jelly.report.json", "ball.jelly.usda", "ball.source.usdc",
    ]  # fmt: skip
    checked = gf_usd("check", "ball.jelly.usda")
    assert "0 errors, 0 warnings" in checked.out
    stage = Usd.Stage.Open("ball.jelly.usda")
    splats = stage.GetPrimAtPath("/ball/Splats")
    assert UsdGeom.Imageable(splats).ComputeVisibility() == UsdGeom.Tokens.inherited
    # the particles inside are kept but not drawn
    flesh = UsdGeom.Imageable(stage.GetPrimAtPath("/ball/GaussianFlesh/Gaussians"))
    assert flesh.ComputeVisibility() == UsdGeom.Tokens.invisible
    shown = gf_usd("preview", "ball.jelly.usda", "--size", "80x60", "-o", "ball.png")
    assert shown.status == 0, shown.err
    assert names(here)[0] == "ball.jelly.cache.usdc"


@pytest.mark.slow
def test_sequences_of_ply_and_spz(gf_usd, here, tmp_path):
    rest = ball(300, degree=1)
    path = write_ply(tmp_path / "ball.ply", rest)
    arguments = ("bake", path, "--material", "jelly", *SMALL)
    done = gf_usd(*arguments, "--export-ply", "frames", "--export-spz", "frames")
    assert done.status == 0, done.err
    expected = [f"ball.jelly.{n:04d}.{kind}" for n in range(1, 5) for kind in ("ply", "spz")]
    assert names(here / "frames") == expected
    stage = Usd.Stage.Open("ball.jelly.usda")
    prim = stage.GetPrimAtPath("/ball/Splats")
    for number in range(1, 5):
        frame = read_splat_ply(here / "frames" / f"ball.jelly.{number:04d}.ply")
        for name in ("positions", "scales"):
            there = prim.GetAttribute(name).Get(float(number))
            np.testing.assert_allclose(getattr(frame, name), there, atol=SINGLE)
        packed = read_spz(here / "frames" / f"ball.jelly.{number:04d}.spz")
        np.testing.assert_allclose(packed.positions, frame.positions, atol=1e-5)
    # a second bake of fewer frames leaves none of the first behind
    again = gf_usd(*arguments, "--export-ply", "frames", "-o", "again.usda")
    assert again.status == 2
    assert "ball.jelly.0001.ply exists already" in again.err
    arguments = [word if word != "4" else "2" for word in arguments]
    again = gf_usd(*arguments, "--export-ply", "frames", "--overwrite")
    assert again.status == 0, again.err
    kept = [name for name in names(here / "frames") if name.endswith("ply")]
    assert kept == ["ball.jelly.0001.ply", "ball.jelly.0002.ply"]


def test_a_mesh_gives_its_particles_as_a_sequence(gf_usd, here, tmp_path):
    path = tmp_path / "block.usda"
    path.write_text(BLOCK, encoding="utf-8")
    done = gf_usd("bake", path, "--particles", "200", "--frames", "2", "--export-ply", "frames")
    assert done.status == 0, done.err
    frame = read_splat_ply(here / "frames" / "block.rubber.0002.ply")
    there = positions("block.rubber.usda", "/World/GaussianFlesh/Gaussians", 102.0)
    np.testing.assert_allclose(frame.positions, there, rtol=SINGLE)
    # the block's color (0.2, 0.4, 0.6) is linear, viewers of splats require it encoded
    shown = 0.5 + Y_0 * frame.harmonics[0, 0]
    np.testing.assert_allclose(shown, [0.4845, 0.6652, 0.7977], atol=1e-3)


@pytest.mark.slow
def test_several_captures_of_a_stage(gf_usd, here, tmp_path):
    far = ball(300, radius=0.25)
    far = replace(far, positions=far.positions + np.float32([2, 0, 0]))
    path = write_usd(tmp_path / "two.usda", ball(300, degree=1), far, unit=0.1)
    done = gf_usd("bake", path, "--material", "jelly", *SMALL, "--export-ply", "frames")
    assert done.status == 0, done.err
    frame = read_splat_ply(here / "frames" / "two.jelly.0003.ply")
    assert (len(frame), frame.degree) == (600, 1)
    both = [positions("two.jelly.usda", prim, 3.0) for prim in ("/ball", "/ball1")]
    np.testing.assert_allclose(frame.positions, np.concatenate(both), atol=SINGLE)
    assert "0 errors, 0 warnings" in gf_usd("check", "two.jelly.usda").out


@pytest.mark.slow
def test_two_materials_have_two_sequences(gf_usd, here, tmp_path):
    path = write_ply(tmp_path / "ball.ply", ball(300))
    done = gf_usd("bake", path, "--material", "jelly,rubber", *SMALL, "--export-spz", "frames")
    assert done.status == 0, done.err
    assert {name.split(".")[1] for name in names(here / "frames")} == {"jelly", "rubber"}


def test_what_is_no_body_is_refused(gf_usd, here, tmp_path):
    path = write_ply(tmp_path / "few.ply", ball(20))
    done = gf_usd("bake", path)
    assert done.status == 3
    assert f"{path}: </few/Splats>: 20 of its 20 Gaussians can bound a body" in done.err
    assert "at least 50 are needed" in done.err
    assert names(here) == []


@pytest.mark.slow
def test_inspect_knows_captures(gf_usd, here, tmp_path):
    path = write_ply(tmp_path / "ball.ply", ball(300))
    done = gf_usd("inspect", path, "--json", "--particles", "200")
    assert done.status == 0, done.err
    report = json.loads(done.out)
    assert report["bakeable"]
    (mesh,) = report["meshes"]
    assert (mesh["type"], mesh["watertight"]) == ("ParticleField3DGaussianSplat", True)
    assert any("a surface was constructed around" in note for note in report["notes"])


@pytest.mark.slow
def test_samples_handles_and_clips_hold_for_captures(gf_usd, here, tmp_path):
    path = write_usd(tmp_path / "ball.usda", ball(300, degree=1))
    more = ("--samples-per-frame", "2", "--handles", "1", "--clip-frames", "2")
    done = gf_usd("bake", path, "--material", "jelly", *SMALL, *more, "--export-ply", "frames")
    assert done.status == 0, done.err
    stage = Usd.Stage.Open("ball.jelly.usda")
    prim = stage.GetPrimAtPath("/ball")
    # frames -1 to 4 at time codes 0 to 5, two samples each
    times = [0.5 * k for k in range(11)]
    assert prim.GetAttribute("positions").GetTimeSamples() == times
    assert prim.GetAttribute("radiance:sphericalHarmonicsCoefficientsh").GetTimeSamples() == times
    assert len(names(here / "frames")) == 6
    for number in (1, 2, 6):
        frame = read_splat_ply(here / "frames" / f"ball.jelly.{number:04d}.ply")
        there = prim.GetAttribute("positions").Get(float(number - 1))
        np.testing.assert_allclose(frame.positions, there, atol=SINGLE)


@pytest.mark.slow
def test_a_held_capture_stands_still_under_a_turning_prim(gf_usd, here, tmp_path):
    path = write_usd(tmp_path / "ball.usda", ball(300))
    stage = Usd.Stage.Open(str(path))
    turn = UsdGeom.Xformable(stage.GetPrimAtPath("/ball")).AddRotateYOp()
    for time, angle in ((0.0, 0.0), (8.0, 80.0)):
        turn.Set(angle, time)
    stage.Save()
    done = gf_usd("bake", path, *SMALL, "--handles", "1", "--start", "4")
    assert done.status == 0, done.err
    assert "consists of Gaussians: no initial velocity is read" in done.err
    stage = Usd.Stage.Open("ball.rubber.usda")
    prim = stage.GetPrimAtPath("/ball")
    turned = []
    for time in (3.0, 4.0):
        place = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
        quaternions = np.asarray(prim.GetAttribute("orientations").Get(time), float)
        axes = gaussian_axes(quaternions[:, [3, 0, 1, 2]], prim.GetAttribute("scales").Get(time))
        axes = np.asarray(place)[:3, :3].T @ axes
        turned.append(axes @ axes.swapaxes(1, 2))
    size = np.abs(turned[1]).max()
    np.testing.assert_allclose(turned[0], turned[1], atol=SINGLE * size * 10)


@pytest.mark.slow
def test_without_the_mesh_a_capture_stays_and_still_gives_its_sequence(gf_usd, here, tmp_path):
    path = write_ply(tmp_path / "ball.ply", ball(300))
    arguments = ("bake", path, "--material", "jelly", *SMALL, "--export-ply", "frames")
    done = gf_usd(*arguments, "--only", "gaussians")
    assert done.status == 0, done.err
    stage = Usd.Stage.Open("ball.jelly.usda")
    splats = stage.GetPrimAtPath("/ball/Splats")
    assert splats.GetAttribute("positions").GetNumTimeSamples() == 0
    frames = [read_splat_ply(here / "frames" / f"ball.jelly.000{n}.ply") for n in (1, 4)]
    # it fell, and stays a capture
    assert frames[0].positions[:, 1].mean() - frames[1].positions[:, 1].mean() > 0.01
    assert len(frames[0]) == 300


@pytest.mark.slow
def test_a_box_pins_a_capture(gf_usd, here, tmp_path):
    path = write_ply(tmp_path / "ball.ply", ball(300))
    arguments = ("bake", path, "--material", "jelly", *SMALL, "--pin", "box:-1,0.2,-1,1,1,1")
    done = gf_usd(*arguments)
    assert done.status == 0, done.err
    rest = ball(300).positions
    first, last = (positions("ball.jelly.usda", "/ball/Splats", float(t)) for t in (1, 4))
    held = rest[:, 1] > 0.35  # more than a particle inside the box
    assert np.abs(last - first)[held].max() < 1e-5
    assert (first - last)[rest[:, 1] < -0.2, 1].min() > 1e-4


@pytest.mark.slow
def test_a_box_next_to_a_capture_is_refused_by_its_name(gf_usd, here, tmp_path):
    path = write_ply(tmp_path / "ball.ply", ball(300))
    done = gf_usd("bake", path, "--material", "jelly", *SMALL, "--pin", "box:5,5,5,6,6,6")
    assert done.status == 3
    assert "--pin box:5,5,5,6,6,6 does not touch the asset" in done.err

"""SPZ says that Y is up: its sequences stand as the bake does, PLY ones stay as the file is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from captures import ball, define, write_ply
from pxr import Usd, UsdGeom
from small_bakes import BLOCK

from gf_usd.core.matrices import gaussian_axes
from gf_usd.physics.per_particle import rotated
from gf_usd.readers.splats.ply import read_splat_ply
from gf_usd.readers.splats.spz import read_spz

SMALL = ("--particles", "200", "--frames", "3", "--drop", "0.1")
HALF_TURN = np.diag([1.0, -1.0, -1.0])
STOOD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # z goes to y
STEP = 1e-6  # of positions of size 1 in 23 bits
COARSE = 0.1  # scales in sixteenths of a logarithm, quaternions in 9 bits: of a covariance


def frames(folder: Path, stem: str) -> tuple:
    """The last frame of both sequences."""
    return read_splat_ply(folder / f"{stem}.0003.ply"), read_spz(folder / f"{stem}.0003.spz")


def same(ply, spz, turn: np.ndarray) -> None:
    """What SPZ holds is what PLY holds, turned."""
    np.testing.assert_allclose(spz.positions, ply.positions @ turn.T, atol=STEP)
    axes = turn @ gaussian_axes(ply.orientations, ply.scales)
    expected = axes @ axes.swapaxes(1, 2)
    axes = gaussian_axes(spz.orientations, spz.scales)
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    assert (np.abs(axes @ axes.swapaxes(1, 2) - expected) < COARSE * size).all()
    turned = rotated(ply.harmonics, np.tile(turn, (len(ply), 1, 1)))
    np.testing.assert_allclose(spz.harmonics, turned, atol=0.51 / 255 / 0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "turn"),
    [
        pytest.param("Y", np.eye(3), marks=pytest.mark.acceptance),
        ("-Y", HALF_TURN),
        pytest.param("Z", STOOD, marks=pytest.mark.acceptance),
        ("-Z", STOOD @ HALF_TURN),
    ],
)
def test_a_capture_stands_in_spz_as_it_does_in_the_bake(gf_usd, here, tmp_path, axis, turn):
    path = write_ply(tmp_path / "ball.ply", ball(300, degree=3))
    arguments = ("bake", path, "--material", "jelly", "--up-axis", axis, *SMALL)
    done = gf_usd(*arguments, "--export-ply", "frames", "--export-spz", "frames")
    assert done.status == 0, done.err
    ply, spz = frames(here / "frames", "ball.jelly")
    same(ply, spz, turn)
    stage = Usd.Stage.Open("ball.jelly.usda")
    prim = stage.GetPrimAtPath("/ball/Splats")
    there = prim.GetAttribute("positions").Get(3.0)
    np.testing.assert_allclose(ply.positions, there, atol=STEP)  # the file's own space
    # above the floor, and lower than where it was released
    assert 0.0 < spz.positions[:, 1].min() < 0.09


@pytest.mark.slow
def test_several_captures_and_particles_stand_too(gf_usd, here, tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "two.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 0.1)
    UsdGeom.SetStageUpAxis(stage, "Z")
    for name, place in (("a", (0.0, 0.0, 0.0)), ("b", (2.0, 0.0, 0.0))):
        prim = define(stage, f"/{name}", ball(300, degree=1))
        UsdGeom.Xformable(prim).AddTranslateOp().Set(place)
    stage.Save()
    block = tmp_path / "block.usda"
    block.write_text(BLOCK, encoding="utf-8")
    for path in (tmp_path / "two.usda", block):
        arguments = ("bake", path, "--material", "jelly", *SMALL)
        done = gf_usd(*arguments, "--export-ply", "frames", "--export-spz", "frames")
        assert done.status == 0, done.err
    same(*frames(here / "frames", "two.jelly"), STOOD)
    ply, spz = frames(here / "frames", "block.jelly")
    size = float(np.abs(ply.positions).max())
    np.testing.assert_allclose(spz.positions, ply.positions @ STOOD.T, atol=STEP * size)

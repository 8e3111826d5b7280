"""Bakes of solid and flowing bodies, in slices and again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from captures import ball, define
from mixed_stages import body, castle_of, scene
from pxr import Usd
from resumed import require_same


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_mixed_bake_is_whole_and_comes_to_the_same_bits(
    gf_usd, here: Path, tmp_path: Path
) -> None:
    """In one go and in slices, with any number of threads, and again."""
    arguments = (
        "bake", castle_of(tmp_path), "--particles", "300", "--frames", "7", "--drop", "0",
        "-q", "--clip-frames", "2", "--internal", "--stress", "--threads", "1",
    )  # fmt: skip
    assert gf_usd(*arguments, "-o", "one/").status == 0
    assert gf_usd(*arguments, "-o", "two/", "--slice", "1").status == 5
    assert gf_usd(*arguments, "-o", "two/", "--slice", "1", "--resume").status == 5
    assert gf_usd(*arguments, "-o", "two/", "--resume").status == 0
    require_same(here / "one", here / "two")
    assert gf_usd(*arguments, "-o", "again/", "--threads", "2").status == 0
    clips = sorted((here / "one").glob("*.clips/*.usdc"))
    assert len(clips) == 3
    for clip in clips:
        again = here / "again" / clip.relative_to(here / "one")
        assert again.read_bytes() == clip.read_bytes()


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_mixed_job_of_a_batch_is_the_bake_alone(gf_usd, here: Path, tmp_path: Path) -> None:
    castle_of(tmp_path)
    manifest = tmp_path / "night.toml"
    manifest.write_text(
        f'out = "{here / "night"}"\n'
        "[settings]\nparticles = 300\nframes = 4\ndrop = 0\n"
        '[[assets]]\nfiles = ["scene.usda"]\n',
        encoding="utf-8",
    )
    done = gf_usd("batch", manifest, "-j", "1", "--no-report", "-q")
    assert done.status == 0, done.err
    arguments = (
        "bake",
        tmp_path / "scene.usda",
        "--particles",
        "300",
        "--frames",
        "4",
        "--drop",
        "0",
    )
    assert gf_usd(*arguments, "-q", "-o", "alone/").status == 0
    (cache,) = (here / "night").rglob("*.cache.usdc")
    (alone,) = (here / "alone").rglob("*.cache.usdc")
    assert cache.read_bytes() == alone.read_bytes()


@pytest.mark.slow
@pytest.mark.acceptance
def test_captured_gaussians_fall_on_sand(gf_usd, here: Path, tmp_path: Path) -> None:
    """A capture is the solid body of a mixed scene: its Gaussians move, the sand yields."""
    path = scene(tmp_path, body("Sand", "dry-sand", "0, 0.1, 0"))
    stage = Usd.Stage.Open(str(path))
    capture = replace(ball(400, radius=0.1), path="/World/Ball")
    capture = replace(capture, positions=capture.positions + np.float32([0.0, 0.31, 0.0]))
    define(stage, "/World/Ball", capture)
    stage.GetRootLayer().Save()
    arguments = ("bake", path, "--particles", "400", "--frames", "6", "--drop", "0", "-q")
    done = gf_usd(*arguments, "-m", "rubber", "-o", "out/")
    assert done.status == 0, done.err
    (root,) = (here / "out").glob("*.usda")
    baked = Usd.Stage.Open(str(root))
    moved = [
        np.asarray(baked.GetPrimAtPath("/World/Ball").GetAttribute("positions").Get(code))
        for code in (1.0, 6.0)
    ]
    fallen = float((moved[0] - moved[1])[:, 1].mean())
    # free fall of 0.01 m takes 0.045 s, and the sand bears it after a few frames of 1/24 s
    assert 0.005 < fallen < 0.1
    assert gf_usd("check", root).status == 0

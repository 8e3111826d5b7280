"""Value clips from the command line: what is written, replaced, left and reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from small_bakes import SMALL, names, strict

from gf_usd.core.errors import SolverError
from gf_usd.core.frames import choices
from gf_usd.layers.check.run import check_file

STEM = "block.rubber"
WHOLE = [f"{STEM}.cache.usdc", f"{STEM}.clips", f"{STEM}.report.json", f"{STEM}.usda"]
CLIPS = ["0001.usdc", "0002.usdc", "0003.usdc", "manifest.usda"]


@pytest.mark.slow
def test_a_bake_in_clips(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--clip-frames", "2")
    assert done.status == 0
    assert f"{STEM}.clips/  4 files, " in done.out
    assert names(here) == WHOLE
    assert names(here / f"{STEM}.clips") == CLIPS
    report = strict((here / f"{STEM}.report.json").read_text())
    assert report["check"] == []
    assert sorted(Path(p).name for p in report["outputs"]) == sorted(
        [*(name for name in WHOLE if "clips" not in name), *CLIPS]
    )
    assert not any("clips" in note for note in report["notes"])
    assert gf_usd("bake", block, *SMALL, "-o", "one.usda", "-q").status == 0
    found = [Usd.Stage.Open(str(here / name)) for name in (f"{STEM}.usda", "one.usda")]
    for name in ("Block.points", "GaussianFlesh/Gaussians.orientations"):
        a, b = (stage.GetAttributeAtPath(f"/World/{name}") for stage in found)
        assert a.GetTimeSamples() == b.GetTimeSamples() == [101.0 + k for k in range(6)]
        for code in np.linspace(100.0, 107.0, 29):
            np.testing.assert_array_equal(np.array(a.Get(code)), np.array(b.Get(code)))
    assert check_file(here / f"{STEM}.usda").ok


@pytest.mark.slow
def test_a_new_bake_leaves_no_clips_of_the_old_one(gf_usd, here: Path, block: Path) -> None:
    assert gf_usd("bake", block, *SMALL, "--clip-frames", "2", "-q").status == 0
    again = ("bake", block, *SMALL, "--overwrite", "-q")
    assert gf_usd(*again, "--clip-frames", "1").status == 0
    assert [name for name in names(here) if "clips" in name] == [f"{STEM}.clips-2"]
    assert len(names(here / f"{STEM}.clips-2")) == 6
    assert check_file(here / f"{STEM}.usda").ok
    assert gf_usd(*again).status == 0
    assert names(here) == [name for name in WHOLE if "clips" not in name]


@pytest.mark.slow
def test_a_failure_keeps_the_old_bake_and_shows_its_own(
    gf_usd, here: Path, block: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gf_usd.physics.frame_loop import Solver

    options = ("bake", block, *SMALL, "--clip-frames", "1", "-q")
    assert gf_usd(*options).status == 0
    old = {p: p.read_bytes() for p in here.rglob("*") if p.is_file()}
    sound = Solver.next

    def fails(self, index, last):
        if index == 4:
            raise SolverError("frame 4: broken", "mend it", frame=4, particle=0)
        return sound(self, index, last)

    monkeypatch.setattr(Solver, "next", fails)
    assert gf_usd(*options, "--overwrite").status == 1
    assert {path: path.read_bytes() for path in old} == old
    stage = Usd.Stage.Open(str(here / f"{STEM}.partial.usda"))
    points = stage.GetAttributeAtPath("/World/Block.points")
    assert points.GetTimeSamples() == [101.0, 102.0, 103.0, 104.0]
    assert len(points.Get(104.0)) == 8
    del points, stage
    assert names(here / f"{STEM}.clips-2") == [*CLIPS]
    monkeypatch.setattr(Solver, "next", sound)
    assert gf_usd(*options, "--overwrite").status == 0
    # the failed bake's folder was swept, so that its name was free again
    assert [name for name in names(here) if "clips" in name] == [f"{STEM}.clips-2"]
    assert not any("partial" in name for name in names(here))


@pytest.mark.slow
def test_a_large_cache_is_split_unasked(
    gf_usd, here: Path, block: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(choices, "LARGE", 50_000)
    monkeypatch.setattr(choices, "CLIP", 60_000)
    done = gf_usd("bake", block, *SMALL)
    assert done.status == 0
    assert "kB, is split into value clips of 2 frames: --clip-frames 0 keeps" in done.err
    assert names(here) == WHOLE
    assert gf_usd("bake", block, *SMALL, "--clip-frames", "0", "--overwrite", "-q").status == 0
    assert names(here) == [name for name in WHOLE if "clips" not in name]


@pytest.mark.slow
def test_samples_and_materials_in_clips(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd(
        "bake", block, *SMALL, "-m", "rubber,jelly", "--clip-frames", "2",
        "--samples-per-frame", "2", "-q", "-o", "two.usda",
    )  # fmt: skip
    assert done.status == 0
    for look in ("rubber", "jelly"):
        clip = Usd.Stage.Open(str(here / f"two.{look}.clips" / "0001.usdc"))
        points = clip.GetAttributeAtPath("/World/Block.points")
        assert points.GetTimeSamples() == [101.0, 101.5, 102.0, 102.5, 103.0]
    stage = Usd.Stage.Open(str(here / "two.usda"))
    points = stage.GetAttributeAtPath("/World/Block.points")
    for look in ("rubber", "jelly"):
        stage.GetDefaultPrim().GetVariantSet("gaussianFlesh").SetVariantSelection(look)
        assert len(points.GetTimeSamples()) == 11

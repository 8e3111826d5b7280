"""A bake within a stated error, against the same bake with everything in it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from small_bakes import BLOCK

import gf_usd
from gf_usd.core.errors import UsageError
from gf_usd.core.units import length_text

SHARE = 0.01
OPTIONS = {"precision": "1%", "adaptive_samples": True, "no_velocities": True}
# so slow that most of the fall is straight within the error
SLOW = {"particles": 200, "frames": 30, "drop": "0.2r", "time_scale": 0.1, "threads": 1}
MESH, SPLATS = "/World/Block", "/World/GaussianFlesh/Gaussians"


@pytest.fixture(scope="module")
def bakes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, gf_usd.BakeResult]:
    folder = tmp_path_factory.mktemp("bakes")
    block = folder / "block.usda"
    block.write_text(BLOCK, encoding="utf-8")
    return {
        name: gf_usd.bake(block, output=folder / name / "block.usda", **SLOW, **options)
        for name, options in {"all": {}, "few": OPTIONS}.items()
        if (folder / name).mkdir() is None
    }


def in_meters(stage: Usd.Stage, path: str, name: str, code: float) -> np.ndarray:
    """Points in the world, read by USD alone."""
    prim = stage.GetPrimAtPath(path)
    matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(prim))
    x = np.array(prim.GetAttribute(name).Get(code), np.float64)
    return 0.01 * (x @ matrix[:3, :3] + matrix[3, :3])


@pytest.mark.slow
def test_an_independent_reader_finds_the_printed_error(bakes) -> None:
    true, mine = (Usd.Stage.Open(str(bakes[name].root)) for name in ("all", "few"))
    storage = json.loads(bakes["few"].report.read_text())["bakes"][0]["storage"]
    radius = json.loads(bakes["few"].report.read_text())["radius_m"]
    worst = 0.0
    for path, name in ((MESH, "points"), (SPLATS, "positions")):
        codes = true.GetPrimAtPath(path).GetAttribute(name).GetTimeSamples()
        kept = mine.GetPrimAtPath(path).GetAttribute(name).GetTimeSamples()
        assert set(kept) < set(codes)
        if path == MESH:
            assert storage["samples"][path] == {"kept": len(kept), "of": len(codes)}
        for code in codes:
            apart = in_meters(true, path, name, code) - in_meters(mine, path, name, code)
            worst = max(worst, float(np.linalg.norm(apart, axis=1).max()))
    error = storage["errors"]["positions_m"]
    assert worst <= error <= SHARE * radius
    assert error == pytest.approx(worst, rel=0.01)
    about = mine.GetRootLayer().customLayerData["gaussianFlesh"]["looks"]["rubber"]["storage"]
    assert about["errors"]["positions_m"] == error
    assert any(length_text(error) in note for note in bakes["few"].notes)


def test_the_sizes_are_those_of_the_files(bakes) -> None:
    storage = bakes["few"].bakes[0].storage
    assert storage["bytes"] == bakes["few"].cache.stat().st_size
    assert storage["bytes_without"] == pytest.approx(bakes["all"].cache.stat().st_size, rel=0.05)
    assert storage["bytes"] < 0.6 * storage["bytes_without"]
    assert all(size > 0 for size in storage["saved"].values())
    assert bakes["all"].bakes[0].storage is None


def test_everything_that_reads_a_bake_sees_all_frames(bakes, tmp_path: Path) -> None:
    for name in ("all", "few"):
        with_all = gf_usd.read(bakes[name].root)
        assert len(with_all.time_codes) == SLOW["frames"]
        assert len(with_all.health["kinetic"]) == SLOW["frames"]
    found = gf_usd.compare(bakes["all"].root, bakes["few"].root)
    assert len(found.time_codes) == SLOW["frames"]
    limit = bakes["few"].bakes[0].storage["errors"]["positions_m"]
    assert 0.0 < found.error <= limit
    assert found.notes == ()
    assert not gf_usd.check(bakes["few"].root).findings


def test_a_retimed_bake_is_still_within_the_error(bakes, tmp_path: Path) -> None:
    slow = [
        gf_usd.retime(bakes[name].root, tmp_path / f"{name}.usda", speed=0.5)
        for name in ("all", "few")
    ]
    assert slow[0].frames == slow[1].frames
    found = gf_usd.compare(slow[0].path, slow[1].path)
    assert found.error <= bakes["few"].bakes[0].storage["errors"]["positions_m"] * 1.02


@pytest.mark.slow
def test_a_mesh_that_never_moves_is_not_written(tmp_path: Path) -> None:
    """The other one falls; readers of the bake get the points of the asset."""
    block = BLOCK.rindex("    def Mesh")
    wall = BLOCK[block:].rpartition("}")[0].replace("Block", "Wall")
    wall = wall.replace("(-10,", "(90,").replace("(10,", "(110,")
    asset = tmp_path / "two.usda"
    asset.write_text(BLOCK.rpartition("}")[0] + wall + "}\n", encoding="utf-8")
    done = gf_usd.bake(
        asset, output=tmp_path / "b.usda", precision="1%", adaptive_samples=True, particles=400,
        frames=4, pins="/World/Wall", floor=False, self_contact=False, threads=1,
    )  # fmt: skip
    assert not [fault for fault in done.findings if fault["level"] == "error"]
    stage, source = Usd.Stage.Open(str(done.root)), Usd.Stage.Open(str(asset))
    still, moving = (stage.GetPrimAtPath(f"/World/{name}") for name in ("Wall", "Block"))
    assert not any(attribute.GetNumTimeSamples() for attribute in still.GetAttributes())
    assert moving.GetAttribute("points").GetNumTimeSamples() > 1
    for name in ("points", "extent"):
        at_end = still.GetAttribute(name).Get(stage.GetEndTimeCode())
        assert at_end == source.GetPrimAtPath("/World/Wall").GetAttribute(name).Get()
    storage = done.bakes[0].storage
    assert storage["samples"]["/World/Wall"] == {"kept": 0, "of": 4}
    assert storage["saved"]["samples_left_out"] > 0
    slow = gf_usd.retime(done.root, tmp_path / "slow.usda", speed=0.5)
    assert not gf_usd.check(slow.path).findings
    assert gf_usd.deliver(done.root, tmp_path / "b.glb").error <= 0.005


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"precision": "0.5"}, "has no unit"),
        ({"precision": "x%"}, "is not a length"),
        ({"precision": "0%"}, "is not a length above 0"),
        ({"precision": "-2mm"}, "is not a length above 0"),
        ({"precision": "nanmm"}, "is not a length above 0"),
        ({"precision": "50%"}, "more than 10 % of the radius"),
        ({"precision": 1e-12}, "points have single precision"),
        ({"adaptive_samples": True}, "which is not given"),
        ({"precision": "1%", "half": True}, "were both given"),
        ({"precision": "1%", "adaptive_samples": True, "settle_only": True}, "--settle-only"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, options, message: str) -> None:
    block = tmp_path / "block.usda"
    block.write_text(BLOCK, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        gf_usd.bake(block, particles=100, frames=2, output=tmp_path / "o.usda", **options)
    flat = caught.value.message.replace("_", "-").replace("settle-only", "--settle-only")
    assert message in caught.value.message or message in flat
    assert caught.value.hint

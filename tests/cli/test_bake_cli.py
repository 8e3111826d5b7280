"""gf-usd bake, end to end: the files and what they hold."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from small_bakes import BAKE, FRAME, HEALTH, REPORT, SAMPLES, SMALL, names, strict


def heights(path: Path, prim: str, axis: int) -> dict[float, float]:
    """Mean height of a mesh's points at each time sample, stage units."""
    stage = Usd.Stage.Open(str(path))
    points = stage.GetAttributeAtPath(f"{prim}.points")
    return {t: float(np.mean(np.array(points.Get(t))[:, axis])) for t in points.GetTimeSamples()}


def test_the_sphere_of_the_samples(gf_usd, here: Path) -> None:
    source = SAMPLES / "sphere.usda"
    before = source.read_bytes(), source.stat().st_mtime_ns, names(SAMPLES)
    done = gf_usd("bake", source, *SMALL)
    assert done.status == 0
    assert (source.read_bytes(), source.stat().st_mtime_ns, names(SAMPLES)) == before
    assert names(here) == [
        "sphere.rubber.cache.usdc",
        "sphere.rubber.report.json",
        "sphere.rubber.usda",
    ]
    for name in names(here):
        assert f"{name}  " in done.out
    assert "rubber: 6 frames, " in done.out
    assert ": frame 6/6, about " in done.err
    assert done.err.splitlines()[-1] == "checking"
    report = strict((here / "sphere.rubber.report.json").read_text())
    assert set(report) == REPORT
    assert set(report["bakes"][0]) == {*BAKE, "per_frame"}
    assert set(report["bakes"][0]["health"]) == HEALTH
    assert set(report["bakes"][0]["per_frame"][0]) == FRAME
    assert report["check"] == []
    assert report["outputs"] == [
        "sphere.rubber.usda",
        "sphere.rubber.cache.usdc",
        "sphere.rubber.report.json",
    ]
    assert all((here / name).exists() for name in report["outputs"])


def test_the_motion_is_a_fall_in_the_stage_s_own_units(gf_usd, here: Path, block: Path) -> None:
    assert gf_usd("bake", block, *SMALL, "--drop", "150", "-q").status == 0
    seen = heights(here / "block.rubber.usda", "/World/Block", 2)
    assert list(seen) == [101.0, 102.0, 103.0, 104.0, 105.0, 106.0]
    for code, height in seen.items():
        # 1.5 m under the lowest point and 15 cm of block above it; g = 981 cm/s^2.  Single
        # precision of numbers about 200 is 1e-5.
        t = (code - 101.0) / 48.0
        assert height == pytest.approx(165.0 - 0.5 * 981.0 * t * t, abs=1e-3)
    stage = Usd.Stage.Open(str(here / "block.rubber.usda"))
    assert stage.GetTimeCodesPerSecond() == 48.0
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetDefaultPrim().GetPath() == "/World"
    velocities = np.array(stage.GetAttributeAtPath("/World/Block.velocities").Get(106.0))
    np.testing.assert_allclose(velocities[:, 2], -981.0 * 5.0 / 48.0, rtol=1e-4)
    stage.GetDefaultPrim().GetVariantSet("gaussianFlesh").SetVariantSelection("none")
    assert stage.GetAttributeAtPath("/World/Block.points").GetTimeSamples() == []


def test_several_materials_are_variants_of_one_layer(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "-m", "rubber,jelly", "--drop", "1", "--json")
    assert done.status == 0
    assert names(here) == [
        "block.rubber-jelly.jelly.cache.usdc",
        "block.rubber-jelly.report.json",
        "block.rubber-jelly.rubber.cache.usdc",
        "block.rubber-jelly.usda",
    ]
    assert ": frame 12/12, about " in done.err
    assert done.err.splitlines()[-1] == "checking"
    assert [bake["look"] for bake in strict(done.out)["bakes"]] == ["rubber", "jelly"]
    stage = Usd.Stage.Open(str(here / "block.rubber-jelly.usda"))
    switch = stage.GetDefaultPrim().GetVariantSet("gaussianFlesh")
    assert sorted(switch.GetVariantNames()) == ["jelly", "none", "rubber"]
    last = {}
    for name in ("rubber", "jelly"):
        switch.SetVariantSelection(name)
        last[name] = np.array(stage.GetAttributeAtPath("/World/Block.points").Get(106.0))
    # jelly is forty times softer: it has landed and sags by more than rounding
    assert np.abs(last["rubber"] - last["jelly"]).max() > 0.1


@pytest.mark.slow
def test_gradients_and_stress_are_written_for_every_particle(
    gf_usd, here: Path, block: Path
) -> None:
    done = gf_usd(
        "bake", block, *SMALL, "--stress", "--deformation-gradients", "--drop", "1", "--json"
    )
    count = strict(done.out)["particles"]
    stage = Usd.Stage.Open(str(here / "block.rubber.usda"))
    splats = stage.GetPrimAtPath("/World/GaussianFlesh/Gaussians")
    gradients = splats.GetAttribute("gaussianFlesh:deformationGradients")
    stress = splats.GetAttribute("gaussianFlesh:vonMisesStress")
    for attribute in (gradients, stress):
        assert attribute.GetTimeSamples() == [101.0, 102.0, 103.0, 104.0, 105.0, 106.0]
        assert {len(attribute.Get(t)) for t in attribute.GetTimeSamples()} == {count}
    at_rest = np.array(gradients.Get(101.0))
    np.testing.assert_array_equal(at_rest, np.broadcast_to(np.eye(3), at_rest.shape))
    assert max(stress.Get(101.0)) == 0.0
    # on the floor it is squeezed
    assert np.abs(np.array(gradients.Get(106.0)) - np.eye(3)).max() > 1e-4
    assert max(stress.Get(106.0)) > 0.0
    assert gf_usd("bake", block, *SMALL, "-q", "-o", "plain.usda").status == 0
    plain = Usd.Stage.Open(str(here / "plain.usda"))
    for name in ("deformationGradients", "vonMisesStress"):
        attribute = plain.GetAttributeAtPath(f"/World/GaussianFlesh/Gaussians.gaussianFlesh:{name}")
        assert not attribute.HasAuthoredValue()


def test_auto_slows_a_small_body_down(gf_usd, here: Path, block: Path) -> None:
    drop = ("--drop", "150", "-q", "--json")
    done = gf_usd("bake", block, *SMALL, "--time-scale", "auto", *drop)
    settings = strict(done.out)["settings"]
    # r = (3 V / 4 pi)^(1/3) of 0.012 m^3; T is sqrt(r) of that of a meter.
    radius = (3.0 * 0.012 / (4.0 * math.pi)) ** (1.0 / 3.0)
    assert settings["time_scale"] == pytest.approx(math.sqrt(radius), rel=1e-3)
    t = 5.0 / 48.0 * settings["time_scale"]
    last = heights(here / "block.rubber.usda", "/World/Block", 2)[106.0]
    assert last == pytest.approx(165.0 - 0.5 * 981.0 * t * t, abs=1e-3)
    stage = Usd.Stage.Open(str(here / "block.rubber.usda"))
    velocities = np.array(stage.GetAttributeAtPath("/World/Block.velocities").Get(106.0))
    # per second of playback, which motion blur requires
    expected = -981.0 * t * settings["time_scale"]
    np.testing.assert_allclose(velocities[:, 2], expected, rtol=1e-4)


@pytest.mark.slow
def test_the_paper_s_preset_runs(gf_usd, here: Path) -> None:
    done = gf_usd("bake", SAMPLES / "sphere.usda", "--preset", "paper", "--frames", "4", "--json")
    assert done.status == 0
    result = strict(done.out)
    settings = result["settings"]
    assert result["particles"] == 120
    assert result["check"] == []
    assert (settings["substeps"], settings["skin"], settings["followers"]) == (10, "paper", False)
    assert settings["filter_rate"] == "inf"
    assert result["bakes"][0]["material"]["law"] == "corotated"
    assert result["bakes"][0]["health"]["substeps"] == 30
    assert any(note.startswith("skin paper: ") for note in result["notes"])
    assert strict((here / "sphere.rubber.report.json").read_text())["settings"] == settings

"""gf-usd bake, end to end: the files, what they hold, and what is said on the way."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path

import numpy as np
import pytest
from conftest import names
from pxr import Usd, UsdGeom

import gf_usd as package
from gf_usd.model import Health, Settings
from gf_usd.planning import Request

SAMPLES = Path(__file__).parents[2] / "samples"
SMALL = ("--particles", "300", "--frames", "6")
RESULT = ["root", "report", "particles", "frames", "seconds", "settings", "bakes", "notes", "check"]
REPORT = {
    "command", "version", "source", "input_sha256", "bodies", "riders", "particles", "spacing_m",
    "volume_m3", "radius_m", "materials", "frames", "fps", "start", "drop_m", "settings", "outputs",
    "notes", "seconds", "bakes", "check",
}  # fmt: skip
BAKE = ["look", "cache", "material", "frames", "health"]
HEALTH = {
    "frames", "substeps", "restitution", "deepest_penetration_m", "deepest_penetration_spacings",
    "penetration_at_end_spacings", "first_contact_frame", "min_J", "max_J", "min_stretch",
    "max_stretch", "inverted_particle_frames", "rollbacks", "friction_capped", "energy_start_J",
    "energy_end_J", "energy_max_J",
}  # fmt: skip
ESTIMATE = {"substeps_per_frame", "estimated_seconds", "estimated_bytes", "first_contact_frame"}


def strict(text: str) -> dict:
    """JSON as its standard has it: Infinity and NaN are refused."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


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
    assert done.err.splitlines()[-1].startswith("frame 6/6, ")
    report = strict((here / "sphere.rubber.report.json").read_text())
    assert set(report) == REPORT
    assert set(report["bakes"][0]) == {*BAKE, "per_frame"}
    assert set(report["bakes"][0]["health"]) == HEALTH
    assert set(report["bakes"][0]["per_frame"][0]) == set(Health.__dataclass_fields__)
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


def test_json_is_all_there_is_on_stdout(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--json", "-o", "out/")
    assert done.status == 0
    assert "frame 6/6" in done.err
    result = strict(done.out)
    assert list(result) == RESULT
    assert result["root"] == "out/block.rubber.usda"
    assert result["report"] == "out/block.rubber.report.json"
    assert (result["frames"], result["check"]) == (6, [])
    assert 200 < result["particles"] < 400
    assert set(result["settings"]) == set(Settings.__dataclass_fields__)
    (bake,) = result["bakes"]
    assert list(bake) == BAKE
    assert bake["cache"] == "out/block.rubber.cache.usdc"
    assert bake["look"] == bake["material"]["name"] == "rubber"
    assert set(bake["health"]) == HEALTH


def test_a_dry_run_says_and_writes_nothing_else(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, "--particles", "300", "--drop", "10", "--dry-run")
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith(f"{block}: 1 mesh(es), 0.012 m^3, radius 0.142 m\n  /World/Block\n")
    for line in ("particles   ", "frames      ", "substeps    ", "time        about ", "disk  "):
        assert f"\n{line}" in done.out
    # sqrt(2 * 0.1 m / g) = 0.143 s are 6.85 frames of 1/48 s
    assert "\ndrop        0.1 m, first contact at frame 7\n" in done.out
    assert "\nwould write block.rubber.usda\nwould write block.rubber.cache.usdc\n" in done.out
    as_json = gf_usd("bake", block, "--particles", "300", "--drop", "10", "--dry-run", "--json")
    assert (as_json.status, as_json.err) == (0, "")
    plan = strict(as_json.out)
    assert set(plan) >= (REPORT - {"settings", "seconds", "bakes", "check"}) | ESTIMATE
    assert plan["first_contact_frame"] == 7
    # a box of 20 x 20 x 30 cm
    assert plan["volume_m3"] == pytest.approx(0.012, rel=1e-6)
    assert plan["substeps_per_frame"]["rubber"] >= 1
    assert names(here) == []


def test_the_recorded_command_bakes_the_same_again(gf_usd, here: Path, block: Path) -> None:
    first = gf_usd(
        "bake", block, "--spacing", "3.7654321", "--frames", "3", "-m", "jelly", "--seed", "5",
        "--drop", "1r", "--stress", "--friction", "0.30000001", "-o", "first/", "-q",
    )  # fmt: skip
    assert first.status == 0, first.err
    command = strict((here / "first/block.jelly.report.json").read_text())["command"]
    program, *words = shlex.split(command)
    assert program == "gf-usd"
    again = gf_usd(*(str(block) if w == "block.usda" else w for w in words), "-o", "again/", "-q")
    assert again.status == 0, again.err
    caches = [(here / n / "block.jelly.cache.usdc").read_bytes() for n in ("first", "again")]
    assert caches[0] == caches[1]


def test_a_dry_run_says_what_the_bake_then_does(gf_usd, here: Path, block: Path) -> None:
    plan = strict(gf_usd("bake", block, *SMALL, "--dry-run", "--json", "-o", "new/").out)
    assert names(here) == []
    done = strict(gf_usd("bake", block, *SMALL, "--json", "-o", "new/").out)
    assert sorted(plan["outputs"]) == sorted(f"new/{name}" for name in names(here / "new"))
    assert (plan["particles"], plan["frames"]) == (done["particles"], done["frames"])
    assert plan["materials"] == [done["bakes"][0]["material"]]
    # In free flight nothing makes the solver halve its step: five frames of motion.
    assert done["bakes"][0]["health"]["substeps"] == 5 * plan["substeps_per_frame"]["rubber"]


def test_results_are_replaced_only_when_asked(gf_usd, here: Path, block: Path) -> None:
    assert gf_usd("bake", block, *SMALL, "-q").status == 0
    before = {name: (here / name).read_bytes() for name in names(here)}
    again = gf_usd("bake", block, *SMALL, "--seed", "1")
    assert again.status == 2
    assert again.err == (
        "error: block.rubber.usda exists already\n\n"
        "hint: add --overwrite to replace it, or choose another -o\n"
    )
    assert {name: (here / name).read_bytes() for name in names(here)} == before
    assert gf_usd("bake", block, *SMALL, "--seed", "1", "-q", "--overwrite").status == 0
    assert names(here) == list(before)
    assert (here / "block.rubber.cache.usdc").read_bytes() != before["block.rubber.cache.usdc"]


def test_several_materials_are_variants_of_one_layer(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "-m", "rubber,jelly", "--drop", "1", "--json")
    assert done.status == 0
    assert names(here) == [
        "block.rubber-jelly.jelly.cache.usdc",
        "block.rubber-jelly.report.json",
        "block.rubber-jelly.rubber.cache.usdc",
        "block.rubber-jelly.usda",
    ]
    assert done.err.splitlines()[-1].startswith("frame 12/12, ")
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


def test_quiet_and_verbose(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "-q")
    assert (done.status, done.out, done.err) == (0, "", "")
    loud = gf_usd("bake", block, *SMALL, "-v", "--overwrite")
    assert loud.status == 0
    assert loud.err.startswith(f"{block}: 1 mesh(es)")
    assert "would write block.rubber.usda" in loud.err
    assert "would write" not in loud.out


def test_auto_slows_a_small_body_down(gf_usd, here: Path, block: Path) -> None:
    drop = ("--drop", "150", "-q", "--json")
    done = gf_usd("bake", block, *SMALL, "--time-scale", "auto", *drop)
    settings = strict(done.out)["settings"]
    # r = (3 V / 4 pi)^(1/3) of 0.012 m^3; T is sqrt(r) of that of a metre.
    radius = (3.0 * 0.012 / (4.0 * math.pi)) ** (1.0 / 3.0)
    assert settings["time_scale"] == pytest.approx(math.sqrt(radius), rel=1e-3)
    t = 5.0 / 48.0 * settings["time_scale"]
    last = heights(here / "block.rubber.usda", "/World/Block", 2)[106.0]
    assert last == pytest.approx(165.0 - 0.5 * 981.0 * t * t, abs=1e-3)
    stage = Usd.Stage.Open(str(here / "block.rubber.usda"))
    velocities = np.array(stage.GetAttributeAtPath("/World/Block.velocities").Get(106.0))
    # per second of playback, which is what motion blur wants
    expected = -981.0 * t * settings["time_scale"]
    np.testing.assert_allclose(velocities[:, 2], expected, rtol=1e-4)


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


def test_from_python(here: Path, block: Path) -> None:
    seen = []
    result = package.bake(
        block,
        material="metal",
        output="out/",
        particles=300,
        frames=3,
        law="neoHookean",
        friction=0.1,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert result.root == Path("out/block.metal.usda")
    assert (result.cache, result.frames) == (Path("out/block.metal.cache.usdc"), 3)
    assert set(result.health) == HEALTH
    material = result.bakes[0].material
    assert (material.name, material.law, material.friction) == ("metal", "neoHookean", 0.1)
    assert len(result.bakes[0].per_frame) == 3
    assert names(here / "out") == [
        "block.metal.cache.usdc",
        "block.metal.report.json",
        "block.metal.usda",
    ]


def test_options_that_python_misspells(here: Path, block: Path) -> None:
    with pytest.raises(package.UsageError) as caught:
        package.bake(block, particle=300)
    assert caught.value.message == "bake() has no option 'particle'"
    known = ", ".join(sorted(Request.__dataclass_fields__))
    assert caught.value.hint == f"its options are {known}"
    assert names(here) == []

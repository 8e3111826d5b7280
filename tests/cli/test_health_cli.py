"""gf-usd bake, what it says of a result's health, and what a bake will cost."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pxr import Usd
from small_bakes import HEALTH, SMALL, names, strict

import gf_usd as package
from gf_usd.prepare.options.table import MAX_HOURS

# What a meter of fall does to jelly under the corotated law, which does not resist collapse
# (materials.py): particles turn inside out in the first frame on the floor.
CRUSH = ("-m", "jelly", "--law", "corotated", "--particles", "300", "--frames", "12")
HIGH = ("--drop", "60", "--fps", "24")
HARD = """#usda 1.0
( metersPerUnit = 1 )
def Material "Hard" ( prepend apiSchemas = ["PhysicsMaterialAPI"] )
{
    float physics:youngsModulus = 1e13
    float physics:poissonsRatio = 0.3
    float physics:density = 1000
}
"""


def cube(edge: float) -> str:
    """An OBJ file."""
    corners = [(x, y, z) for x in (0.0, edge) for y in (0.0, edge) for z in (0.0, edge)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = ["v {} {} {}".format(*p) for p in corners]
    lines += ["f {} {} {} {}".format(*f) for f in faces]
    return "\n".join(lines) + "\n"


def test_an_unhealthy_bake_says_so_and_is_written(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *CRUSH, *HIGH)
    assert done.status == 0, done.err
    report = strict((here / "block.jelly.report.json").read_text())
    health = report["bakes"][0]["health"]
    assert health["inverted_particle_frames"] > 0
    warned = [w for w in report["warnings"] if w["about"] == "inside-out"]
    assert [set(w) for w in warned] == [{"variant", "look", "about", "message", "hint", "level"}]
    assert f"up to {health['inverted_max']} at once" in warned[0]["message"]
    written = f"warning: jelly: {warned[0]['message']} [inside-out]\n  hint: {warned[0]['hint']}"
    assert written in done.out
    stage = Usd.Stage.Open(str(here / "block.jelly.usda"))
    written = stage.GetDefaultPrim().GetAttribute("gaussianFlesh:health:warnings").Get()
    assert list(written) == [w["message"] for w in report["warnings"]]


def test_strict_ends_with_status_4_and_keeps_the_files(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *CRUSH, *HIGH, "--strict", "--json")
    assert done.status == 4
    result = strict(done.out)
    assert names(here) == [
        "block.jelly.cache.usdc",
        "block.jelly.report.json",
        "block.jelly.usda",
    ]
    error = done.err[done.err.index("error: ") :]
    assert error.startswith(
        "error: block.jelly.usda: the bake is complete and its files are written, but it has "
    )
    assert result["warnings"] != []
    for warning in result["warnings"]:
        assert f"\n  jelly: {warning['message']} [{warning['about']}]\n" in error
    assert error.rstrip().endswith("without --strict this is not an error")


def test_strict_passes_a_sound_bake(gf_usd, here: Path, block: Path) -> None:
    long = ["--drop", "150", "--floor", "none"]  # nothing is to be reached
    done = gf_usd("bake", block, *SMALL, *long, "--strict", "--json", "-q")
    assert (done.status, done.err) == (0, "")
    result = strict(done.out)
    assert result["warnings"] == []
    health = result["bakes"][0]["health"]
    assert set(health) == HEALTH
    # Five frames of free fall: what single precision makes of it.
    assert health["free_flight_frames"] == 5
    assert health["momentum_drift"] < 1e-5
    assert health["angular_momentum_drift"] < 1e-5
    assert health["energy_gain_max_share"] < 1e-5


def test_strict_from_python(here: Path, block: Path) -> None:
    options = {"material": "jelly", "law": "corotated", "particles": 300, "frames": 12}
    with pytest.raises(package.UnhealthyError) as caught:
        package.bake(block, drop="60", fps=24, strict=True, **options)
    error = caught.value
    assert error.exit_status == 4
    assert error.result.root.exists()
    assert "inside-out" in [warning.about for warning in error.warnings]


@pytest.mark.slow
def test_the_report_and_the_stage_agree_frame_by_frame(gf_usd, here: Path, block: Path) -> None:
    assert gf_usd("bake", block, *SMALL, "--drop", "1", "-q").status == 0
    (bake,) = strict((here / "block.rubber.report.json").read_text())["bakes"]
    stage = Usd.Stage.Open(str(here / "block.rubber.usda"))
    prim = stage.GetDefaultPrim()
    for name, field, size in (
        ("elasticEnergy", "elastic", 0.01**2),
        ("penetration", "penetration", 0.01),
        ("minVolumeRatio", "min_J", 1.0),
        ("substeps", "substeps", 1),
    ):
        attribute = prim.GetAttribute(f"gaussianFlesh:health:{name}")
        assert attribute.GetTimeSamples() == [row["time_code"] for row in bake["per_frame"]]
        for row in bake["per_frame"]:
            value = attribute.Get(row["time_code"]) * size
            assert value == pytest.approx(row[field], rel=1e-6), name  # floats in the cache
    assert bake["per_frame"][-1]["elastic"] > 0.0, "it has landed"


def test_the_cost_is_reported_before_it_is_spent(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "-m", "rubber,metal")
    first = next(line for line in done.err.splitlines() if not line.startswith("note: "))
    assert re.fullmatch(
        r"\d+ particles, 6 frames, \d+ \(rubber\), \d+ \(metal\) substeps per frame:"
        r" about \d+ s, about [\d.]+ kB",
        first,
    ), first


@pytest.mark.slow
def test_what_would_take_hours_is_refused_in_seconds(gf_usd, here: Path, block: Path) -> None:
    (here / "hard.usda").write_text(HARD)
    options = ("-m", "hard.usda", "--particles", "8000", "--threads", "2", "--frames", "800")
    done = gf_usd("bake", block, *options)
    assert (done.status, done.out) == (3, "")
    found = re.search(
        r"error: .+: the bake would take about (\S+) (minutes|hours|days): \d+ particles of Hard"
        r" \(Young's modulus 1e\+13 Pa, damping time 0 s\), dropped \S+ \S+, need (\d+) substeps of"
        r" \S+ s in each of (\d+) frames\n\nhint: .+ --max-hours (\d+) allows it",
        done.err,
    )
    assert found is not None, done.err
    hours = float(found[1]) * {"minutes": 1.0 / 60.0, "hours": 1.0, "days": 24.0}[found[2]]
    assert hours > MAX_HOURS
    assert int(found[5]) >= hours
    assert names(here) == ["hard.usda"]
    shown = gf_usd("bake", block, *options, "--dry-run")
    assert shown.status == 0
    assert f"{found[2]}: refused because it is more than --max-hours {MAX_HOURS:g}\n" in shown.out
    assert "refused" not in gf_usd("bake", block, *options, "--dry-run", "--max-hours", "1e6").out


def test_the_limit_can_be_lowered(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--max-hours", "0")
    assert done.status == 3
    assert names(here) == []


def test_nothing_falls_without_gravity(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--gravity", "0", "-q", "--json")
    assert done.status == 0, done.err
    assert [w["about"] for w in strict(done.out)["warnings"]] == ["still"]
    health = strict(done.out)["bakes"][0]["health"]
    assert (health["restitution"], health["first_contact_frame"]) == (None, None)
    assert health["energy_end_J"] == health["energy_start_J"] == 0.0


def test_an_odd_size_is_reported(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--meters-per-unit", "1", "--dry-run")
    assert "warning: the asset is 30 m wide" not in done.out, "30 m is the limit"
    done = gf_usd("bake", block, *SMALL, "--meters-per-unit", "2", "--dry-run")
    assert "warning: the asset is 60 m wide: 30 units of 2 m" in done.out
    (here / "tiny.obj").write_text(cube(0.01))
    done = gf_usd("bake", "tiny.obj", *SMALL)
    assert "warning: the asset is 0.01 m wide" in done.err
    assert "the asset is 0.01 m wide" not in done.out, "again, after the bake"
    done = gf_usd("inspect", block, "--meters-per-unit", "40")
    assert "; 800 x 800 x 1200 m" in done.out
    assert "warning: the asset is 1200 m wide: 30 units of 40 m" in done.out


def test_the_layer_of_a_mesh_file_is_listed(gf_usd, here: Path) -> None:
    (here / "box.obj").write_text(cube(1.0))
    done = gf_usd("bake", "box.obj", *SMALL)
    assert done.status == 0, done.err
    listed = [line.split("  ")[0] for line in done.out.splitlines() if line.startswith("box.")]
    assert listed == [
        "box.rubber.usda", "box.rubber.cache.usdc", "box.rubber.report.json", "box.source.usdc",
    ]  # fmt: skip

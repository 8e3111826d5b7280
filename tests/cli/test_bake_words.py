"""gf-usd bake, what it says: the plan, the result, and both from Python."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from small_bakes import BAKE, ESTIMATE, HEALTH, REPORT, RESULT, SMALL, names, strict

import gf_usd as package
from gf_usd.core.frames.settings import Settings
from gf_usd.prepare.options.table import OPTIONS


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
    assert done.out.startswith(f"{block}: 1 mesh, 0.012 m³, radius 14.2 cm\n  /World/Block\n")
    for line in ("particles   ", "frames      ", "substeps    ", "time        about ", "disk  "):
        assert f"\n{line}" in done.out
    # sqrt(2 * 0.1 m / g) = 0.143 s are 6.85 frames of 1/48 s
    assert "\ndrop        10 cm, first contact at frame 7\n" in done.out
    assert "\nwould write block.rubber.usda\nwould write block.rubber.cache.usdc\n" in done.out
    as_json = gf_usd("bake", block, "--particles", "300", "--drop", "10", "--dry-run", "--json")
    assert (as_json.status, as_json.err) == (0, "")
    plan = strict(as_json.out)
    assert set(plan) >= (REPORT - {"settings", "seconds", "bakes", "check", "warnings"}) | ESTIMATE
    assert plan["first_contact_frame"] == 7
    # a box of 20 x 20 x 30 cm
    assert plan["volume_m3"] == pytest.approx(0.012, rel=1e-6)
    assert plan["substeps_per_frame"]["rubber"] >= 1
    assert names(here) == []


TABLE = """
    def Cube "Table" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
        double size = 100
    }
}
"""


@pytest.mark.slow
def test_a_fall_on_an_obstacle_is_not_called_no_contact(gf_usd, here: Path, block: Path) -> None:
    text = block.read_text(encoding="utf-8").rstrip()
    block.write_text(text.removesuffix("}") + TABLE, encoding="utf-8")
    for command in (("bake", "--dry-run"), ("inspect",)):
        done = gf_usd(*command, block, "--particles", "300")
        assert "first contact is not estimated with obstacles" in done.out
        assert "no contact" not in done.out
    plan = strict(gf_usd("bake", block, "--particles", "300", "--dry-run", "--json").out)
    assert plan["first_contact_frame"] is None


def test_the_recorded_command_bakes_the_same_again(gf_usd, here: Path, block: Path) -> None:
    first = gf_usd(
        "bake", block, "--spacing", "3.7654321", "--frames", "3", "-m", "jelly", "--seed", "5",
        "--drop", "1r", "--stress", "--friction", "0.30000001", "-o", "first/", "-q",
    )  # fmt: skip
    assert first.status == 0, first.err
    command = strict((here / "first/block.jelly.report.json").read_text())["command"]
    program, *arguments = shlex.split(command)
    assert program == "gf-usd"
    again = gf_usd(
        *(str(block) if w == "block.usda" else w for w in arguments), "-o", "again/", "-q"
    )
    assert again.status == 0, again.err
    caches = [(here / n / "block.jelly.cache.usdc").read_bytes() for n in ("first", "again")]
    assert caches[0] == caches[1]


@pytest.mark.slow
def test_a_dry_run_says_what_the_bake_then_does(gf_usd, here: Path, block: Path) -> None:
    plan = strict(gf_usd("bake", block, *SMALL, "--dry-run", "--json", "-o", "new/").out)
    assert names(here) == []
    done = strict(gf_usd("bake", block, *SMALL, "--json", "-o", "new/").out)
    assert sorted(plan["outputs"]) == sorted(f"new/{name}" for name in names(here / "new"))
    assert (plan["particles"], plan["frames"]) == (done["particles"], done["frames"])
    assert plan["materials"] == [done["bakes"][0]["material"]]
    # In free flight nothing makes the solver halve its step: five frames of motion.
    arguments = (*SMALL, "--no-shortcuts", "--json", "-o", "new/", "--overwrite")
    done = strict(gf_usd("bake", block, *arguments).out)
    assert done["bakes"][0]["health"]["substeps"] == 5 * plan["substeps_per_frame"]["rubber"]


@pytest.mark.slow
def test_results_are_replaced_only_when_asked(gf_usd, here: Path, block: Path) -> None:
    assert gf_usd("bake", block, *SMALL, "-q").status == 0
    before = {name: (here / name).read_bytes() for name in names(here)}
    again = gf_usd("bake", block, *SMALL, "--drop", "0.5r")
    assert again.status == 2
    assert again.err == (
        "error: block.rubber.usda exists already\n\n"
        "hint: add --overwrite to replace it, or choose another -o\n"
    )
    assert {name: (here / name).read_bytes() for name in names(here)} == before
    assert gf_usd("bake", block, *SMALL, "--drop", "0.5r", "-q", "--overwrite").status == 0
    assert names(here) == list(before)
    assert (here / "block.rubber.cache.usdc").read_bytes() != before["block.rubber.cache.usdc"]


@pytest.mark.slow
def test_quiet_and_verbose(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "-q")
    assert (done.status, done.out, done.err) == (0, "", "")
    loud = gf_usd("bake", block, *SMALL, "-v", "--overwrite")
    assert loud.status == 0
    assert loud.err.startswith(f"{block}: 1 mesh, ")
    assert "would write block.rubber.usda" in loud.err
    assert "would write" not in loud.out


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
    known = ", ".join(sorted([*OPTIONS, "progress"]))
    assert caught.value.hint == f"did you mean particles? its options are {known}"
    assert names(here) == []

"""gf-usd check: findings as text and as JSON, and the exit status for scripts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from small_bakes import names

from gf_usd.cli.check import unchecked
from gf_usd.layers.check.base import Skip

# A triangle that leads to a fourth point which is not there.
BROKEN = """#usda 1.0
(
    defaultPrim = "Shard"
    metersPerUnit = 1
    upAxis = "Y"
)
def Mesh "Shard"
{
    float3[] extent = [(0, 0, 0), (1, 1, 0)]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 3]
}
"""
KEYS = [
    *("file", "ok", "rules", "prims", "layers"),
    *("findings", "inherited", "usd_warnings", "skipped"),
]


@pytest.fixture
def broken(here: Path) -> str:
    (here / "shard.usda").write_text(BROKEN)
    return "shard.usda"


@pytest.fixture
def mild(here: Path, broken: str) -> str:
    """Without an extent, which USD computes where it has to: a warning."""
    lines = BROKEN.replace("[0, 1, 3]", "[0, 1, 2]").splitlines()
    text = "\n".join(line for line in lines if "extent" not in line)
    (here / "mild.usda").write_text(text + "\n")
    return "mild.usda"


def test_a_sound_file(gf_usd, block: Path) -> None:
    done = gf_usd("check", block)
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith(f"{block}: 0 errors, 0 warnings (")
    assert done.out.count("\n") == 1


def test_a_broken_file(gf_usd, broken: str) -> None:
    done = gf_usd("check", broken)
    assert (done.status, done.err) == (1, "")
    assert "error: mesh-topology </Shard>\n" in done.out
    lines = done.out.splitlines()
    finding = lines.index("error: mesh-topology </Shard>")
    assert lines[finding + 1].startswith("  ")
    assert lines[finding + 2].startswith("  fix: ")
    assert lines[-1].startswith("shard.usda: ")
    assert " 0 errors" not in lines[-1]


def test_warnings_do_not_count(gf_usd, mild: str) -> None:
    done = gf_usd("check", mild)
    assert done.status == 0
    assert "warning: extent </Shard>\n" in done.out
    assert "mild.usda: 0 errors, 1 warning (" in done.out


def test_findings_of_the_source_of_a_bake_are_apart(gf_usd, broken: str, here: Path) -> None:
    (here / "shard.rubber.usda").write_text(
        """#usda 1.0
(
    defaultPrim = "Shard"
    endTimeCode = 1
    metersPerUnit = 1
    startTimeCode = 1
    upAxis = "Y"
)
def "Shard" (
    references = @shard.usda@
    variants = { string gaussianFlesh = "rubber" }
    prepend variantSets = "gaussianFlesh"
)
{
    double late.timeSamples = { 1: 0, 9: 1 }
    variantSet "gaussianFlesh" = { "none" {} "rubber" {} }
}
"""
    )
    done = gf_usd("check", "shard.rubber.usda")
    assert done.status == 0
    lines = done.out.splitlines()
    assert not [line for line in lines if line.startswith(("error", "warning"))]
    assert "also in the source: mesh-topology </Shard>" in lines
    assert "also in the source: warning: time-range </Shard>" in lines
    assert lines[-1].startswith("shard.rubber.usda: 0 errors, 0 warnings, ")
    assert ", 1 warning in the source (" in lines[-1]


@pytest.mark.parametrize("sound", [True, False])
def test_json(gf_usd, block: Path, broken: str, sound: bool) -> None:
    file = str(block) if sound else broken
    done = gf_usd("check", file, "--json")
    assert (done.status, done.err) == (0 if sound else 1, "")
    report = json.loads(done.out)
    assert list(report) == KEYS
    assert (report["file"], report["ok"]) == (file, sound)
    assert (report["layers"], report["skipped"]) == (2, [])  # the file and the session's
    assert report["prims"] == (2 if sound else 1)
    assert report["rules"] > 10
    for finding in report["findings"]:
        assert set(finding) == {"rule", "severity", "prim_path", "message", "fix", "subject"}
    found = {(f["rule"], f["prim_path"]) for f in report["findings"]}
    assert found == set() if sound else ("mesh-topology", "/Shard") in found


def test_one_line_for_what_a_rule_cannot_check() -> None:
    """With the number of prims and at most three of them, however many there are."""
    at = [Skip(rule="velocities", prim_path=f"/P{k}", reason="too short") for k in range(5)]
    other = Skip(rule="usd", prim_path="/", reason="not run")
    assert unchecked([]) == []
    assert unchecked([other, *at[:1]]) == [
        "not checked: usd </>: not run",
        "not checked: velocities </P0>: too short",
    ]
    assert unchecked([*at[:3], other]) == [
        "not checked: velocities of 3 prims, </P0>, </P1>, </P2>: too short",
        "not checked: usd </>: not run",
    ]
    assert unchecked([at[0], *at]) == [
        "not checked: velocities of 5 prims, </P0>, </P1>, </P2> and 2 more: too short"
    ]
    fast = replace(at[1], reason="too fast")
    assert unchecked([at[0], fast]) == [
        "not checked: velocities of 2 prims, </P0>, </P1>: too short"
        " (1 other reason: --json lists all)"
    ]


def test_a_bake_passes(gf_usd, here: Path, block: Path) -> None:
    assert gf_usd("bake", block, "--particles", "100", "--frames", "2", "-q").status == 0
    done = gf_usd("check", "block.rubber.usda")
    assert done.status == 0, done.out


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("no.usda", "no.usda does not exist"),
        ("notes.txt", "notes.txt does not have the suffix of a USD file"),
        ("text.usda", "text.usda cannot be opened as USD: "),
    ],
)
def test_what_is_no_usd_file(gf_usd, here: Path, file: str, message: str) -> None:
    for name in ("notes.txt", "text.usda"):
        (here / name).write_text("rubber, please\n")
    done = gf_usd("check", file)
    assert (done.status, done.out) == (3, "")
    assert done.err.startswith(f"error: {message}")
    assert "\n\nhint: " in done.err
    assert "Traceback" not in done.err
    assert names(here) == ["notes.txt", "text.usda"]

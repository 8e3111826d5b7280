"""gf-usd materials, schema-path, --version and --help: what is said without an asset."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

import gf_usd as package
from gf_usd.materials import LAW_TOKENS, LOOKS, PHYSICAL, presets


def test_every_preset_is_listed_with_its_source(gf_usd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    done = gf_usd("materials")
    assert (done.status, done.err) == (0, "")
    rows = [line.replace("│", "|") for line in done.out.splitlines()]
    for name in presets():
        assert any(f"| {name} " in row for row in rows), name
    for look in LOOKS.values():
        assert f"{look.mu:g}" in done.out
        assert look.note in done.out
    assert "laws: corotated, neoHookean (--law)" in done.out


def test_nothing_is_cut_off_on_a_narrow_terminal(gf_usd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    done = gf_usd("materials")
    assert "…" not in done.out
    assert max(len(line) for line in done.out.splitlines()) <= 80


def test_json(gf_usd) -> None:
    done = gf_usd("materials", "--json")
    assert (done.status, done.err) == (0, "")
    assert json.loads(done.out) == {
        "looks": [asdict(look) for look in LOOKS.values()],
        "physical": [asdict(p) for p in PHYSICAL.values()],
        "laws": list(LAW_TOKENS),
    }


def test_the_schema_s_folder(gf_usd) -> None:
    done = gf_usd("schema-path")
    assert (done.status, done.err) == (0, "")
    folder = Path(done.out.rstrip("\n"))
    assert (folder / "plugInfo.json").is_file()
    assert (folder / "generatedSchema.usda").is_file()


def test_the_version(gf_usd) -> None:
    done = gf_usd("--version")
    assert (done.status, done.out, done.err) == (0, f"gf-usd {package.__version__}\n", "")


@pytest.mark.parametrize("command", ["bake", "inspect", "preview", "check", "materials"])
@pytest.mark.parametrize("option", ["-h", "--help"])
def test_every_command_has_help(gf_usd, command: str, option: str) -> None:
    done = gf_usd(command, option)
    assert (done.status, done.err) == (0, "")
    assert f"gf-usd {command}" in done.out


def test_an_unknown_command(gf_usd) -> None:
    done = gf_usd("cook")
    assert (done.status, done.out) == (2, "")
    assert "cook" in done.err

"""The bake of a folder: what it makes of sound, damaged and foreign files, and that it can fail."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

import pytest
from small_bakes import BLOCK

from tools.acceptance import bake_assets


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "assets"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "block.usda").write_text(BLOCK)
    (folder / "damaged.usda").write_text("#usda 1.0\ndef")
    (folder / "notes.txt").write_text("not an asset")
    return folder


def run(monkeypatch: pytest.MonkeyPatch, folder: Path, *arguments: str) -> tuple[int, str]:
    page = folder.parent / "page.md"
    page.write_text(f"above\n{bake_assets.BEGIN}old\n{bake_assets.END}below\n")
    monkeypatch.setattr(
        sys, "argv", ["bake_assets", str(folder), "--write", str(page), "--frames", "2", *arguments]
    )
    return bake_assets.main(), page.read_text()


@pytest.mark.slow
@pytest.mark.acceptance
def test_baked_or_refused_in_words(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    status, page = run(monkeypatch, folder, "--particles", "100")
    assert status == 0
    above, *table, below = page.splitlines()
    assert (above, below) == ("above", "below")
    damaged, block = table[3:5]
    assert damaged.startswith("| `damaged.usda` | refused | ")
    assert "damaged.usda is damaged: " in damaged
    assert "Hint: export the asset again" in damaged
    assert block.startswith("| `deep/block.usda` | baked | ")
    assert " | 1 mesh, " in block
    assert len(table) == 6
    assert str(folder) not in page


def test_what_was_baked_is_not_baked_again(
    monkeypatch: pytest.MonkeyPatch, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each row is written when its asset is done, so that a run that ends early can continue."""
    rows, commands = folder.parent / "rows.jsonl", []

    def refuse(*arguments: str, patience: float) -> tuple[int, str, str]:
        commands.append(Path(arguments[1]).name)
        event = {"event": "error", "status": 3, "message": "no", "hint": "yes"}
        return 3, json.dumps(event) + "\n", "error: no"

    monkeypatch.setattr(bake_assets, "gf_usd", refuse)
    arguments = ("--rows", str(rows), "--json")
    run(monkeypatch, folder, *arguments, "--only", "block")
    run(monkeypatch, folder, *arguments)
    assert commands == ["block.usda", "damaged.usda"]
    one, two = map(json.loads, rows.read_text("utf-8").splitlines())
    assert (one["asset"], two["asset"]) == ("deep/block.usda", "damaged.usda")
    assert one["date"] < "3000"
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report == {"outcomes": [two, one], "changed": []}


def test_a_crash_and_a_changed_file_are_failures(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    def crash(*arguments: str, patience: float) -> tuple[int, str, str]:
        (folder / "notes.txt").write_text("changed")
        return 1, "", "Traceback\nKeyError: 'up'\n"

    monkeypatch.setattr(bake_assets, "gf_usd", crash)
    before = bake_assets.digests(folder)
    status, page = run(monkeypatch, folder)
    assert status == 1
    assert page.count("| failed | ") == 2
    assert "KeyError: 'up'" in page
    assert bake_assets.digests(folder) != before


def test_a_refusal_without_a_hint_or_with_files_left_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    def refuse(
        *arguments: str, patience: float, hint: str = "yes", left: str = ""
    ) -> tuple[int, str, str]:
        if left:
            Path(arguments[3], left).write_text("")
        event = {"event": "error", "status": 3, "message": "no", "hint": hint}
        return 3, json.dumps(event) + "\n", f"error: no\n\nhint: {hint}"

    monkeypatch.setattr(bake_assets, "gf_usd", refuse)
    assert run(monkeypatch, folder)[0] == 0
    monkeypatch.setattr(bake_assets, "gf_usd", partial(refuse, hint=""))
    assert run(monkeypatch, folder)[0] == 1
    monkeypatch.setattr(bake_assets, "gf_usd", partial(refuse, left="left.usda"))
    assert run(monkeypatch, folder)[0] == 1


@pytest.mark.parametrize(
    ("health", "message"),
    [
        ({"inverted_max": 2, "rollbacks": 0}, "2 particles inside out"),
        ({"inverted_max": 0, "rollbacks": 3}, "3 frames redone"),
    ],
)
def test_particles_inside_out_and_frames_redone_are_failures(
    monkeypatch: pytest.MonkeyPatch, folder: Path, health: dict[str, int], message: str
) -> None:
    commands = []

    def unsound(*arguments: str, patience: float) -> tuple[int, str, str]:
        commands.append(arguments)
        assert patience == 99.0
        if arguments[0] == "check":
            return 0, json.dumps({"findings": []}), ""
        report = folder.parent / "report.json"
        report.write_text(
            json.dumps({"check": [], "bodies": [1], "embedded": [], "bakes": [{"health": health}]})
        )
        end = {"event": "finished", "report": str(report), "root": "root.usda", "particles": 9}
        return 0, json.dumps(end) + "\n", ""

    monkeypatch.setattr(bake_assets, "gf_usd", unsound)
    arguments = ("--plain", "--material", "rubber", "--only", "block", "--patience", "99")
    status, page = run(monkeypatch, folder, *arguments)
    assert status == 1
    assert page.count("| failed | ") == 1
    assert message in page
    bake = next(arguments for arguments in commands if arguments[0] == "bake")
    assert "--frames" not in bake
    assert bake[-2:] == ("--material", "rubber")

"""Tools that are run by name say how: with -h they do nothing else."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
SCRIPTS = [
    file
    for file in sorted(TOOLS.glob("*.py"))
    if "__main__" in file.read_text(encoding="utf-8") and file.stem != "blender_picture"
]  # blender_picture runs in the environment of Blender


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_help_is_all_that_is_done(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script), "-h"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(script), run_name="__main__")
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {script.name} [-h]")
    assert list(tmp_path.iterdir()) == []

"""The commands of docs/certify.md run in order, as they are written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pasted import paste

from tools.documents import ROOT, blocks

PAGE = ROOT / "docs" / "certify.md"


def script() -> str:
    """Its blocks of commands and of Python, as one script, with fewer frames."""
    parts = []
    for block in blocks(PAGE):
        if block.language == "bash":
            parts.append(block.text)
        elif block.language == "python":
            parts.append(f"python - <<'END'\n{block.text}\nEND")
    text = "\n".join(parts)
    shorter = (("--frames 72", "--frames 9"), ("--frames 20", "--frames 3"),
               ("--particles 600", "--particles 200"))  # fmt: skip
    for many, few in shorter:
        assert many in text
        text = text.replace(many, few)
    return text


@pytest.mark.slow
@pytest.mark.acceptance
def test_the_example_runs(tmp_path: Path) -> None:
    paste(script(), tmp_path, particles=5000, frames=9)
    report = json.loads((tmp_path / "certain.report.json").read_text("utf-8"))
    figures = report["bakes"][0]["certificate"]["figures"]
    # as the page says, whose frames are more: the first contact is over by frame 9
    for name, value, half in (("squash", 0.2067, 0.0031), ("first_contact_time", 0.15767, 1e-5)):
        assert figures[name]["value"][0] == pytest.approx(value, abs=half)
        assert figures[name]["half_width"] <= 2.0 * half
    assert (tmp_path / "sweep.sheet.png").stat().st_size > 1000

"""The worked example of docs/fit.md runs as it is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from pasted import paste

from gf_usd.fitting.figures import FIGURES
from tools.documents import ROOT, blocks

PAGE = ROOT / "docs" / "fit.md"


def test_the_page_has_every_number() -> None:
    text = PAGE.read_text("utf-8")
    assert [name for name in FIGURES if f"`{name}`" not in text] == []


@pytest.mark.slow
@pytest.mark.acceptance
def test_the_example_runs(tmp_path: Path) -> None:
    script = "\n".join(block.text for block in blocks(PAGE) if block.language == "bash")
    # fewer particles and frames than a reader would like to see
    for many, few in (
        ("--particles 8000", "--particles 300"),
        ("--particles 1000", "--particles 200"),
        ("--frames 30", "--frames 12"),
        ("--drop 1 ", "--drop 0.3 "),
    ):
        script = script.replace(many, few)
    output = paste(script, tmp_path)
    assert "youngs_modulus" in output
    assert (tmp_path / "sphere.fit.png").stat().st_size > 1000
    assert (tmp_path / "again.usda").is_file()

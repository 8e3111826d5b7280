"""The tables of options in the guide say what the commands say."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.generate_options import BAKE, INSPECT, renewed


@pytest.mark.parametrize("page", [BAKE, INSPECT])
def test_the_tables_of_the_guide_are_up_to_date(page: Path) -> None:
    text = page.read_text("utf-8")
    assert renewed(text, page) == text, "run tools/generate_options.py"


@pytest.mark.parametrize(
    ("page", "old", "new"),
    [
        (BAKE, "| Bake this prim and its descendants; repeatable. |", "| Bake that prim. |"),
        (BAKE, "| `--seed` | the stage's, else 0 |", "| `--seed` | 0 |"),
        (INSPECT, "| `--repair` | off | Show what", "| `--repair` | on | Show what"),
    ],
)
def test_a_hand_edit_is_undone(page: Path, old: str, new: str) -> None:
    text = page.read_text("utf-8")
    assert text.count(old) == 1
    assert renewed(text.replace(old, new), page) == text


def test_the_last_column_is_kept() -> None:
    text = BAKE.read_text("utf-8")
    cell = "equal seeds give equal particles and noise |"
    assert text.count(cell) == 1
    assert "by hand |" in renewed(text.replace(cell, "by hand |"), BAKE)


def test_a_table_that_is_gone_is_missed() -> None:
    text = BAKE.read_text("utf-8")
    with pytest.raises(SystemExit, match=r"options\.md: there is no table of options for Scene"):
        renewed(text.replace("## Scene", "## Stage"), BAKE)

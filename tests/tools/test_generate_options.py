"""The tables of options in the guide say what the commands say."""

from __future__ import annotations

import pytest

from tools import generate_options


def test_the_tables_of_the_guide_are_up_to_date() -> None:
    text = generate_options.GUIDE.read_text("utf-8")
    assert generate_options.renewed(text) == text, "run tools/generate_options.py"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("| Bake this prim and its descendants; repeatable. |", "| Bake that prim. |"),
        ("| `--seed` | the stage's, else 0 |", "| `--seed` | 0 |"),
        ("| `--repair` | off | Show what", "| `--repair` | on | Show what"),
    ],
)
def test_a_hand_edit_is_undone_and_the_last_column_is_kept(old: str, new: str) -> None:
    text = generate_options.GUIDE.read_text("utf-8")
    assert text.count(old) == 1
    assert generate_options.renewed(text.replace(old, new)) == text
    cell = "equal seeds give equal particles and noise |"
    assert "by hand |" in generate_options.renewed(text.replace(cell, "by hand |"))


def test_a_table_that_is_gone_is_missed() -> None:
    text = generate_options.GUIDE.read_text("utf-8")
    with pytest.raises(SystemExit, match="no table of options for Scene"):
        generate_options.renewed(text.replace("**Scene**", "**Stage**"))

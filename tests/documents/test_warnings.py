"""The names of warnings in the documents are those that the program prints, and all are listed."""

from __future__ import annotations

import re

import pytest

from gf_usd.pipeline.health.warnings import RULES, plan_warnings
from tools.documents import ROOT

NAMES = {
    *RULES,
    *(warning.about for warning in plan_warnings("an odd size", "a density", "its density")),
}


def test_the_guide_lists_every_warning() -> None:
    page = (ROOT / "docs/guide/warnings-and-errors.md").read_text(encoding="utf-8")
    rows = page.partition("| `about` | where |")[2].partition("\n\n")[0].strip().splitlines()
    listed = [name for row in rows for name in re.findall(r"`([a-z-]+)`", row.split("|")[1])]
    assert sorted(listed) == sorted(NAMES)


@pytest.mark.parametrize(
    "page", ["troubleshooting.md", "tutorials/looks-wrong.md", "guide/warnings-and-errors.md"]
)
def test_a_page_names_warnings_that_exist(page: str) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    groups = re.findall(r"\(warnings? (`[a-z-]+`(?:, `[a-z-]+`)*)\)", text)
    named = {name for group in groups for name in re.findall(r"`([a-z-]+)`", group)}
    named |= set(re.findall(r"(?:warning: | {6})\w+: .* \[([a-z-]+)\]$", text, flags=re.M))
    assert named
    assert named <= NAMES

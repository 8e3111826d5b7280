"""Terms that the table of words in CONTRIBUTING.md replaces do not come back."""

from __future__ import annotations

import re

import pytest

from tools.documents import PAGES, ROOT

# Those of the column "not" that have no other meaning in these texts, as they may be inflected.
REPLACED = {
    "follower": r"followers?",
    "rider": r"riders?",
    "sunk": r"sunk",
    "go on": r"(?:go|goes|went|going) on",
    "what it faces": r"what (?:it|they) faces?",
    "without end": r"without end",
    "does not go with": r"do(?:es)? not go with",
    "in words": r"in words",
}
PHRASES = ("go on", "what it faces", "without end", "does not go with")  # never names in code
CODE = re.compile(r"^(```|~~~).*?^\1|^ {4}\S.*?$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
# records of runs, whose texts are those of their time, and the table itself
OTHERS = {"acceptance.md", "verification.md", "CONTRIBUTING.md"}
PROSE = [page for page in PAGES if page.name not in OTHERS]


def replaced(text: str, terms: tuple[str, ...]) -> list[str]:
    """The replaced terms in a text, as they stand there."""
    pattern = re.compile(rf"\b(?:{'|'.join(REPLACED[term] for term in terms)})\b", re.IGNORECASE)
    return pattern.findall(" ".join(text.split()))


def prose(text: str) -> str:
    """A page without its code."""
    return CODE.sub(" ", text)


@pytest.mark.parametrize("page", PROSE, ids=lambda page: page.name)
def test_pages_use_the_terms_of_the_table(page) -> None:
    assert replaced(prose(page.read_text("utf-8")), tuple(REPLACED)) == []


@pytest.mark.parametrize("package", ["gf_usd", "integrations", "tools"])
def test_sources_use_the_phrases_of_the_table(package: str) -> None:
    found = {
        path.relative_to(ROOT).as_posix(): terms
        for path in sorted((ROOT / package).rglob("*.py"))
        if (terms := replaced(path.read_text("utf-8"), PHRASES))
    }
    assert found == {}


def test_the_terms_are_those_of_the_table() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    rows = re.findall(r"^\|[^|]*\|[^|]*\| *([^|]+?) *\|$", text, re.MULTILINE)
    assert set(REPLACED) <= {term for row in rows for term in row.split(", ")}


def test_a_replaced_term_is_noticed_in_prose_and_not_in_code() -> None:
    text = "It went on.\n\n    a bake goes on\n\n`followers` ride; riders\ndo not go with it"
    assert replaced(prose(text), tuple(REPLACED)) == ["went on", "riders", "do not go with"]

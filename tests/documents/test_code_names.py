"""Files of the source, and names in them, that the documents mention exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.documents import PAGES, ROOT

FILE = re.compile(r"`((?:[\w*]+/)*\w+\.py)`")
NAME_IN_FILE = re.compile(r"`((?:\w+/)*\w+\.py)` `([A-Za-z_][\w.]*)`")
PLACEHOLDER = re.compile(r"\b[A-Z]{4,}\b|_TOPIC")  # physics/laws/NAME.py
# made by the recipes of docs/extending.md
MADE = {"stable_neo_hookean.py", "ideal_plastic.py", "medit.py", "trails.py", "naming.py"}
FOLDERS = ("gf_usd", "tests", "tools", "samples", "integrations")
SOURCE = [
    path.relative_to(ROOT).as_posix() for name in FOLDERS for path in (ROOT / name).rglob("*.py")
]


def files(path: str) -> list[str]:
    """The files of the source that a path, or the end of one, means."""
    return [file for file in SOURCE if file == path or file.endswith(f"/{path}")]


def missing(text: str) -> Iterator[str]:
    """Files that do not exist, and names that no file of the path before them contains."""
    for path in FILE.findall(text):
        if not (PLACEHOLDER.search(path) or Path(path).name in MADE or files(path)):
            yield path
    for path, name in NAME_IN_FILE.findall(text):
        if found := files(path):
            last = re.compile(rf"\b{name.rpartition('.')[2]}\b")
            if not any(last.search((ROOT / file).read_text("utf-8")) for file in found):
                yield f"{path} {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_code_that_a_page_names_exists(page: Path) -> None:
    assert list(missing(page.read_text("utf-8"))) == []


def test_what_does_not_exist_is_noticed() -> None:
    text = "`frames/frame.py` `Frame`, `frame.py` `Fraem`, `core/farmes.py`, `physics/laws/NAME.py`"
    assert list(missing(text)) == ["core/farmes.py", "frame.py Fraem"]

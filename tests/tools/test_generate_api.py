"""The reference page says what the docstrings say, and leaves no public name out."""

from __future__ import annotations

import re

import gf_usd
from gf_usd.prepare.options.table import OPTIONS
from tools import generate_api


def test_the_page_is_up_to_date() -> None:
    text = generate_api.PAGE.read_text("utf-8")
    assert generate_api.page() == text, "run tools/generate_api.py"


def test_every_public_name_is_in_one_group_and_has_words() -> None:
    grouped = [name for names in generate_api.GROUPS.values() for name in names]
    assert sorted(grouped) == sorted(name for name in gf_usd.__all__ if name != "__version__")
    for name in grouped:
        lines = [line for line in generate_api.described(name) if line.strip()]
        assert len(lines) > 1, name


def test_every_keyword_is_listed() -> None:
    table = "\n".join(generate_api.option_table())
    assert all(f"| `{name}` |" in table for name in OPTIONS)
    assert "--" not in table.replace("|---|---|---|", "")


def test_the_table_of_keywords_says_what_python_does() -> None:
    rows = {row.split("`")[1]: row for row in generate_api.option_table() if row[:3] == "| `"}
    assert "this process reads the file" in rows["limits"]
    assert "Unfinished" in rows["slice"]
    assert "UnhealthyError" in rows["strict"]
    assert not [row for row in rows.values() if re.search(r"status \d", row)]


def test_a_docstring_becomes_markdown() -> None:
    text = (
        "Do it.\n\n>>> 1 + 1\n2\n\nMore ``code``.\n\n"
        "Parameters\n----------\na : first\n    line.\nb, c : others.\n\n"
        "Raises\n------\nValueError : never.\n"
    )
    assert list(generate_api.markdown(text)) == [
        "Do it.", "", "```python", ">>> 1 + 1\n2", "```", "", "More `code`.", "",
        "**Parameters**", "", "- `a`: first line.", "- `b`, `c`: others.", "",
        "**Raises**", "", "- `ValueError`: never.",
    ]  # fmt: skip

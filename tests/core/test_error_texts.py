"""Texts of errors, read from the source: one style, since each is shown after `error: `."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "gf_usd"
NAMES = re.compile(r"Taichi\b")  # a message may start with one


def texts() -> Iterator[tuple[str, str, str]]:
    """Where an error is made, and the first and the last literal text of its message."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not node.args:
                continue
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            if not re.search(r"(Error|Unfinished|OutOfResources)$", name):
                continue
            message = node.args[0]
            parts = message.values if isinstance(message, ast.JoinedStr) else [message]
            if not parts:
                continue
            first, last = (
                part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else ""
                for part in (parts[0], parts[-1])
            )
            yield f"{path.relative_to(PACKAGE)}:{node.lineno}", first, last


def test_messages_end_without_a_period_and_start_in_lower_case() -> None:
    found = list(texts())
    assert len(found) > 300
    wrong = [
        where
        for where, first, last in found
        if re.search(r"[^.]\.$", last)
        or (re.match(r"[A-Z][a-z]* ", first) and not NAMES.match(first))
    ]
    assert wrong == []

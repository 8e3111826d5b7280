"""Python of the documents uses only names that its page has defined or imported before."""

from __future__ import annotations

import ast
import builtins
from pathlib import Path

import pytest

from tools.documents import PAGES, ROOT, blocks

# signatures and sessions, which other tests run; excerpts of files, which another test runs
WITHOUT = {ROOT / "docs" / "api.md", ROOT / "docs" / "extending.md"}
WITH_PYTHON = [
    page
    for page in PAGES
    if page not in WITHOUT and any(block.language == "python" for block in blocks(page))
]


def undefined(page: Path) -> list[str]:
    """Names that code uses and that no block so far defines, with the line of the block."""
    known = set(dir(builtins))
    found = []
    for block in blocks(page):
        if block.language != "python":
            continue
        tree = ast.parse(block.text)
        used = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Name):
                (used if isinstance(node.ctx, ast.Load) else known).add(node.id)
            elif isinstance(node, ast.alias):
                known.add((node.asname or node.name).partition(".")[0])
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                known.add(node.name)
            elif isinstance(node, ast.arg):
                known.add(node.arg)
            elif isinstance(node, ast.ExceptHandler) and node.name:
                known.add(node.name)
        found += [f"{block.line}: {name}" for name in sorted(used - known)]
    return found


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.stem)
def test_every_name_is_defined(page: Path) -> None:
    assert undefined(page) == []


def test_a_missing_import_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```python\nfor one in Path('a').glob(b):\n    print(one)\n```\n", "utf-8")
    assert undefined(page) == ["2: Path", "2: b"]

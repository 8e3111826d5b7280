"""Every tool can be imported, those included that run for hours."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ELSEWHERE = {"peers", "blender_picture"}  # in the environments of other programs
TOOLS = [
    ".".join(file.relative_to(ROOT).with_suffix("").parts)
    for file in sorted((ROOT / "tools").rglob("*.py"))
    if ELSEWHERE.isdisjoint(file.relative_to(ROOT).with_suffix("").parts)
]


@pytest.mark.parametrize("name", TOOLS)
def test_it_can_be_imported(name: str) -> None:
    package, _, leaf = name.rpartition(".")
    module = importlib.import_module(package if leaf == "__init__" else name)
    assert module.__doc__

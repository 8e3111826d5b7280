"""`progress`: what it is called with, and that its exception cancels a bake."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_bakes import BLOCK

import gf_usd


class Cancelled(Exception):
    """What the caller of a bake raises to end it."""


def test_an_exception_of_progress_cancels_the_bake_and_reaches_the_caller(tmp_path: Path) -> None:
    asset = tmp_path / "block.usda"
    asset.write_text(BLOCK, encoding="utf-8")
    seen: list[tuple[int, int]] = []

    def stop_after_two(done: int, total: int) -> None:
        seen.append((done, total))
        if done == 2:
            raise Cancelled

    output = tmp_path / "out.usda"
    with pytest.raises(Cancelled):
        gf_usd.bake(asset, output=output, particles=100, frames=5, progress=stop_after_two)
    assert seen == [(1, 5), (2, 5)]
    files = {path.name for path in tmp_path.iterdir()}
    assert "out.usda" not in files
    assert all(".partial." in name for name in files - {"block.usda"}), files
    # what is left does not count as an existing result
    result = gf_usd.bake(asset, output=output, particles=100, frames=2)
    assert result.frames == 2
    assert not [path.name for path in tmp_path.iterdir() if ".partial." in path.name]

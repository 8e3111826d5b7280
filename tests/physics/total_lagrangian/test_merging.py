"""Kernels as they are shipped, and as quick tests compile them: without the search for statements
that are written twice, which takes most of the time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from resumed import require_same
from small_bakes import BLOCK

import gf_usd
from gf_usd.system.taichi_runtime import MERGE_OPTIONS


@pytest.mark.skipif(
    MERGE_OPTIONS[True] != MERGE_OPTIONS[False],
    reason="this process has the shipped kernels as well",
)
def test_the_search_for_what_is_written_twice_changes_no_bit(tmp_path: Path) -> None:
    block = tmp_path / "block.usda"
    block.write_text(BLOCK, encoding="utf-8")
    options: dict[str, Any] = {"particles": 300, "frames": 6, "drop": 0.01, "clip_frames": 3}
    shipped, here = tmp_path / "shipped", tmp_path / "here"
    for folder in (shipped, here):
        folder.mkdir()
    code = (
        "import gf_usd\n"
        "from gf_usd.system.taichi_runtime import MERGE_OPTIONS\n"
        "assert MERGE_OPTIONS[True]['opt_level'] == 1\n"
        f"gf_usd.bake({str(block)!r}, output={str(shipped / 'out.usda')!r}, **{options!r})\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    done = gf_usd.bake(block, output=here / "out.usda", **options)
    assert done.health["first_contact_frame"] is not None
    require_same(shipped, here)

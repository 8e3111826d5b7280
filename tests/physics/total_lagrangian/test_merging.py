"""Kernels as they are shipped, and as tests compile them: without the search for statements
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


@pytest.mark.slow
@pytest.mark.parametrize("material", ["rubber", pytest.param("clay", marks=pytest.mark.acceptance)])
def test_the_search_for_what_is_written_twice_changes_no_bit(tmp_path: Path, material: str) -> None:
    """Rubber is elastic, and clay has a history and a return mapping besides.

    A second process compiles in the way that this one does not.
    """
    is_shipped = MERGE_OPTIONS[True] != MERGE_OPTIONS[False]
    block = tmp_path / "block.usda"
    block.write_text(BLOCK, encoding="utf-8")
    options: dict[str, Any] = {
        "particles": 300, "frames": 6, "drop": 0.01, "clip_frames": 3, "material": material,
    }  # fmt: skip
    there, here = tmp_path / "there", tmp_path / "here"
    for folder in (there, here):
        folder.mkdir()
    code = (
        "import gf_usd\n"
        "from gf_usd.system.taichi_runtime import MERGE_OPTIONS\n"
        "shipped = MERGE_OPTIONS[True]\n"
        "assert shipped['opt_level'] == 1\n"
        f"MERGE_OPTIONS[True] = MERGE_OPTIONS[False] if {is_shipped} else shipped\n"
        f"gf_usd.bake({str(block)!r}, output={str(there / 'out.usda')!r}, **{options!r})\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    done = gf_usd.bake(block, output=here / "out.usda", **options)
    assert done.health["first_contact_frame"] is not None
    require_same(there, here)

"""Bakes of solid and flowing bodies, in slices and again."""

from __future__ import annotations

from pathlib import Path

import pytest
from mixed_stages import castle_of
from resumed import require_same


@pytest.mark.slow
def test_a_mixed_bake_is_whole_and_comes_to_the_same_bits(
    gf_usd, here: Path, tmp_path: Path
) -> None:
    """In one go and in slices, with any number of threads, and again."""
    words = ("bake", castle_of(tmp_path), "--particles", "300", "--frames", "7", "--drop", "0",
             "-q", "--clip-frames", "2", "--internal", "--stress")  # fmt: skip
    assert gf_usd(*words, "-o", "one/").status == 0
    assert gf_usd(*words, "-o", "again/", "--threads", "1").status == 0
    assert gf_usd(*words, "-o", "two/", "--slice", "1").status == 5
    assert gf_usd(*words, "-o", "two/", "--slice", "1", "--resume").status == 5
    assert gf_usd(*words, "-o", "two/", "--resume").status == 0
    require_same(here / "one", here / "two")
    clips = sorted((here / "one").glob("*.clips/*.usdc"))
    assert len(clips) == 3
    for clip in clips:
        again = here / "again" / clip.relative_to(here / "one")
        assert again.read_bytes() == clip.read_bytes()

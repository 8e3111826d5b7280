"""A bake in a warm process is the bake of a process of its own, whatever ran before it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from small_bakes import BLOCK, Done

Call = Callable[..., Done]
# of several thread counts and laws, so that Taichi is started anew between bakes
MANIFEST = """
out = "OUT"
[settings]
particles = 150
frames = 3
[matrix]
material = ["rubber", "clay"]
[[assets]]
files = ["*.usda"]
[[assets]]
files = ["block.usda"]
name = "threads"
settings = { material = "jelly", threads = 2 }
matrix = {}
"""


@pytest.mark.slow
def test_warm_bakes_equal_cold_ones_byte_for_byte(gf_usd: Call, here: Path, block: Path) -> None:
    block.with_name("aaa_cut.usda").write_text(BLOCK[:500], encoding="utf-8")  # refused first
    block.with_name("zzz.usda").write_text(BLOCK.replace("1, ", "1.25, "), encoding="utf-8")
    for kind in ("warm", "no-warm"):
        manifest = block.with_name(f"{kind}.toml")
        manifest.write_text(MANIFEST.replace("OUT", str(here / kind)), encoding="utf-8")
        done = gf_usd("batch", manifest, "-j", "1", f"--{kind}", "--json", "-q", "--no-report")
        ends = [json.loads(line) for line in done.out.splitlines()]
        states = {e["job"]: e["state"] for e in ends if e["event"] == "finished"}
        assert sorted(set(states.values())) == ["done", "refused"], done.err
    files = sorted(p.name for p in (here / "no-warm").iterdir() if p.suffix in (".usda", ".usdc"))
    assert len(files) >= 8
    for name in files:
        assert (here / "warm" / name).read_bytes() == (here / "no-warm" / name).read_bytes(), name

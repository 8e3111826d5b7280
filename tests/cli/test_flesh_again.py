"""The same flesh twice: a bake again, alone and as a job of a batch, is equal byte for byte."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from arm import arm, write
from small_bakes import Done

Call = Callable[..., Done]
MANIFEST = """
out = "batch"
[settings]
flesh = true
particles = 300
preroll = 6
goal_frequency = 3.0
stretch = 0.4
fields = ["noise:9:length=0.5:rate=2", "wind:0,0,3"]
self_contact = true
[matrix]
material = ["jelly", "rubber"]
[[assets]]
files = ["arm.usda"]
"""
ARGUMENTS = (
    *("--flesh", "--particles", "300", "--preroll", "6", "--goal-frequency", "3"),
    *("--stretch", "0.4", "--self-contact"),
    *("--field", "noise:9:length=0.5:rate=2", "--field", "wind:0,0,3"),
)


@pytest.mark.slow
@pytest.mark.acceptance
def test_flesh_again_and_in_a_batch_is_the_same(gf_usd: Call, here: Path) -> None:
    write(here, arm())
    for folder in ("one/", "two/"):
        for material in ("jelly", "rubber"):
            done = gf_usd("bake", "arm.usda", *ARGUMENTS, "-m", material, "-o", folder, "-q")
            assert done.status == 0, done.err
    (here / "jobs.toml").write_text(MANIFEST, encoding="utf-8")
    done = gf_usd("batch", "jobs.toml", "-j", "1", "--json", "-q", "--no-report")
    ends = [json.loads(line) for line in done.out.splitlines()]
    states = [e["state"] for e in ends if e["event"] == "finished"]
    assert states == ["done", "done"], done.err
    caches = sorted(path.name for path in (here / "one").rglob("*.usdc"))
    assert len(caches) >= 2
    for name in caches:
        (first,) = (here / "one").rglob(name)
        (again,) = (here / "two").rglob(name)
        (job,) = (here / "batch").rglob(name)
        assert first.read_bytes() == again.read_bytes(), name
        assert first.read_bytes() == job.read_bytes(), name

"""The endurance runs, cut short: what they print, and that they can fail."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tools.acceptance.sections import read_endurance

ROOT = Path(__file__).parents[2]


def ran(*arguments: str) -> subprocess.CompletedProcess[str]:
    tool = [sys.executable, "-m", "tools.acceptance.endurance", "--json", *arguments]
    return subprocess.run(tool, capture_output=True, text=True, check=False, cwd=ROOT)


@pytest.mark.slow
@pytest.mark.acceptance
def test_cut_short_they_are_not_yet_at_rest_and_say_so() -> None:
    done = ran("--particles", "300", "--frames-scale", "0.01")
    runs = json.loads(done.stdout.splitlines()[-1])["runs"]
    assert runs[0]["name"] == "rubber sphere"
    assert [r["frames"] for r in runs] == [r["requested"] for r in runs] == [30, 10, 10, 10]
    # thirty frames into a bounce nothing lies still: that alone makes them unsound
    assert done.returncode == 1
    assert not runs[0]["sound"]
    assert runs[0]["kinetic_end"] > 1e-3
    assert all(r["rollbacks"] == 0 and not r["fault"] for r in runs)


def test_acceptance_reads_it() -> None:
    row = {
        "name": "a", "frames": 3, "requested": 3, "rollbacks": 0, "inverted": 0, "farthest": 4.0,
        "kinetic_end": 1e-6, "energy_rise": 0.0, "seconds": 1.0, "fault": "", "sound": True,
    }  # fmt: skip
    bad = {**row, "name": "b", "frames": 1, "fault": "frame 2: it looks odd", "sound": False}
    for runs, passed in (([row], True), ([row, bad], False)):
        done = subprocess.CompletedProcess([], int(not passed), json.dumps({"runs": runs}))
        outcome = read_endurance(done)
        assert outcome.passed is passed
        assert len(outcome.table) == len(runs) + 1
    assert "it looks odd" in outcome.table[2][-1]
    assert "not b" in outcome.summary

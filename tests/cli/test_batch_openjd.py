"""A job bundle run by the real openjd, from its tasks to the page."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from resumed import require_same

from gf_usd.layers.check.run import check_file

INSTALLED = Path(sys.executable).with_name("openjd")
OPENJD = str(INSTALLED) if INSTALLED.is_file() else shutil.which("openjd")
NOTICE = 30.0  # [s] that the template grants to a task that is to end

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(OPENJD is None, reason="openjd-cli is not installed"),
]


def bundle(here: Path, block: Path, *arguments: str) -> list[str]:
    """The command that runs a new bundle of three jobs, two in a task."""
    command = [sys.executable, "-m", "gf_usd", "batch", str(block), "--seed", "0,1,2", "-o", "out",
               "--openjd", "bundle", "--chunk", "2", *arguments]  # fmt: skip
    subprocess.run(command, check=True, cwd=here, capture_output=True)
    folder = here / "bundle"
    return [str(OPENJD), "run", str(folder / "template.json"),
            "-p", f"file://{folder / 'parameters.json'}"]  # fmt: skip


@pytest.mark.acceptance
def test_its_tasks_bake_and_tell_and_its_report_shows(here: Path, block: Path) -> None:
    command = bundle(here, block, "--particles", "150", "--frames", "2")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    lines = [line.split("\t", 1)[-1] for line in done.stdout.splitlines()]
    assert lines.count("openjd_progress: 100.0") >= 2
    assert [s for s in lines if s.startswith("openjd_status: 2 of 2 done; ")]
    for seed in range(3):
        assert check_file(here / "out" / f"block.rubber.seed{seed}.usda").ok
    entry = json.loads((here / "out" / "out.batch.json").read_text("utf-8"))
    assert entry["counts"] == {"done": 3}
    assert (here / "out" / "out.batch.html").is_file()
    # an asset that is damaged meanwhile fails its task, with a message that the farm shows
    block.write_text("#usda 1.0\ndef {", encoding="utf-8")
    broken = subprocess.run(command, capture_output=True, text=True, check=False)
    assert broken.returncode == 1
    assert "openjd_fail: 2 of 2 jobs failed: block.rubber.seed" in broken.stdout


@pytest.mark.acceptance
def test_sigterm_ends_a_task_within_its_notice(here: Path, block: Path) -> None:
    command = bundle(here, block, "--particles", "300", "--frames", "6000")
    # else openjd passes on what a task prints only once its buffer is full, after the bake
    own = {**os.environ, "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=own)
    assert process.stdout is not None
    while "frame 600 of" not in process.stdout.readline():
        assert process.poll() is None
    began = time.monotonic()
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=2 * NOTICE)
    assert time.monotonic() - began < NOTICE
    assert process.returncode == 1
    assert "openjd_fail: 2 of 2 jobs failed" in out
    assert "exited with code: 143" in out
    final = [p.name for p in (here / "out").iterdir() if ".partial." not in p.name]
    assert all(name.startswith(".") for name in final)


@pytest.mark.acceptance
def test_slices_of_a_bundle_come_to_the_bits_of_one_run(here: Path, block: Path) -> None:
    cut = block.with_name("cut.usda")
    cut.write_text(block.read_text("utf-8")[:500], encoding="utf-8")
    gf_usd = (sys.executable, "-m", "gf_usd", "batch")
    common = ("--particles", "150", "--frames", "6", "--set", "clip_frames=1")
    sliced = ("-o", "out", "--openjd", "bundle", "--slice", "2")
    for arguments in ((block, "-o", "whole", "--no-report"), (block, cut, *sliced)):
        subprocess.run([*gf_usd, *arguments, *common], check=True, cwd=here, capture_output=True)
    folder = here / "bundle"
    checked = subprocess.run([str(OPENJD), "check", folder / "template.json"], check=False)
    assert checked.returncode == 0
    command = [str(OPENJD), "run", str(folder / "template.json"),
               "-p", f"file://{folder / 'parameters.json'}"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # a job that is refused fails the last step, and keeps no other from its slices
    assert done.returncode == 1
    assert done.stdout.count("cut.rubber: refused") >= 3
    assert done.stdout.count("openjd_fail: ") == 1
    for progress in ("3 of 6", "5 of 6"):
        assert f"sliced: block.rubber: rubber: {progress} frames are done" in done.stdout
    assert "block.rubber: done" in done.stdout
    cut.unlink()
    for name in ("cut.rubber.job.json", *(p.name for p in (here / "out").glob(".*"))):
        (here / "out" / name).unlink()
    require_same(here / "whole", here / "out")
    assert check_file(here / "out" / "block.rubber.usda").ok
    record = json.loads((here / "out" / "block.rubber.job.json").read_text("utf-8"))
    assert record["outcome"]["state"] == "done"
    # what is done is kept by all steps of another run
    again = subprocess.run(
        [*command, "-tp", "Job=0", "--step", "Bake 1 of 3"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "block.rubber: kept" in again.stdout, again.stdout

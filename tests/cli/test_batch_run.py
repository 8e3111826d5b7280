"""How a batch is stopped, and what it leaves for the next run of it."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from batch_jobs import outcome
from small_bakes import Done, names

from gf_usd.batch.board import write_summary
from gf_usd.cli.batch.run import _stoppable
from gf_usd.system.processes import Children

Call = Callable[..., Done]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_second_signal_does_not_stop_again(number: signal.Signals) -> None:
    """Its handler runs within that of the first, which holds the lock of the children."""
    stops = []

    class Stopped(Children):
        def stop(self) -> None:
            stops.append(number)
            if len(stops) < 3:
                signal.raise_signal(number)

    with _stoppable(Stopped()) as stopped:
        signal.raise_signal(number)
        signal.raise_signal(number)
    assert stops == [number]
    assert stopped == [number]


def test_a_second_signal_leaves_the_page_of_what_was_stopped(
    gf_usd: Call, here: Path, block: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(jobs, limits, **how):
        signal.raise_signal(signal.SIGINT)
        for job in jobs:
            yield {"event": "finished", **outcome(job.name, "stopped").as_json()}

    def signal_again(*arguments, **named):
        signal.raise_signal(signal.SIGINT)
        return write_summary(*arguments, **named)

    monkeypatch.setattr("gf_usd.cli.batch.run.run_locally", interrupted)
    monkeypatch.setattr("gf_usd.cli.batch.results.write_summary", signal_again)
    assert gf_usd("batch", block, "-o", "out", "-q").status == 130
    assert {"out.batch.json", "out.batch.html"} <= {*names(here / "out")}


def test_without_a_page_the_failed_jobs_are_still_known(
    gf_usd: Call, here: Path, block: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs_run = []

    def nothing(jobs, limits, **how):
        jobs_run.extend(job.name for job in jobs)
        for job in jobs:
            state = "stopped" if job.name == "block.jelly" else "done"
            yield {"event": "finished", **outcome(job.name, state).as_json()}

    monkeypatch.setattr("gf_usd.cli.batch.run.run_locally", nothing)
    arguments = ("batch", block, "-m", "rubber,jelly", "-o", "out", "--no-report", "-q")
    none = gf_usd(*arguments, "--failed")
    assert none.status == 2
    assert "no earlier run is known" in none.err
    assert jobs_run == []
    assert gf_usd(*arguments, "--tasks", "0").status == 0
    assert not (here / "out" / "out.batch.json").exists()
    assert gf_usd(*arguments).status == 1
    assert json.loads((here / "out" / "out.batch.json").read_text("utf-8"))["counts"] == {
        "done": 1, "stopped": 1,
    }  # fmt: skip
    assert not (here / "out" / "out.batch.html").exists()
    jobs_run.clear()
    gf_usd(*arguments, "--failed")
    assert jobs_run == ["block.jelly"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no such files")
def test_what_a_pattern_matches_and_is_no_file_is_reported(
    gf_usd: Call, here: Path, block: Path
) -> None:
    models = here / "models"
    models.mkdir()
    (models / "a.usda").write_bytes(block.read_bytes())
    (models / "gone.usda").symlink_to("nowhere.usda")
    os.mkfifo(models / "pipe.usda")
    for name in ("folder.usda", "textures"):
        (models / name).mkdir()
    done = gf_usd("batch", "models/*", "--dry-run")
    assert done.status == 0
    assert [line for line in done.err.splitlines() if line.startswith("note: ")] == [
        f"note: {models / 'folder.usda'} is skipped: it is a folder",
        f"note: {models / 'gone.usda'} is skipped: it is a link to a file that does not exist",
        f"note: {models / 'pipe.usda'} is skipped: it is no regular file",
    ]
    assert "a.rubber" in done.out

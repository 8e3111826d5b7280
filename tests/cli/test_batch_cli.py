"""gf-usd batch: jobs in processes of their own, and what is left of a bad night."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from small_bakes import BLOCK, Done, names

from gf_usd.batch import cluster
from gf_usd.layers.check.run import check_file
from gf_usd.system.file_locks import acquire

Call = Callable[..., Done]
SMALL = ("--particles", "150", "--frames", "2")


def events(done: Done) -> list[dict[str, Any]]:
    return [json.loads(line) for line in done.out.splitlines()]


def states(done: Done) -> dict[str, str]:
    return {e["job"]: e["state"] for e in events(done) if e["event"] == "finished"}


def begun(done: Done) -> list[str]:
    return sorted(e["job"] for e in events(done) if e["event"] == "started")


@pytest.fixture
def assets(block: Path) -> Path:
    """A folder with one sound asset and one that is cut short."""
    block.with_name("cut.usda").write_text(BLOCK[:500], encoding="utf-8")
    return block.parent


@pytest.mark.slow
def test_one_asset_stops_no_other_and_a_rerun_does_what_is_missing(
    gf_usd: Call, here: Path, assets: Path
) -> None:
    arguments = ("batch", assets / "*.usda", "-m", "rubber,jelly", *SMALL, "-o", "out")
    first = gf_usd(*arguments, "--json", "-q")
    assert first.status == 1
    assert states(first) == {
        "block.rubber": "done", "block.jelly": "done",
        "cut.rubber": "refused", "cut.jelly": "refused",
    }  # fmt: skip
    kinds = [e["event"] for e in events(first)]
    assert kinds[0] == "planned"
    assert kinds[-1] == "summary"
    assert kinds.count("frame") >= 4
    assert "cut.usda is damaged" in first.err
    repeat = f"gf-usd batch '{assets / '*.usda'}' -m rubber,jelly --particles 150 --frames 2 -o out"
    assert f"{repeat} --json -q --select cut.jelly --select cut.rubber" in first.err
    out = here / "out"
    assert {"out.batch.html", "out.batch.json", "block.jelly.job.json"} <= set(names(out))
    assert check_file(out / "block.jelly.usda").ok
    assert (out / "block.jelly.png").is_file()
    page = (out / "out.batch.html").read_text("utf-8")
    assert page.index("cut.rubber") < page.index("block.rubber")

    # another preset, and a result that was damaged: the rest is kept
    (out / "block.rubber.cache.usdc").write_bytes(b"PXR-USDC")
    again = gf_usd("batch", assets / "block.usda", "-m", "rubber,jelly", *SMALL, "-o", "out",
                   "--json", "--no-report")  # fmt: skip
    assert again.status == 0
    assert states(again) == {"block.rubber": "done", "block.jelly": "kept"}
    assert begun(again) == ["block.rubber"]
    assert check_file(out / "block.rubber.usda").ok

    failed = gf_usd(*arguments, "--failed", "--json", "-q", "--no-report")
    assert sorted(states(failed)) == ["cut.jelly", "cut.rubber"]


@pytest.mark.slow
def test_a_result_that_another_run_writes_is_left_to_it(
    gf_usd: Call, here: Path, block: Path
) -> None:
    held = acquire(here / "out" / "block.rubber.usda")
    assert held is not None
    done = gf_usd("batch", block, *SMALL, "-o", "out", "--json", "-q", "--no-report")
    held.release()
    assert done.status == 1
    assert states(done) == {"block.rubber": "busy"}
    assert begun(done) == []
    assert not (here / "out" / "block.rubber.usda").exists()


@pytest.fixture
def running(here: Path, block: Path) -> Iterator[subprocess.Popen[str]]:
    """A batch of many long bakes, of which the first frame was had."""
    arguments = [
        "batch", block, "-m", "rubber", "--seed", "0,1,2,3", "--particles", "3000",
        "--frames", "3000", "-j", "1", "-o", "out", "--json", "-q", "--no-report",
    ]  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-m", "gf_usd", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=here,
    )  # fmt: skip
    assert process.stdout is not None
    while '"frame"' not in process.stdout.readline():
        assert process.poll() is None
    yield process
    process.kill()
    process.wait()


@pytest.mark.slow
def test_sigterm_ends_the_bakes_and_says_how_to_resume(
    running: subprocess.Popen[str], here: Path
) -> None:
    running.send_signal(signal.SIGTERM)
    out, err = running.communicate(timeout=60)
    assert running.returncode == 143
    ended = [json.loads(line) for line in out.splitlines()]
    assert [e["state"] for e in ended if e["event"] == "finished"] == ["stopped"] * 4
    assert "4 stopped" in err
    assert "to repeat only these: gf-usd batch" in err
    left = [name for name in names(here / "out") if not name.startswith(".")]
    assert left
    assert all(".partial." in name for name in left if name != "out.batch.json")
    free = acquire(here / "out" / "block.rubber.seed0.usda")
    assert free is not None
    free.release()


@pytest.mark.slow
@pytest.mark.acceptance
def test_kill_9_leaves_no_bake_and_no_lock(running: subprocess.Popen[str], here: Path) -> None:
    running.kill()
    # the bake looks for the batch twice a second, and holds the lock until it is gone
    held = acquire(here / "out" / "block.rubber.seed0.usda", lock_timeout=60.0)
    assert held is not None
    held.release()
    final = [n for n in names(here / "out") if ".partial." not in n and not n.startswith(".")]
    assert final == []


@pytest.mark.slow
def test_an_interrupted_job_with_clips_continues(gf_usd: Call, here: Path, block: Path) -> None:
    arguments = ("--particles", "150", "--frames", "5")
    cut = gf_usd("bake", block, "-m", "rubber", *arguments, "--clip-frames", "1", "--slice", "2",
                 "-o", "out/block.rubber.usda", "-q")  # fmt: skip
    assert cut.status == 5
    done = gf_usd("batch", block, "-m", "rubber", *arguments, "--set", "clip_frames=1", "-o", "out",
                  "--no-report", "-q")  # fmt: skip
    assert done.status == 0
    report = json.loads((here / "out" / "block.rubber.report.json").read_text("utf-8"))
    assert any("rubber continues after frame 2, from " in note for note in report["notes"])
    assert not list((here / "out").glob("*.checkpoint.*"))


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_killed_bake_is_baked_again(here: Path, block: Path) -> None:
    arguments = [
        "batch", block, "--particles", "300", "--frames", "40", "-o", "out", "--json", "-q",
        "--no-report",
    ]  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-m", "gf_usd", *map(str, arguments)],
        stdout=subprocess.PIPE, text=True, cwd=here,
    )  # fmt: skip
    assert process.stdout is not None
    reported: list[dict[str, Any]] = []
    for line in process.stdout:
        reported.append(json.loads(line))
        if reported[-1]["event"] == "frame" and [e["event"] for e in reported].count("frame") == 1:
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
            found = {int(pid) for task in children.parents[1].iterdir()
                     for pid in (task / "children").read_text().split()}  # fmt: skip
            for pid in found:
                os.kill(pid, signal.SIGKILL)
    assert process.wait() == 0
    (retry,) = [e for e in reported if e["event"] == "retry"]
    assert retry["why"] == "the bake was ended by SIGKILL"
    (end,) = [e for e in reported if e["event"] == "finished"]
    assert (end["state"], end["attempts"]) == ("done", 2)
    assert check_file(here / "out" / "block.rubber.usda").ok


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nothing*.usda",), "no file matches nothing*.usda"),
        (("a.usda", "b.toml"), "give one manifest, or assets"),
        (("a.usda", "-m", "ruber"), "no material 'ruber'"),
        (("a.usda", "--set", "seed"), "--set seed: the value is missing"),
        (("a.usda", "--set", "speed=1"), "unknown option 'speed'"),
        (("a.usda", "--seed", "a"), "'a' is not of type int"),
        (("a.usda", "--select", "b"), "no job matches b"),
        (("a.usda", "--slice", "2"), "a.rubber: --slice counts value clips"),
        (("a.usda", "--part", "1/2"), "--part 1/2 is given without --slice"),
        (("a.usda", "--path-mapping", "x.json"), "--path-mapping applies only"),
        (("a.usda", "--resource", "memory=1e9"), "--resource is given without --scheduler"),
        (("a.usda", "--chunk", "2"), "--chunk is given without --openjd"),
        (("a.usda", "--timeout", "nan"), "--timeout: nan is not a number"),
        (("a.usda", "--timeout", "inf"), "--timeout is inf"),
        (("a.usda", "--report-only"), "--report-only: no earlier run is known"),
        (("a.usda", "--scheduler", "tcp://127.0.0.1:9"), "no scheduler answers"),
    ],
)  # fmt: skip
def test_wrong_usage_starts_nothing(
    gf_usd: Call,
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.setattr(cluster, "CONNECT", 0.5)
    done = gf_usd("batch", *arguments)
    assert done.status == 2
    assert message in done.err
    assert names(here) == []


def test_a_dry_run_lists_the_jobs(gf_usd: Call, here: Path, block: Path) -> None:
    done = gf_usd("batch", block, "-m", "rubber,jelly", "--dry-run", "--json", *SMALL)
    rows = [json.loads(line) for line in done.out.splitlines()]
    assert [(row["number"], row["name"]) for row in rows] == [
        (0, "block.rubber"),
        (1, "block.jelly"),
    ]
    assert rows[0]["command"].startswith("gf-usd bake ")
    assert names(here) == []


def test_inputs_lists_what_an_asset_reads(gf_usd: Call, assets: Path) -> None:
    done = gf_usd("inputs", "--json", assets / "block.usda", assets / "cut.usda")
    assert done.status == 3
    good, bad = (json.loads(line) for line in done.out.splitlines())
    assert [name for name, _ in good["files"]] == ["block.usda"]
    assert good["missing"] == []
    assert "damaged" in bad["error"]
    plain = gf_usd("inputs", assets / "block.usda")
    assert plain.status == 0
    assert "block.usda" in plain.out

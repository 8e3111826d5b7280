"""gf-usd bake --events: what happens, as one JSON object a line."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from resumed import start, wait_for
from small_bakes import ESTIMATE, REPORT, RESULT, SAMPLES, SMALL, names, strict

from gf_usd.core import __version__

CRUSH = ("-m", "jelly", "--law", "corotated", "--particles", "300", "--frames", "12",
         "--drop", "60", "--fps", "24")  # fmt: skip
COMMON = {"event", "time"}


def events(text: str) -> list[dict[str, Any]]:
    """The events of a stream, each line of which is an object."""
    assert text.endswith("\n")
    found = [strict(line) for line in text.splitlines()]
    times = [event["time"] for event in found]
    assert times == sorted(times)
    return found


def kinds(found: list[dict[str, Any]]) -> list[str]:
    """Names of the events, each once in a row."""
    all_ = [event["event"] for event in found]
    return [name for k, name in enumerate(all_) if not k or all_[k - 1] != name]


@pytest.mark.slow
def test_a_bake_tells_its_plan_its_frames_and_its_result(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--floor", "none", "--events", "events.ndjson")
    assert done.status == 0
    found = events((here / "events.ndjson").read_text())
    assert kinds(found) == ["started", "plan", "note", "frame", "finished"]
    first, plan, note, *frames, last = found
    assert [note["message"]] == plan["notes"]  # on the long faces of the block
    assert first == {
        "event": "started", "time": first["time"], "asset": str(block), "version": __version__,
        "pid": os.getpid(),
    }  # fmt: skip
    arguments = (*SMALL, "--floor", "none", "--dry-run", "--json")
    shown = strict(gf_usd("bake", block, *arguments).out)
    assert {key: plan[key] for key in plan.keys() - COMMON} == shown
    assert set(plan) >= (REPORT - {"settings", "seconds", "bakes", "check", "warnings"}) | ESTIMATE
    count = plan["particles"]
    assert [(f["done"], f["total"], f["particles"]) for f in frames] == [
        (k, 6, count) for k in range(1, 7)
    ]
    assert set(last) == COMMON | set(RESULT)
    report = strict((here / "block.rubber.report.json").read_text())
    assert last["outputs"] == report["outputs"]
    assert last["bakes"][0]["health"] == report["bakes"][0]["health"]


def test_a_file_with_other_contents_is_not_replaced(gf_usd, here: Path, block: Path) -> None:
    before = block.read_bytes()
    done = gf_usd("bake", block, *SMALL, "--events", block)
    assert done.status == 2
    assert f"{block} exists already and does not hold events" in done.err
    assert (block.read_bytes(), names(here)) == (before, [])
    for _ in range(2):  # earlier events are replaced
        done = gf_usd("bake", block, *SMALL, "--dry-run", "--events", "events.ndjson")
        assert (done.status, kinds(events((here / "events.ndjson").read_text()))[0]) == (
            0,
            "started",
        )


@pytest.mark.slow
def test_the_words_of_a_bake_stay_as_they_are(gf_usd, here: Path, block: Path) -> None:
    plain = gf_usd("bake", block, *SMALL)
    done = gf_usd("bake", block, *SMALL, "--events", "events.ndjson", "--overwrite")
    assert done.err == plain.err
    # but for the seconds
    assert [line.split(" particles,")[0] for line in done.out.splitlines()] == [
        line.split(" particles,")[0] for line in plain.out.splitlines()
    ]


@pytest.mark.slow
def test_on_stdout_there_is_nothing_else(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--events", "-")
    assert kinds(events(done.out))[-1] == "finished"
    assert "frame 6/6" in done.err
    planned = gf_usd("bake", block, *SMALL, "--events", "-", "--dry-run", "-o", "new/")
    assert kinds(events(planned.out))[:2] == ["started", "plan"]
    assert {*kinds(events(planned.out))[2:]} <= {"note"}
    both = gf_usd("bake", block, *SMALL, "--events", "-", "--json", "--overwrite")
    assert (both.status, both.out) == (2, "")
    assert "--json and --events - would both write to stdout" in both.err


def test_a_file_descriptor_takes_them(gf_usd, here: Path, block: Path) -> None:
    reader, writer = os.pipe()
    assert gf_usd("bake", block, *SMALL, "-q", "--events", writer).status == 0
    with open(reader, encoding="utf-8") as lines:  # the bake closed it
        assert kinds(events(lines.read()))[-1] == "finished"
    closed = gf_usd("bake", block, *SMALL, "--events", writer, "--overwrite")
    assert closed.status == 2
    assert f"--events {writer} cannot be opened: Bad file descriptor" in closed.err


@pytest.mark.slow
def test_notes_and_warnings_are_reported(gf_usd, here: Path, tmp_path: Path) -> None:
    path = tmp_path / "duck.usda"
    text = (SAMPLES / "duck.usda").read_text(encoding="utf-8")
    assert "metersPerUnit = 0.01" in text
    path.write_text(text.replace("metersPerUnit = 0.01", ""), encoding="utf-8")
    done = gf_usd("bake", path, *CRUSH, "--events", "-", "--strict")
    assert done.status == 4
    found = events(done.out)
    notes = [event["message"] for event in found if event["event"] == "note"]
    assert notes == found[-2]["notes"]
    assert (
        "metersPerUnit is not authored: 0.01 (centimeters), the default of USD, is assumed" in notes
    )
    warnings = [event for event in found if event["event"] == "warning"]
    assert [{k: w[k] for k in w.keys() - COMMON} for w in warnings] == found[-2]["warnings"]
    assert "inside-out" in [warning["about"] for warning in warnings]
    assert kinds(found)[-2:] == ["finished", "error"]
    assert found[-1]["status"] == 4
    assert found[-1]["hint"].endswith("without --strict this is not an error")


def test_an_error_is_reported_with_its_status_and_hint(gf_usd, here: Path, tmp_path: Path) -> None:
    path = tmp_path / "bad.obj"
    path.write_text("v 0 0 0\nf 1 2 3\n", encoding="utf-8")
    done = gf_usd("bake", path, *SMALL, "--events", "-")
    assert done.status == 3
    first, error = events(done.out)
    assert (first["event"], error["event"], error["status"]) == ("started", "error", 3)
    assert done.err == f"error: {error['message']}\n\nhint: {error['hint']}\n"


def test_the_end_of_a_slice_is_no_error(gf_usd, here: Path, block: Path) -> None:
    arguments = ("bake", block, *SMALL, "-q", "--clip-frames", "2", "--slice", "1", "--resume")
    done = gf_usd(*arguments, "--events", "-")
    assert done.status == 5
    last = events(done.out)[-1]
    assert (last["event"], last["look"], last["frames"]) == ("sliced", "rubber", 6)
    assert f"rubber: {last['done']} of 6 frames are done" in done.err


def test_what_cannot_be_written_is_said_before_the_bake(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--events", "nowhere/events.ndjson")
    assert done.status == 2
    assert "--events nowhere/events.ndjson cannot be opened: No such file or directory" in done.err
    assert names(here) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_ends_the_bake_in_words(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--events", "/dev/full")
    assert done.status == 1
    assert "--events /dev/full: events cannot be written: No space left on device" in done.err
    assert "Traceback" not in done.err


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGTERM")
def test_a_signal_is_reported(here: Path, block: Path) -> None:
    arguments = (
        "--particles", "200", "--frames", "100000", "--drop", "150", "--max-hours", "1000",
        "--clip-frames", "1", "-q", "--events", "events.ndjson",
    )  # fmt: skip
    process = start("bake", block, *arguments)
    wait_for(process, here / "block.rubber.checkpoint.npz")
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 143
    last = events((here / "events.ndjson").read_text())[-1]
    assert (last["event"], last["status"], last["message"]) == ("error", 143, "ended by SIGTERM")
    assert "the same command with --resume continues" in last["hint"]

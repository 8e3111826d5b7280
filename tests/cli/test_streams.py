"""stdout and stderr that are closed or take nothing more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from slow_parameters import longest_but, slow_but
from small_bakes import names

pytestmark = pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="this system has no device that is always full"
)
NO_ROOM = "error: the output cannot be written: No space left on device\n"


def run(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    """A shell's command; GF is gf-usd."""
    gf = f"'{sys.executable}' -m gf_usd"
    return subprocess.run(
        ["sh", "-c", command.replace("GF", gf)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("where", slow_but(["2>&-", "2>/dev/full", "<&- 2>&-"], "<&- 2>&-"))
def test_what_is_said_on_the_way_ends_nothing(here: Path, block: Path, where: str) -> None:
    done = run(here, f"GF bake {block} --particles 100 --dry-run {where}")
    assert done.returncode == 0
    assert "would write block.rubber.usda" in done.stdout
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("where", longest_but(["2>&-", "2>/dev/full", ">&- 2>&-"], ">&- 2>&-"))
def test_a_bake_continues(here: Path, block: Path, where: str) -> None:
    assert run(here, f"GF bake {block} --particles 100 --frames 2 {where}").returncode == 0
    kinds = ("cache.usdc", "report.json", "usda")
    assert set(names(here)) == {f"block.rubber.{kind}" for kind in kinds}


@pytest.mark.slow
def test_a_refusal_keeps_its_status(here: Path) -> None:
    assert run(here, "GF bake nothing.usda 2>/dev/full").returncode == 3


@pytest.mark.parametrize("command", ["materials", "materials --json", "bake --help"])
def test_a_result_that_cannot_be_written_is_an_error(here: Path, command: str) -> None:
    done = run(here, f"GF {command} >/dev/full")
    assert (done.returncode, done.stderr) == (1, NO_ROOM)


def test_a_result_that_nobody_wants_is_none(here: Path) -> None:
    done = run(here, "GF materials >&-")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_reader_that_has_enough_gets_no_traceback(here: Path) -> None:
    done = run(here, "GF materials | true")
    assert done.stderr == ""


# `head` is gone when the jobs begin; of events, the first is out before
@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "status", "message"),
    longest_but([("| head -1", 0, ""), (">/dev/full", 1, NO_ROOM)], (">/dev/full", 1, NO_ROOM)),
)
def test_a_batch_ends_its_work_before_an_error_of_stdout(
    here: Path, block: Path, where: str, status: int, message: str
) -> None:
    few = "--particles 100 --frames 2 -j 1 --material rubber,jelly"
    done = run(here, f"GF batch {block} -o out {few} --json -q {where}")
    assert done.returncode == status
    assert done.stderr.startswith("2 done, ")
    assert done.stderr.endswith(f"out.batch.html\n{message}")
    there = {path.name for path in (here / "out").rglob("*") if path.is_file()}
    assert {"out.batch.html", "out.batch.json"} <= there
    assert {"block.rubber.job.json", "block.jelly.job.json"} <= there

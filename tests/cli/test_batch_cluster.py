"""The same jobs on a dask.distributed cluster, of which a worker dies."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from small_bakes import BLOCK

from gf_usd.layers.check.run import check_file

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed"),
]


@pytest.fixture
def address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def workers(address: str, tmp_path: Path) -> Iterator[list[subprocess.Popen[bytes]]]:
    """A scheduler and two workers, each a process; the workers are yielded."""
    with (tmp_path / "dask.log").open("wb") as log:

        def start(module: str, *words: str) -> subprocess.Popen[bytes]:
            command = [sys.executable, "-m", f"distributed.cli.{module}", "--no-dashboard", *words]
            return subprocess.Popen(command, stdout=log, stderr=log)

        host, port = address.removeprefix("tcp://").split(":")
        running = [start("dask_scheduler", "--host", host, "--port", port)]
        common = (address, "--nthreads", "1", "--no-nanny", "--resources", "seats=1")
        for name in "ab":
            running.append(start("dask_worker", *common, "--local-directory", str(tmp_path / name)))
        yield running[1:]
        for process in reversed(running):
            process.kill()
            process.wait()


def batch(folder: Path, address: str, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "gf_usd", "batch", *words, "--scheduler", address,
               "--resource", "seats=1", "-o", "out", "--json", "-q", "--no-report"]  # fmt: skip
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder)


def test_a_dead_workers_job_is_done_by_another(
    here: Path, block: Path, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    block.with_name("cut.usda").write_text(BLOCK[:500], encoding="utf-8")
    words = ("-m", "rubber", "--seed", "0,1", "--particles", "300", "--frames", "40")
    process = batch(here, address, str(block), str(block.with_name("cut.usda")), *words)
    assert process.stdout is not None
    told: list[dict[str, Any]] = []
    for line in process.stdout:
        told.append(json.loads(line))
        if told[-1]["event"] == "frame" and workers[0].poll() is None:
            workers[0].kill()
            workers[0].wait()
    assert process.wait() == 1
    ends = {e["job"]: e for e in told if e["event"] == "finished"}
    assert {name: e["state"] for name, e in ends.items()} == {
        "block.rubber.seed0": "done", "block.rubber.seed1": "done",
        "cut.rubber.seed0": "refused", "cut.rubber.seed1": "refused",
    }  # fmt: skip
    begun = [e["job"] for e in told if e["event"] == "started" and e["job"].startswith("block")]
    assert len(begun) == 3, "one of the two was begun twice"
    for seed in (0, 1):
        assert check_file(here / "out" / f"block.rubber.seed{seed}.usda").ok
    again = batch(here, address, str(block), *words)
    out, _ = again.communicate(timeout=120)
    assert again.returncode == 0
    assert out.count('"state": "kept"') == 2


def test_sigterm_ends_the_bakes_on_the_workers(
    here: Path, block: Path, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    process = batch(here, address, str(block), "-m", "rubber", "--seed", "0,1,2",
                    "--particles", "3000", "--frames", "3000")  # fmt: skip
    assert process.stdout is not None
    while '"frame"' not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 143
    assert out.count('"state": "stopped"') == 3
    assert all(worker.poll() is None for worker in workers), "the cluster is not ours to end"
    assert not [p for p in (here / "out").glob("*.usda") if ".partial" not in p.name]
    assert not _bakes(here / "out")


def _bakes(folder: Path) -> list[str]:
    """Processes that bake into a folder now."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        except OSError:
            continue
        if "bake" in words and any(word.startswith(str(folder)) for word in words):
            found.append(pid)
    return found

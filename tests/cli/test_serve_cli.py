"""gf-usd serve: the bakes of other programs in warm processes, and what they get."""

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
from small_bakes import Done

from gf_usd.cli.serve import arguments_of, failure
from gf_usd.core.errors import UsageError
from gf_usd.system.warm.client import events
from gf_usd.system.warm.local_socket import AVAILABLE

pytestmark = pytest.mark.skipif(not AVAILABLE, reason="no Unix sockets here")

Call = Callable[..., Done]
SMALL = ("--particles", "150", "--frames", "3")


@pytest.fixture
def path(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path_factory.mktemp("s")
    folder.chmod(0o700)
    monkeypatch.setenv("GF_USD_SOCKET", str(folder / "s"))
    return folder / "s"


@pytest.fixture
def server(path: Path) -> Iterator[subprocess.Popen[str]]:
    """A server that is ended by SIGTERM, and leaves nothing."""
    command = [sys.executable, "-m", "gf_usd", "serve", "--timeout", "100"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert f"is listening at {path}" in process.stderr.readline()
        yield process
        process.send_signal(signal.SIGTERM)
        assert process.stderr.read() == "ended\n"
    assert process.returncode == 0
    assert not list(path.parent.iterdir())


def test_without_a_server_it_is_refused(gf_usd: Call, block: Path, path: Path) -> None:
    done = gf_usd("bake", block, "--serve")
    assert done.status == 2
    assert f"no gf-usd serve is listening at {path}" in done.err
    assert "start one with gf-usd serve" in done.err
    for option in ("--status", "--stop"):
        assert "no gf-usd serve is listening" in gf_usd("serve", option).err
    assert "cannot show a plan" in gf_usd("bake", block, "--serve", "--dry-run").err


@pytest.mark.parametrize(
    ("status", "log", "told"),
    [
        (-signal.SIGKILL, "note: parts\n", "was ended by SIGKILL\n\nhint: the system kills"),
        (-signal.SIGSEGV, "note: parts\n", "was ended by SIGSEGV"),
        (1, "note: parts\nKeyError: 'x'\n", "ended with status 1: KeyError: 'x'"),
        (1, "", "ended with status 1: no output"),
    ],
)
def test_a_bake_that_dies_is_reported_without_its_notes(status: int, log: str, told: str) -> None:
    text = failure({"timed_out": False, "status": status, "log": log}, {})
    assert text.startswith(f"error: the process of the bake {told}")
    assert "note" not in text


def test_a_request_is_a_job_of_a_batch_or_the_arguments_of_a_bake() -> None:
    job = {"asset": "/a.usda", "root": "/b.usda", "options": {"particles": 9, "pins": ["/A"]}}
    arguments = arguments_of(job)
    assert arguments == [
        "bake",
        "/a.usda",
        "--output",
        "/b.usda",
        "--particles",
        "9",
        "--pin",
        "/A",
    ]
    assert arguments_of({"arguments": arguments}) == arguments
    more = {"overwrite": True, "seed": None, "slice": 2}
    assert arguments_of({**job, "options": more})[4:] == ["--overwrite", "--slice", "2"]
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"asset": "/a.usda"}, "a job has no root"),
        ({**job, "options": 3}, "no object of options"),
        ({"arguments": "bake"}, "'bake'"),
        ({"arguments": ["batch", "x"]}, "'batch x' is not a bake"),
        ({**job, "version": "0.0"}, "but its client is 0.0"),
        ({**job, "colour": 1}, "a request has 'colour' next to 'asset'"),
        ({**job, "arguments": arguments}, "a request has 'asset' next to 'arguments'"),
        ({**job, "asset": "a.usda"}, "'asset' is 'a.usda'"),
        ({**job, "root": 3}, "'root' is 3"),
        ({**job, "asset": "/a\0.usda"}, "'asset' is '/a"),
        ({**job, "root": "/\ud800.usda"}, "'root' is '/"),
        ({"arguments": ["bake", "a\0"]}, '"arguments" has'),
        ({**job, "root": "/tmp"}, "'root' is '/tmp', a folder"),
        ({**job, "root": "/nowhere/"}, "'root' is '/nowhere/', a folder"),
        ({**job, "options": {"particle": 3}}, "the request: unknown option 'particle'"),
        ({**job, "options": {"output": "a"}}, "the request: unknown option 'output'"),
        ({**job, "options": {"particles": "300"}}, "the request: particles is '300'"),
        ({**job, "options": {"particles": 0}}, "the request: --particles is 0"),
        ({**job, "options": {"drop": [1]}}, "the request: drop is \\[1\\]"),
        ({**job, "options": {"law": "nope"}}, "nope"),
    )
    for request, message in wrong:
        with pytest.raises(UsageError, match=message):
            arguments_of(request)


@pytest.mark.slow
@pytest.mark.acceptance
def test_served_bakes_equal_single_ones(
    gf_usd: Call, here: Path, block: Path, path: Path, server: object
) -> None:
    for material in ("rubber", "clay"):
        arguments = ("bake", block, "--material", material, *SMALL)
        alone = gf_usd(*arguments, "-o", here / "alone" / f"{material}.usda", "--json")
        # a path that is relative to where the client is
        served = gf_usd(*arguments, "-o", f"served/{material}.usda", "--serve", "--json")
        assert (alone.status, served.status) == (0, 0), served.err
        assert json.loads(served.out).keys() == json.loads(alone.out).keys()
        for name in (f"{material}.usda", f"{material}.cache.usdc"):
            one, other = here / "alone" / name, here / "served" / name
            assert one.read_bytes() == other.read_bytes(), name
    refused = gf_usd("bake", block, "--material", "ruber", "--serve")
    assert refused.status == 2
    assert refused.err.startswith("error: there is no material 'ruber'\n\nhint: did you mean")
    again = gf_usd("bake", block, "--material", "clay", *SMALL, "-o", "served/clay.usda", "--serve")
    assert again.status == 2, "the results are there already"
    # a process that is killed in the middle, and the server bakes on
    job = {"asset": str(block), "root": str(here / "c.usda"), "options": {"frames": 400}}
    running = events(path, job)
    started = next(running)
    assert next(event for event in running if event["event"] == "frame")["total"] == 400
    os.kill(started["pid"], signal.SIGKILL)
    assert list(running)[-1]["status"] == -signal.SIGKILL
    job["options"] = {"frames": 3, "particles": 150, "overwrite": True}
    lines = list(events(path, job))
    assert [lines[0]["event"], lines[-2]["event"], lines[-1]["status"]] == [
        "started",
        "finished",
        0,
    ]
    assert not list(here.glob("*.partial.*"))
    status = json.loads(gf_usd("serve", "--status").out)
    assert (status["done"], status["running"]) == (6, 0)

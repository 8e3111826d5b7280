"""Runs of ``gf-usd batch`` for the acceptance, with injected failures."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ("deformed_sphere.usda", "duck.usda", "sphere.usda")
DIMENSIONLESS = ("rubber", "metal", "jelly")
CORRUPT = "corrupt.usda"
PATIENCE = 60.0  # [s] for something that should happen soon

Event = dict[str, Any]
Disturb = Callable[["Run", Event], None]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """Something that must hold, and what was found."""

    engine: str
    claim: str
    found: str
    holds: bool


class Claims:
    """Collects what holds and what does not."""

    def __init__(self, engine: str) -> None:
        self._engine = engine
        self.all: list[Claim] = []

    def __call__(self, claim: str, found: object, holds: bool) -> None:
        """Note a claim and say it."""
        self.all.append(Claim(engine=self._engine, claim=claim, found=str(found), holds=holds))
        print(f"  {'ok' if holds else 'NOT'}: {claim}: {found}", file=sys.stderr, flush=True)


def figure(seconds: float | None) -> str:
    """A time as a table shows it."""
    return "never" if seconds is None else f"{seconds:.1f}"


@dataclass
class Run:
    """One run of the command, with every event it reported."""

    process: subprocess.Popen[str]
    events: list[Event] = field(default_factory=list)
    done: dict[str, Any] = field(default_factory=dict)  # whatever `disturb` records

    def ended(self, *states: str) -> list[Event]:
        """The events of jobs that ended in one of these states, or in any."""
        finished = [e for e in self.events if e["event"] == "finished"]
        return [e for e in finished if not states or e["state"] in states]

    @property
    def begun(self) -> Counter[str]:
        """How often each job was begun."""
        return Counter(e["job"] for e in self.events if e["event"] == "started")

    @property
    def counts(self) -> dict[str, int]:
        """How many jobs ended in each state."""
        return dict(Counter(e["state"] for e in self.ended()))


def run(arguments: Sequence[object], disturb: Disturb = lambda run, event: None) -> Run:
    """Run ``gf-usd batch --json`` to its end; `disturb` gets each event and may do harm."""
    command = [sys.executable, "-m", "gf_usd", "batch", *map(str, arguments), "--json", "-q"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stdout is not None
    found = Run(process)
    for line in process.stdout:
        with contextlib.suppress(ValueError):  # a line that a kill cut short
            event = json.loads(line)
            found.events.append(event)
            disturb(found, event)
    process.wait()
    return found


def manifest(folder: Path, seeds: int, corrupt: int) -> Path:
    """A manifest of samples x presets x seeds, and jobs of an asset that is damaged."""
    whole = (ROOT / "samples" / "duck.usda").read_bytes()
    (folder / CORRUPT).write_bytes(whole[: len(whole) // 2])
    files = ", ".join(f'"{ROOT / "samples" / name}"' for name in SAMPLES)
    presets = ", ".join(f'"{one}"' for one in DIMENSIONLESS)
    path = folder / "night.toml"
    path.write_text(
        f"[settings]\nparticles = 120\nframes = 4\n\n"
        f"[[assets]]\nfiles = [{files}]\n"
        f"matrix = {{ material = [{presets}], seed = {list(range(seeds))} }}\n\n"
        f'[[assets]]\nfiles = ["{CORRUPT}"]\nmatrix = {{ seed = {list(range(corrupt))} }}\n',
        encoding="utf-8",
    )
    return path


def bakes_in(folder: Path) -> list[int]:
    """Workers that a batch into a folder started, and those that were left behind by theirs."""
    commands, parents = {}, {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            commands[int(entry.name)] = (entry / "cmdline").read_bytes().split(b"\0")
            status = (entry / "status").read_text()
        except OSError:
            continue
        parents[int(entry.name)] = int(status.partition("PPid:")[2].split()[0])
    near = str(folder.parent).encode()
    batches = {pid for pid, command in commands.items() if any(w.startswith(near) for w in command)}
    found = []
    for pid, command in commands.items():
        if b"gf_usd" not in command or b"worker" not in command:
            continue
        above = pid
        while above > 1 and above not in batches:
            above = parents.get(above, 1)
        if above in batches or parents[pid] == 1:
            found.append(pid)
    return found


def kill_a_bake(folder: Path) -> bool:
    """SIGKILL to one of the workers of a batch into a folder; whether there was one."""
    for pid in bakes_in(folder):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
            return True
    return False


def none_left(folder: Path) -> float | None:
    """[s] until no process bakes into a folder any more; None if that takes too long."""
    began = time.monotonic()
    while bakes_in(folder):
        if time.monotonic() - began > PATIENCE:
            return None
        time.sleep(0.1)
    return time.monotonic() - began


def broken(folder: Path) -> list[str]:
    """What ``check`` finds in the root layers under final names, and files cut short."""
    from gf_usd.layers.check.run import check_file

    faults = []
    for root in sorted(folder.glob("*.usda")):
        if ".partial" in root.name:
            continue
        result = check_file(root)
        faults += [f"{root.name}: {f.rule}" for f in result.findings if f.severity == "error"]
    return faults


def results(folder: Path) -> list[str]:
    """Root layers under final names."""
    return sorted(p.stem for p in folder.glob("*.usda") if ".partial" not in p.name)


@contextlib.contextmanager
def tmpfs(folder: Path, size: str) -> Iterator[Callable[[str], None]]:
    """A small file system in memory at a folder; yields what makes it larger.

    Raises SystemExit where this user may not mount one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise SystemExit(
            f"no tmpfs could be mounted at {folder}: {error}; run the section batch as root"
        ) from error
    try:
        yield lambda more: _remount(folder, more)
    finally:
        subprocess.run(["umount", folder], check=True)


def _remount(folder: Path, size: str) -> None:
    subprocess.run(["mount", "-o", f"remount,size={size}", folder], check=True)


@contextlib.contextmanager
def cluster(folder: Path, port: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """A Dask scheduler and two workers, each a process; yields the workers."""
    log = (folder / "dask.log").open("wb")
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker"]
    common = ["--no-dashboard"]

    def start(command: list[str]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)

    programs = [start([*dask, "--host", "127.0.0.1", "--port", str(port), *common])]
    for number in range(2):
        place = ["--local-directory", str(folder / f"worker{number}")]
        arguments = [address, "--nthreads", "1", "--no-nanny", *place, *common]
        programs.append(start([*worker, *arguments]))
    try:
        yield programs[1:]
    finally:
        for program in reversed(programs):
            program.terminate()
        for program in programs:
            try:
                program.wait(20.0)
            except subprocess.TimeoutExpired:
                program.kill()
        log.close()


def later(seconds: float, action: Callable[[], None]) -> None:
    """Do something in a while."""
    timer = threading.Timer(seconds, action)
    timer.daemon = True
    timer.start()

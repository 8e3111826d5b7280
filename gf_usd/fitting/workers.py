"""Simulations in a few processes at once, each of which is kept on the disk.

Taichi runs once in a process, and a solver of few particles uses one core.  The name of a file is
the hash of all that its simulation depends on: what was simulated before is read.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import queue
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from gf_usd.core import errors
from gf_usd.core.errors import BakeError, UsageError
from gf_usd.fitting.observation import Followed, Observation, Scene, load
from gf_usd.fitting.search import OutOfTime
from gf_usd.system import exchange
from gf_usd.system.processes import Process
from gf_usd.system.sandbox import Scratch
from gf_usd.system.warm.workers import AVAILABLE, receive, send

START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from gf_usd.fitting.evaluate import serve; serve(sys.argv[2])"
)
FORM = 1  # of what is kept of a simulation
LAST = 2000  # characters of what a process said before it ended


class Worker(Process):
    """A process of `evaluate.serve`; words : file for what it says."""

    def __init__(self, words: Path) -> None:
        self._words = words
        self._end, other = socket.socketpair()
        with other, words.open("wb") as err:
            number = other.fileno()
            command = [sys.executable, "-P", "-c", START, json.dumps(sys.path), str(number)]
            super().__init__(command, inherit=[number], err=err.fileno(), grace=0)
        self._ended = False

    def ask(self, request: dict[str, Any]) -> bool:
        """Have it do something; False where a simulation failed.  Raises what it raised."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            send(self._end, request)
        answer = receive(self._end)
        if answer is None:
            self._ended = True
            self.reap()  # it has said all then
            self._end.close()
            said = self._words.read_text("utf-8", "replace")[-LAST:].strip().splitlines()
            raise BakeError(
                f"a simulation process ended: {(said or ['it printed nothing'])[-1]}",
                "run gf-usd bake with the same options to see all of its output",
            )
        error = answer[0]["error"]
        if error is not None and not answer[0]["failed"]:
            kind, message, hint, more = error
            raise getattr(errors, kind)(message, hint, **more)
        return error is None

    def close(self) -> None:
        """End it, whatever it does."""
        if not self._ended:
            self._ended = True
            self.stop()
            self.reap()
            self._end.close()


class Simulations:
    """Simulations of one asset, several at once; see `simulations`.

    simulated : how many were run, the failed ones included; read : that were there already.
    """

    def __init__(self, workers: Sequence[Worker], scratch: Path, folder: Path) -> None:
        self._workers, self._scratch, self._folder = workers, scratch, folder
        self._idle: queue.Queue[Worker] = queue.Queue()
        for worker in workers:
            self._idle.put(worker)
        self._key = ""
        self._lock = threading.Lock()
        self.deadline = float("inf")  # by time.monotonic
        self.simulated = self.read = 0

    def prepare(
        self, asset: Path, options: Mapping[str, Any], followed: Sequence[Followed] = ()
    ) -> Scene:
        """Read and fill the asset in each process.  Raises as preparing a bake does."""
        request = self._scratch / "request"
        with request.open("wb") as file:
            told = {"asset": asset, "options": dict(options), "followed": list(followed)}
            exchange.write(told, file)

        def one(number: int, worker: Worker) -> bytes:
            reply = self._scratch / f"scene{number}"
            worker.ask({"task": "prepare", "file": str(request), "reply": str(reply)})
            return reply.read_bytes()

        with ThreadPoolExecutor(len(self._workers)) as threads:
            answers = list(threads.map(one, range(len(self._workers)), self._workers))
        scene: Scene = exchange.read(answers[0])
        seen = hashlib.sha256(f"{FORM}{scene.identity}".encode())
        for one_followed in followed:
            seen.update(one_followed.path.encode())
            seen.update(one_followed.vertices.tobytes() + one_followed.weights.tobytes())
        self._key = seen.hexdigest()
        return scene

    def run(
        self, values: Sequence[Mapping[str, float]], *, late: bool = False
    ) -> list[Observation | None]:
        """Simulate with each of these values [SI]; None where the solver could not go on.

        Raises OutOfTime where the deadline has passed, unless it is late, and BakeError where a
        process crashed.
        """
        one = partial(self._one, late=late)
        with ThreadPoolExecutor(len(self._workers)) as threads:
            return list(threads.map(one, values))

    def _one(self, values: Mapping[str, float], *, late: bool) -> Observation | None:
        told = {name: float(value) for name, value in values.items()}
        words = json.dumps([self._key, {name: value.hex() for name, value in told.items()}])
        kept = self._folder / f"{hashlib.sha256(words.encode()).hexdigest()[:32]}.run"
        with contextlib.suppress(OSError, ValueError):
            found = load(kept)
            with self._lock:
                self.read += 1
            return found
        if time.monotonic() > self.deadline and not late:
            raise OutOfTime
        worker = self._idle.get()
        try:
            good = worker.ask({"task": "run", "values": told, "reply": str(kept)})
        finally:
            self._idle.put(worker)
        with self._lock:
            self.simulated += 1
        return load(kept) if good else None


@contextlib.contextmanager
def simulations(processes: int, folder: Path | None) -> Iterator[Simulations]:
    """Processes for simulations, for a block.

    folder : where simulations are kept; None: nowhere after the block.

    Raises UsageError where the system has no such processes, or the folder cannot be made.
    """
    if not AVAILABLE:
        raise UsageError(
            f"gf-usd fit needs processes with sockets, which {os.name} does not support",
            "run it on Linux or macOS; the material that it writes can be baked anywhere",
        )
    scratch = Scratch()
    workers: list[Worker] = []
    try:
        kept = folder or scratch.path / "kept"
        try:
            kept.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(
                f"the folder {kept} for simulations cannot be made: {error.strerror}",
                "give another: --evaluations FOLDER, or --evaluations none",
            ) from error
        for number in range(processes):
            workers.append(Worker(scratch.path / f"words{number}"))
        yield Simulations(workers, scratch.path, kept)
    finally:
        for worker in workers:
            worker.close()
        scratch.remove()

"""Parallel simulations in worker processes, with a cache of their results on disk.

There is one Taichi runtime per process, and a solver with few particles uses one core; hence
several processes.  The file name of a cached result is a hash of all inputs of its simulation.
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
from gf_usd.fitting.observation import Observation, Scene, TrackedPoints, load
from gf_usd.fitting.search import OutOfTime
from gf_usd.system import exchange
from gf_usd.system.processes import Process
from gf_usd.system.sandbox import Scratch
from gf_usd.system.warm.workers import AVAILABLE, receive, send

START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from gf_usd.fitting.evaluate import serve; serve(sys.argv[2])"
)
CACHE_FORMAT = 1  # version of the cached data
MAX_OUTPUT = 2000  # [characters] of stderr in the error message of a crash


class Worker(Process):
    """A process that runs `evaluate.serve`.

    log : file for its stderr.
    """

    def __init__(self, log: Path) -> None:
        self._log = log
        self._end, other = socket.socketpair()
        with other, log.open("wb") as err:
            descriptor = other.fileno()
            command = [sys.executable, "-P", "-c", START, json.dumps(sys.path), str(descriptor)]
            super().__init__(command, inherit=[descriptor], err=err.fileno(), grace=0)
        self._ended = False

    def send_request(self, request: dict[str, Any]) -> bool:
        """Send a request and wait for the answer; False where a simulation failed.

        Raises the error that the process reports, and BakeError where it crashed.
        """
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            send(self._end, request)
        answer = receive(self._end)
        if answer is None:
            self._ended = True
            self.reap()  # waits for the rest of its output
            self._end.close()
            output = self._log.read_text("utf-8", "replace")[-MAX_OUTPUT:].strip().splitlines()
            raise BakeError(
                f"a simulation process ended: {(output or ['it printed nothing'])[-1]}",
                "run gf-usd bake with the same options to see all of its output",
            )
        error = answer[0]["error"]
        if error is not None and not answer[0]["failed"]:
            kind, message, hint, details = error
            raise getattr(errors, kind)(message, hint, **details)
        return error is None

    def close(self) -> None:
        """Stop the process."""
        if not self._ended:
            self._ended = True
            self.stop()
            self.reap()
            self._end.close()


class Simulations:
    """Simulations of one asset, several at once; see `simulations`.

    simulated : number of simulations that were run, including failed ones; read : from the cache.
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
        self, asset: Path, options: Mapping[str, Any], tracked: Sequence[TrackedPoints] = ()
    ) -> Scene:
        """Read and sample the asset in each process.  Raises the errors of preparing a bake."""
        request = self._scratch / "request"
        with request.open("wb") as file:
            payload = {"asset": asset, "options": dict(options), "followed": list(tracked)}
            exchange.write(payload, file)

        def prepare_worker(index: int, worker: Worker) -> bytes:
            reply = self._scratch / f"scene{index}"
            worker.send_request({"task": "prepare", "file": str(request), "reply": str(reply)})
            return reply.read_bytes()

        with ThreadPoolExecutor(len(self._workers)) as threads:
            answers = list(threads.map(prepare_worker, range(len(self._workers)), self._workers))
        scene: Scene = exchange.read(answers[0])
        digest = hashlib.sha256(f"{CACHE_FORMAT}{scene.identity}".encode())
        for points in tracked:
            digest.update(points.path.encode())
            digest.update(points.vertices.tobytes() + points.weights.tobytes())
        self._key = digest.hexdigest()
        return scene

    def run(
        self, values: Sequence[Mapping[str, float]], *, late: bool = False
    ) -> list[Observation | None]:
        """Simulate with each of these values [SI]; None where the solver failed.

        Raises OutOfTime after the deadline, unless `late` is set, and BakeError where a process
        crashed.
        """
        simulate = partial(self._simulate, late=late)
        with ThreadPoolExecutor(len(self._workers)) as threads:
            return list(threads.map(simulate, values))

    def _simulate(self, values: Mapping[str, float], *, late: bool) -> Observation | None:
        values_by_name = {name: float(value) for name, value in values.items()}
        hexadecimal = {name: value.hex() for name, value in values_by_name.items()}
        key = json.dumps([self._key, hexadecimal])
        cache_file = self._folder / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.run"
        with contextlib.suppress(OSError, ValueError):
            cached = load(cache_file)
            with self._lock:
                self.read += 1
            return cached
        if time.monotonic() > self.deadline and not late:
            raise OutOfTime
        worker = self._idle.get()
        try:
            succeeded = worker.send_request(
                {"task": "run", "values": values_by_name, "reply": str(cache_file)}
            )
        finally:
            self._idle.put(worker)
        with self._lock:
            self.simulated += 1
        return load(cache_file) if succeeded else None


@contextlib.contextmanager
def simulations(processes: int, folder: Path | None) -> Iterator[Simulations]:
    """Context manager of worker processes.

    folder : of the cache; None: a temporary folder.

    Raises UsageError where the system has no sockets between processes, or the folder cannot be
    created.
    """
    if not AVAILABLE:
        raise UsageError(
            f"gf-usd fit needs processes with sockets, which {os.name} does not support",
            "run it on Linux or macOS; the material that it writes can be baked anywhere",
        )
    scratch = Scratch()
    workers: list[Worker] = []
    try:
        cache_folder = folder or scratch.path / "kept"
        try:
            cache_folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(
                f"the folder {cache_folder} for simulations cannot be made: {error.strerror}",
                "give another: --evaluations FOLDER, or --evaluations none",
            ) from error
        for index in range(processes):
            workers.append(Worker(scratch.path / f"task{index}"))
        yield Simulations(workers, scratch.path, cache_folder)
    finally:
        for worker in workers:
            worker.close()
        scratch.remove()

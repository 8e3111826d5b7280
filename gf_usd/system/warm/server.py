"""The server of ``gf-usd serve``: commands from a local socket, run in warm processes.

A client sends one line of JSON and receives lines of JSON until the connection ends; docs/farm.md
lists them.  A command ends with its connection.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gf_usd.core import __version__
from gf_usd.core.errors import GfUsdError, UsageError
from gf_usd.system.processes import Children, ProcessResult
from gf_usd.system.warm.local_socket import is_same_user
from gf_usd.system.warm.workers import Worker, Workers, listening

LONGEST = 1 << 20  # bytes of a request
PATIENCE = 10.0  # [s] for the whole request to arrive
TICK = 0.25  # [s] between checks of the time

QUESTIONS = ("status", "stop")
ENDED, SERVER = "ended", "server"  # events of the server itself

Arguments = Callable[[dict[str, Any]], list[str]]  # from a request to the arguments of gf-usd


class Server:
    """Runs the commands of clients.

    Parameters
    ----------
    arguments_of : the arguments of a request; raises GfUsdError for an invalid one.
    at_once : number of concurrent commands; others wait.
    timeout : [s] after which a command without its own limit is ended; None: never.
    idle : [s] without a command after which `run` returns; None: never.
    workers : the warm processes, ended by `children`.
    """

    def __init__(
        self,
        arguments_of: Arguments,
        workers: Workers,
        children: Children,
        *,
        at_once: int = 1,
        timeout: float | None = None,
        idle: float | None = None,
    ) -> None:
        self._arguments_of, self._workers, self._children = arguments_of, workers, children
        self._timeout, self._idle = timeout, idle
        self._at_once = at_once
        self._turns = threading.Semaphore(at_once)
        self._lock = threading.Lock()
        self._clients: set[threading.Thread] = set()
        self._commands = 0  # running or waiting commands
        self._done = 0
        self._last = time.monotonic()  # when a command ended, or the server began
        self._wake, self._woken = socket.socketpair()

    def stop(self) -> None:
        """End the running commands and `run`; can be called by a signal handler."""
        with contextlib.suppress(OSError):  # it is ending already
            self._wake.send(b".")

    def run(self, end: socket.socket) -> None:
        """Serve the clients of a listening socket until `stop` is called or the server is idle."""
        with self._wake, self._woken:
            while True:
                ready, _, _ = select.select([end, self._woken], [], [], TICK)
                if self._woken in ready or self._is_idle():
                    break
                if end in ready:
                    client, _ = end.accept()
                    thread = threading.Thread(target=self._serve, args=(client,), daemon=True)
                    with self._lock:
                        self._clients.add(thread)
                    thread.start()
            end.close()
            self._children.stop()
            with self._lock:
                clients = list(self._clients)
            for thread in clients:
                thread.join()

    def _is_idle(self) -> bool:
        with self._lock:
            if self._idle is None or self._commands:
                return False
            return time.monotonic() - self._last > self._idle

    def _serve(self, client: socket.socket) -> None:
        with client:
            send = _Events(client)
            if is_same_user(client):
                self._answer(client, send)
            else:
                send("error", status=2, message="this server belongs to another user", hint="")
        with self._lock:
            self._clients.discard(threading.current_thread())

    def _answer(self, client: socket.socket, send: _Events) -> None:
        try:
            request = _request(client)
            if "ask" in request:
                self._tell(_question(request), send)
                return
            arguments, folder = self._arguments_of(request), _folder(request)
            timeout = _timeout(request, self._timeout)
        except GfUsdError as error:
            send("error", status=error.exit_status, message=error.message, hint=error.hint)
            send(ENDED, status=error.exit_status, seconds=0.0, cpu_seconds=0.0, peak_memory=0,
                timed_out=False, log="")  # fmt: skip
            return
        with self._lock:
            self._commands += 1
        try:
            ended = self._run(client, send, arguments, folder, timeout)
        finally:
            with self._lock:
                self._commands -= 1
                self._done += 1
                self._last = time.monotonic()
        status = None if ended is None else ended.status
        send(
            ENDED, status=143 if status is None else status,
            seconds=round(ended.seconds, 3) if ended else 0.0,
            cpu_seconds=round(ended.cpu_seconds, 3) if ended else 0.0,
            peak_memory=ended.peak_memory if ended else 0,
            timed_out=bool(ended and ended.timed_out), log=ended.err if ended and status else "",
        )  # fmt: skip

    def _tell(self, what: str, send: _Events) -> None:
        """Answer a request to the server itself."""
        with self._lock:
            send(SERVER, pid=os.getpid(), version=__version__, at_once=self._at_once,
                running=self._commands, done=self._done)  # fmt: skip
        if what == "stop":
            self.stop()

    def _run(
        self,
        client: socket.socket,
        send: _Events,
        arguments: list[str],
        folder: str,
        timeout: float | None,
    ) -> ProcessResult | None:
        """Run a command; it is stopped when its client disconnects."""
        over = threading.Event()
        running: list[Worker] = []

        def follow() -> None:
            """Stop the command when the connection ends."""
            while not over.wait(0.0):
                if select.select([client], [], [], TICK)[0] and not _is_open(client):
                    for worker in running:
                        worker.stop()
                    return

        watcher = threading.Thread(target=follow, daemon=True)
        watcher.start()
        try:
            while not self._turns.acquire(timeout=TICK):
                if self._children.stopping or not watcher.is_alive():
                    return None
            try:
                if not watcher.is_alive():
                    return None
                with listening(send.line) as events:
                    return self._workers.run(
                        arguments, events=events, timeout=timeout, folder=folder,
                        started=running.append,
                    )  # fmt: skip
            finally:
                self._turns.release()
        finally:
            over.set()
            watcher.join()


class _Events:
    """Sends events to a client until its connection ends."""

    def __init__(self, client: socket.socket) -> None:
        self._client = client

    def __call__(self, event: str, **values: object) -> None:
        self.line(json.dumps({"event": event, "time": round(time.time(), 3), **values}) + "\n")

    def line(self, line: str) -> None:
        """Send a line that is JSON already."""
        with contextlib.suppress(OSError):  # the client is gone, which `_run` detects
            self._client.sendall(line.encode())


def _request(client: socket.socket) -> dict[str, Any]:
    """The line that a client sends.  Raises UsageError where it is no JSON object."""
    client.settimeout(PATIENCE)
    line = b""
    try:
        while not line.endswith(b"\n") and len(line) <= LONGEST:
            more = client.recv(1 << 16)
            if not more:
                break
            line += more
    except OSError:
        line = b""
    client.settimeout(None)
    try:
        request = json.loads(line)
    except (ValueError, RecursionError):  # of the syntax, of UTF-8, or lists in lists in lists
        request = None
    if not line.endswith(b"\n") or not isinstance(request, dict):
        raise UsageError(
            f"a request is one line with a JSON object of at most {LONGEST} bytes, but this is "
            f"not one: {line[:80]!r}",
            "docs/farm.md shows requests",
        )
    return request


def _question(request: dict[str, Any]) -> str:
    """A request to the server itself.  Raises UsageError for an unknown one."""
    what = request["ask"]
    if len(request) > 1 or what not in QUESTIONS:
        raise UsageError(
            f"a request asks {what!r}" + (" and has other keys" if len(request) > 1 else ""),
            f'give "ask" alone, with one of {", ".join(map(repr, QUESTIONS))}',
        )
    return what


def _timeout(request: dict[str, Any], default: float | None) -> float | None:
    """[s] time limit of a request.  Raises UsageError unless it is a number above 0."""
    seconds = request.get("timeout", default)
    if seconds is None:
        return None
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds > 0.0:
        raise UsageError(f'"timeout" is {seconds!r}', "give seconds, or leave it out")
    return float(seconds)


def _folder(request: dict[str, Any]) -> str:
    """The working directory of a request.  Raises UsageError where it is not a folder."""
    folder = Path(str(request.get("folder") or Path.cwd()))
    if not folder.is_absolute() or not folder.is_dir():
        raise UsageError(
            f"{folder} is not the absolute path of a folder",
            'set "folder" to the absolute path of a folder',
        )
    return str(folder)


def _is_open(client: socket.socket) -> bool:
    """Whether the client is still connected; called when there is something to read."""
    try:
        return bool(client.recv(1 << 16))  # no client sends anything more
    except OSError:
        return False

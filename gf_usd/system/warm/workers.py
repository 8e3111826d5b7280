"""Warm processes: each runs one command of gf-usd after another.

Imports, kernels and caches stay loaded between commands, which saves most of the time of a small
bake.  A worker is a process in its own session: a command that hangs, crashes or uses too much
memory ends its worker, and the next command gets a new one.

A request and its reply are a length (4 bytes, network order) and a JSON text of that length, over a
socket.  A request carries file descriptors: stderr, that of the events, and those of locks.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from gf_usd.system.processes import Children, Process, ProcessResult, tail_of

LENGTH = struct.Struct("!I")
MOST = 16  # descriptors of a request
AVAILABLE = os.name == "posix"
WORKER = (sys.executable, "-m", "gf_usd", "worker")


def send(end: socket.socket, message: dict[str, Any], descriptors: Sequence[int] = ()) -> None:
    """Send a message with file descriptors."""
    body = json.dumps(message).encode()
    socket.send_fds(end, [LENGTH.pack(len(body))], list(descriptors))
    end.sendall(body)


def receive(end: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """The next message and its descriptors; None where the other end is closed."""
    try:
        head, descriptors, _, _ = socket.recv_fds(end, LENGTH.size, MOST)
        head += _exactly(end, LENGTH.size - len(head)) if head else b""
        body = _exactly(end, LENGTH.unpack(head)[0]) if len(head) == LENGTH.size else b""
    except ConnectionResetError:
        return None
    for descriptor in descriptors:
        os.set_inheritable(descriptor, False)
    return (json.loads(body), descriptors) if body else None


def _exactly(end: socket.socket, count: int) -> bytes:
    """`count` bytes, or fewer where the other end is closed."""
    out = b""
    while len(out) < count and (more := end.recv(count - len(out))):
        out += more
    return out


class Worker(Process):
    """One warm process.

    Parameters
    ----------
    command : the command line that starts it, without the number of its socket.
    err : stderr until its first request.
    """

    def __init__(self, command: Sequence[str], err: int) -> None:
        self._end, other = socket.socketpair()
        with other:
            number = other.fileno()
            super().__init__([*command, str(number)], inherit=[number], err=err)
        self._cpu_seconds = 0.0  # of earlier commands
        self.spent = False  # it has ended, or gets no more commands

    def run(
        self,
        request: dict[str, Any],
        descriptors: Sequence[int],
        stderr: tuple[int, int],
        timeout: float | None,
    ) -> ProcessResult:
        """Run one command to its end. stderr : a pipe, both ends of which are closed at the end."""
        began = time.monotonic()
        reader, writer = stderr
        with self._timed(timeout):
            # if the worker has ended, its missing reply shows that
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                send(self._end, request, [writer, *descriptors])
            os.close(writer)
            with os.fdopen(reader, "rb") as lines:
                tail = tail_of(lines, lambda line: None)
            answer = receive(self._end)
        if answer is not None and not answer[0]["last"]:
            reply = answer[0]
            status, cpu_seconds, memory = reply["status"], reply["cpu_seconds"], reply["memory"]
            self._cpu_seconds += cpu_seconds
        else:
            self.spent = True
            status, cpu_seconds, memory = self.reap()
            cpu_seconds -= self._cpu_seconds
            status = status if answer is None else answer[0]["status"]
            self._end.close()
        return ProcessResult(
            status=status, out="", err=tail, seconds=time.monotonic() - began,
            cpu_seconds=cpu_seconds, peak_memory=memory, timed_out=self._timed_out,
            stopped=self._stopped and not self._timed_out,
        )  # fmt: skip

    def close(self) -> None:
        """End the process, and wait for it."""
        if not self.spent:
            self.spent = True
            self._end.close()
            self.reap()


class Workers:
    """As many warm workers as concurrent commands.

    Parameters
    ----------
    children : its `stop` ends the workers that run a command.
    command : the command line of a worker, which calls `cli.worker.follow`.
    """

    def __init__(self, children: Children, command: Sequence[str] = WORKER) -> None:
        self._children, self._command = children, command
        self._idle: list[Worker] = []
        self._lock = threading.Lock()

    def run(
        self,
        arguments: Sequence[str],
        *,
        events: int,
        timeout: float | None = None,
        inherit: Sequence[int] = (),
        folder: str | None = None,
        started: Callable[[Worker], None] = lambda worker: None,
    ) -> ProcessResult | None:
        """Run ``gf-usd`` with these arguments; None where `stop` was called before.

        events : file descriptor to which it writes its events (`--events`).
        inherit : descriptors of locks that it holds while it runs.
        folder : its working directory; None: that of this process.
        started : called with the process before the command begins.
        """
        stderr = os.pipe()

        def start() -> Worker:
            with self._lock:
                worker = self._idle.pop() if self._idle else None
            return worker or Worker(self._command, err=stderr[1])

        with self._children.running(start) as worker:
            if worker is None:
                for descriptor in stderr:
                    os.close(descriptor)
                return None
            started(worker)
            request = {"arguments": list(arguments), "folder": folder or os.getcwd()}
            ended = worker.run(request, [events, *inherit], stderr, timeout)
        if not worker.spent:
            with self._lock:
                self._idle.append(worker)
        return ended

    def start_one(self) -> None:
        """Start a process in advance of a command."""
        with open(os.devnull, "wb") as quiet:
            worker = Worker(self._command, err=quiet.fileno())
        with self._lock:
            self._idle.append(worker)

    def close(self) -> None:
        """End the workers, none of which may run a command."""
        with self._lock:
            idle, self._idle = self._idle, []
        for worker in idle:
            worker.close()


class Commands:
    """Runs commands of gf-usd, each in a new process or in a warm one.

    Parameters
    ----------
    children : its `stop` ends the running commands and prevents the others from starting.
    workers : the warm processes; None: each command has a new process.
    """

    def __init__(self, children: Children, workers: Workers | None = None) -> None:
        self._children, self._workers = children, workers
        self.pause = children.pause

    @property
    def stopping(self) -> bool:
        """Whether no more commands may be started."""
        return self._children.stopping

    def run(
        self,
        arguments: Sequence[str],
        *,
        events: int,
        timeout: float | None = None,
        inherit: Sequence[int] = (),
    ) -> ProcessResult | None:
        """Run ``gf-usd`` with these arguments; see `Workers.run`."""
        if self._workers is not None:
            return self._workers.run(arguments, events=events, timeout=timeout, inherit=inherit)
        return self._children.run(
            [sys.executable, "-m", "gf_usd", *arguments, "--events", str(events)],
            lambda line: None, timeout=timeout, inherit=[*inherit, events],
        )  # fmt: skip


@contextlib.contextmanager
def commands(children: Children, *, warm: bool) -> Iterator[Commands]:
    """`Commands` within a block, with warm processes where requested and supported."""
    if not warm or not AVAILABLE:
        yield Commands(children)
        return
    workers = Workers(children)
    try:
        yield Commands(children, workers)
    finally:
        workers.close()


@contextlib.contextmanager
def listening(on_line: Callable[[str], None]) -> Iterator[int]:
    """A file descriptor for the events of a process; all of them are handled before the block ends.

    on_line : called with each complete line, in a thread; a line that a crash cut short is ignored.
    """
    reader, writer = os.pipe()

    def listen() -> None:
        with open(reader, encoding="utf-8", errors="replace") as lines:
            for line in lines:
                if line.endswith("\n"):
                    on_line(line)

    thread = threading.Thread(target=listen, name="gf-usd events", daemon=True)
    thread.start()
    try:
        yield writer
    finally:
        os.close(writer)
        thread.join()

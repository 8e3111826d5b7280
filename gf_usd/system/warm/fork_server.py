"""Children that read files, forked from a process that has loaded their modules.

The process has one thread and opens no file, so that a fork inherits no held lock and no file.
Without it, each child would load Python, NumPy and USD for every file.

For many files it is a separate process, a `ForkServer`.  A command that reads one file forks the
child itself, before it has threads or files: `fork_ahead`.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib
import json
import os
import resource
import select
import signal
import socket
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from gf_usd.system import sandbox
from gf_usd.system.processes import (
    PARENT,
    Process,
    ProcessResult,
    Running,
    SessionProcess,
    peak_memory,
)
from gf_usd.system.warm.workers import receive, send

AVAILABLE = hasattr(os, "pidfd_open") and Path("/proc/self/task").is_dir()  # Linux
# without threads of libraries, which a fork does not have
ALONE = ("PXR_WORK_THREAD_LIMIT", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
START = (
    f"import json, os, sys; os.environ.update(dict.fromkeys({ALONE}, '1'));"
    " sys.path[:] = json.loads(sys.argv[1]);"
    " from gf_usd.system.warm.fork_server import run; run(int(sys.argv[2]), sys.argv[3:])"
)


class ForkServer:
    """The forking process, which ends with this one.

    Parameters
    ----------
    modules : that it imports.
    """

    def __init__(self, modules: Sequence[str]) -> None:
        self._end, other = socket.socketpair()
        with other:
            command = [sys.executable, "-P", "-c", START, json.dumps(sys.path)]
            number = other.fileno()
            self._process = Process([*command, str(number), *modules], inherit=[number], grace=0.0)
        self._busy = threading.Lock()
        self.cpu_seconds = 0.0  # of the process and its children, when the last child ended

    def start(self, request: Path) -> sandbox.Reader:
        """Start a child for a request, as `sandbox.start` does.

        `sandbox.start` is used where the process is busy, has ended, or has several threads.
        """
        if not self._busy.acquire(blocking=False):
            return sandbox.start(request)
        out, err = os.pipe(), os.pipe()
        message = {"request": str(request), "folder": os.getcwd()}
        try:
            send(self._end, message, [out[1], err[1]])
            answer = receive(self._end)
        except (BrokenPipeError, ConnectionResetError):  # somebody ended it
            answer = None
        for writer in (out[1], err[1]):
            os.close(writer)
        if answer is None or not answer[0]["started"]:
            for reader in (out[0], err[0]):
                os.close(reader)
            self._busy.release()
            return sandbox.start(request)
        return Forked(self, out[0], err[0])

    def kill(self) -> None:
        """End the running child."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            send(self._end, {"kill": True})

    def ended(self) -> tuple[int, float, int]:
        """Wait for the end of the running child; see `Running.reap`."""
        answer = receive(self._end)
        if answer is None:
            return -signal.SIGKILL, 0.0, 0
        reply = answer[0]
        self.cpu_seconds = reply["spent"]
        return reply["status"], reply["cpu_seconds"], reply["memory"]

    def release(self) -> None:
        """Allow another child."""
        self._busy.release()

    def close(self) -> None:
        """End the process, which must not have a child."""
        self._end.close()
        self._process.reap()


class Forked(Running):
    """A child of a `ForkServer`.

    Parameters
    ----------
    out, err : descriptors of its output.
    """

    def __init__(self, server: ForkServer, out: int, err: int) -> None:
        super().__init__(grace=0.0)
        self._server, self._out, self._err = server, out, err
        self._lock = threading.Lock()
        self._reaped = False

    def wait(self, on_line: Callable[[str], None], timeout: float | None = None) -> ProcessResult:
        """See `Child.wait`."""
        with os.fdopen(self._out, "rb") as out, os.fdopen(self._err, "rb") as err:
            return self._read(out, err, on_line, timeout, binary=True)

    def reap(self) -> tuple[int, float, int]:
        """See `Running`."""
        ended = self._server.ended()
        with self._lock:
            self._reaped = True
        self._server.release()  # only now: otherwise `_signal` could reach the next child
        return ended

    def _signal(self, number: int) -> None:
        with self._lock:
            if not self._reaped:
                self._server.kill()


class ForkedAhead(SessionProcess):
    """A child of this process that waits for a single request, and ends if none arrives.

    Parameters
    ----------
    pid : of the child.
    request : descriptor to which the path of the request is sent.
    out, err : descriptors of its output.
    """

    def __init__(self, pid: int, request: int, out: int, err: int) -> None:
        super().__init__(pid, grace=0.0)
        self._request, self._out, self._err = request, out, err

    def start(self, request: Path) -> sandbox.Reader:
        """This child, for a request; further children are started by `sandbox.start`."""
        sandbox.set_starter(sandbox.start)
        try:
            with os.fdopen(self._request, "wb") as file:
                file.write(os.fsencode(request))
        except BrokenPipeError:  # somebody ended it
            return sandbox.start(request)
        return self

    def wait(self, on_line: Callable[[str], None], timeout: float | None = None) -> ProcessResult:
        """See `Child.wait`."""
        with os.fdopen(self._out, "rb") as out, os.fdopen(self._err, "rb") as err:
            return self._read(out, err, on_line, timeout, binary=True)


def fork_ahead(modules: Sequence[str]) -> bool:
    """Fork the child that reads the next file, with these modules imported.

    Returns False where the system does not support it, or where this process has other threads,
    whose locks a child would inherit: children are then started as new processes.
    """
    if not AVAILABLE:
        return False
    for module in modules:
        importlib.import_module(module)
    if _threads() > 1:
        return False
    request, out, err = os.pipe(), os.pipe(), os.pipe()
    parent = os.getpid()
    process = os.fork()
    if not process:
        _await(parent, request[0], out[1], err[1])
    for descriptor in (request[0], out[1], err[1]):
        os.close(descriptor)
    sandbox.set_starter(ForkedAhead(process, request[1], out[0], err[0]).start)
    return True


def _await(parent: int, request: int, out: int, err: int) -> NoReturn:
    """The child of `fork_ahead`: it closes the parent's files, including locks."""
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    given = [fcntl.fcntl(one, fcntl.F_DUPFD, 3) for one in (request, out, err)]
    for number, one in enumerate(given):
        os.dup2(one, number)
    os.closerange(3, max(map(int, os.listdir("/proc/self/fd"))) + 1)
    with os.fdopen(os.dup(0), "rb") as file:
        path = os.fsdecode(file.read())
    if not path:
        os._exit(0)
    os.environ[PARENT] = str(parent)
    try:
        sandbox.serve(path)
    finally:  # the exit hook of `serve`, before the handlers of the parent
        error = sys.exception()
        assert error is not None
        sys.excepthook(type(error), error, error.__traceback__)


def _threads() -> int:
    """Number of threads of this process."""
    return len(os.listdir("/proc/self/task"))


def run(descriptor: int, modules: Sequence[str]) -> None:
    """The forking process: fork a child for each request until the other end is closed."""
    os.environ[PARENT] = str(os.getpid())
    for module in modules:
        importlib.import_module(module)
    end = socket.socket(fileno=descriptor)
    while (message := receive(end)) is not None:
        request, descriptors = message
        if "request" not in request:  # the child has already ended
            continue
        process = os.fork() if _threads() == 1 else -1
        if not process:
            end.close()
            os.setsid()
            for number, descriptor in enumerate(descriptors, 1):
                os.dup2(descriptor, number)
                os.close(descriptor)
            os.chdir(request["folder"])
            sandbox.serve(request["request"])
        for descriptor in descriptors:
            os.close(descriptor)
        send(end, {"started": process > 0})
        if process > 0:
            _follow(end, process)


def _follow(end: socket.socket, process: int) -> None:
    """Wait for a child, and end it on request or when the requesting process ends."""
    watched = os.pidfd_open(process)
    while watched not in (ready := select.select([end, watched], [], [])[0]):
        assert end in ready
        gone = receive(end) is None
        _kill(process)
        if gone:
            break
    os.close(watched)
    os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
    _kill(process)  # its descendants
    _, code, usage = os.wait4(process, 0)
    own, children = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    reply = {
        "status": os.waitstatus_to_exitcode(code),
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "memory": peak_memory(usage),
        "spent": own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime,
    }
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        send(end, reply)


def _kill(process: int) -> None:
    """End a child that is not reaped, and its descendants."""
    try:
        os.killpg(process, signal.SIGKILL)
    except ProcessLookupError:  # it has not created its group yet
        os.kill(process, signal.SIGKILL)

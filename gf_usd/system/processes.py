"""Child processes: bakes of a batch, and readers of untrusted files.

A child is a new process, not a fork of this one, whose other threads may hold locks: only
`warm.fork_server` forks, from a process with a single thread.  The output of a child is read while
it runs.  A child is stopped after its time limit, and ends when its parent does, even if the parent
is killed.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, TypeVar

from gf_usd.system.file_locks import INHERITED

if TYPE_CHECKING:
    from resource import struct_rusage

TAIL = 6000  # characters of stderr that are kept
GRACE = 10.0  # [s] between SIGTERM and SIGKILL


PARENT = "GF_USD_PARENT"  # environment variable set by `Child`: the parent's pid


@dataclass(frozen=True, kw_only=True)
class ProcessResult:
    """The result of a process."""

    status: int  # exit status; negative: the signal that ended it
    out: str
    err: str  # the end of stderr
    seconds: float
    cpu_seconds: float
    peak_memory: int  # [bytes]
    timed_out: bool
    stopped: bool  # by `Child.stop`
    reply: bytes = b""  # stdout of a child whose output is binary; `out` is empty then


KILLED = "the system kills processes that use too much memory"  # a hint for SIGKILL


def signal_name(status: int) -> str:
    """The name of the signal of an exit status, negative or above 128 as in shells."""
    number = -status if status < 0 else status - 128
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def peak_memory(usage: struct_rusage) -> int:
    """[bytes] peak resident memory; macOS reports bytes, other systems kilobytes."""
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


class Running:
    """A running process, with methods to stop it and to read its output.

    Parameters
    ----------
    grace : [s] between SIGTERM and SIGKILL; 0: SIGKILL at once; None: GRACE.
    """

    def __init__(self, grace: float | None = None) -> None:
        self._began = time.monotonic()
        self._grace = GRACE if grace is None else grace
        self._stopped = self._timed_out = False

    def stop(self) -> None:
        """Terminate the process, and kill it after the grace time."""
        self._stopped = True
        if not self._grace:
            self._signal(signal.SIGKILL)
            return
        self._signal(signal.SIGTERM)
        timer = threading.Timer(self._grace, self._signal, (signal.SIGKILL,))
        timer.daemon = True
        timer.start()

    def reap(self) -> tuple[int, float, int]:
        """Wait for the end of the process, and end its descendants.

        Returns its exit status (negative: the signal that ended it), CPU time [s] and peak memory
        [bytes].
        """
        raise NotImplementedError

    def _signal(self, number: int) -> None:
        """Send a signal to the process and its descendants, unless it is reaped."""
        raise NotImplementedError

    @contextlib.contextmanager
    def _timed(self, timeout: float | None) -> Iterator[None]:
        """Stop the process where the block takes longer than `timeout` [s]."""
        timer = threading.Timer(timeout or 0.0, self._time_out)
        if timeout and timeout < threading.TIMEOUT_MAX:  # longer timeouts overflow
            timer.daemon = True
            timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _time_out(self) -> None:
        self._timed_out = True
        self.stop()

    def _read(
        self,
        stdout: IO[bytes],
        stderr: IO[bytes],
        on_line: Callable[[str], None],
        timeout: float | None,
        *,
        binary: bool,
    ) -> ProcessResult:
        """Read the output to its end; see `Child.wait`."""
        out: list[bytes] = []
        reader = threading.Thread(target=lambda: out.append(stdout.read()), daemon=True)
        reader.start()
        with self._timed(timeout):
            tail = tail_of(stderr, on_line)
            reader.join()
            status, cpu_seconds, peak_memory = self.reap()
        stdout.close()
        return ProcessResult(
            status=status,
            out="" if binary else out[0].decode(errors="replace"),
            err=tail,
            seconds=time.monotonic() - self._began,
            cpu_seconds=cpu_seconds,
            peak_memory=peak_memory,
            timed_out=self._timed_out,
            stopped=self._stopped and not self._timed_out,
            reply=out[0] if binary else b"",
        )


class SessionProcess(Running):
    """A child in its own session, so that a signal reaches all processes that it started.

    Parameters
    ----------
    pid : of the process, which only `reap` reaps.
    grace : as of `Running`.
    """

    def __init__(self, pid: int, grace: float | None = None) -> None:
        super().__init__(grace)
        self.pid = pid
        self._lock = threading.Lock()
        self._reaped = False

    def reap(self) -> tuple[int, float, int]:
        """See `Running`."""
        if hasattr(os, "waitid"):  # not on macOS before Python 3.13
            # ended but not yet reaped, so that its pid is still that of its group
            os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOWAIT)
            self._signal(signal.SIGKILL)
        # not Popen.wait: only this call also returns the resource usage
        _, code, usage = os.wait4(self.pid, 0)
        with self._lock:
            self._reaped = True
        status = os.waitstatus_to_exitcode(code)
        return status, usage.ru_utime + usage.ru_stime, peak_memory(usage)

    def _signal(self, number: int) -> None:
        with self._lock:
            # until it is reaped, its pid is not reused
            if not self._reaped:
                with contextlib.suppress(PermissionError):  # macOS: for a group that has ended
                    os.killpg(self.pid, number)


class Process(SessionProcess):
    """A process that runs a command.

    Parameters
    ----------
    inherit : file descriptors that it inherits, with the same numbers.
    out, err : its stdout and stderr, as for `subprocess`.
    grace : as of `Running`.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        inherit: Sequence[int] = (),
        out: int = subprocess.DEVNULL,
        err: int = subprocess.DEVNULL,
        grace: float | None = None,
    ) -> None:
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL, stdout=out, stderr=err,
            start_new_session=True,
            pass_fds=tuple(inherit),
            env={
                **os.environ, PARENT: str(os.getpid()), INHERITED: ",".join(map(str, inherit)),
            },
        )  # fmt: skip
        super().__init__(self._process.pid, grace)

    def reap(self) -> tuple[int, float, int]:
        """See `Running`."""
        ended = super().reap()
        self._process.returncode = ended[0]
        return ended


def tail_of(stderr: IO[bytes], on_line: Callable[[str], None]) -> str:
    """Read stderr to its end; returns the last TAIL characters.

    on_line : called with each line.
    """
    tail = ""
    with io.TextIOWrapper(stderr, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            tail = (tail + line)[-TAIL:]
            on_line(line.rstrip("\n"))
    return tail


class Child(Process):
    """A process that runs one command and whose output is read.

    Parameters
    ----------
    inherit, grace : as of `Process`.
    binary : its stdout is not text.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        inherit: Sequence[int] = (),
        binary: bool = False,
        grace: float | None = None,
    ) -> None:
        super().__init__(
            command, inherit=inherit, out=subprocess.PIPE, err=subprocess.PIPE, grace=grace
        )
        self._binary = binary

    def wait(self, on_line: Callable[[str], None], timeout: float | None = None) -> ProcessResult:
        """Read the output to its end, and end the descendants of the process.

        Parameters
        ----------
        on_line : called with each line of stderr.
        timeout : [s] after which it is stopped.
        """
        stdout, stderr = self._process.stdout, self._process.stderr
        assert stdout is not None
        assert stderr is not None
        return self._read(stdout, stderr, on_line, timeout, binary=self._binary)

    def end(self) -> None:
        """Kill the process and its descendants, after `wait` was interrupted."""
        self._signal(signal.SIGKILL)
        if not self._reaped:
            self.reap()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()


P = TypeVar("P", bound=Process)


class Children:
    """The running processes, which can be stopped together."""

    def __init__(self) -> None:
        self._running: set[Process] = set()
        self._lock = threading.Lock()
        self._stopping = threading.Event()

    @property
    def stopping(self) -> bool:
        """Whether no more processes may be started."""
        return self._stopping.is_set()

    def pause(self, seconds: float) -> None:
        """Sleep, until `stop` is called."""
        self._stopping.wait(seconds)

    def stop(self) -> None:
        """Stop the running processes and start no more."""
        self._stopping.set()
        with self._lock:
            for child in self._running:
                child.stop()

    def run(
        self,
        command: Sequence[str],
        on_line: Callable[[str], None],
        *,
        timeout: float | None = None,
        inherit: Sequence[int] = (),
    ) -> ProcessResult | None:
        """Run a command to its end; None where `stop` was called before."""
        with self.running(lambda: Child(command, inherit=inherit)) as child:
            return None if child is None else child.wait(on_line, timeout)

    @contextlib.contextmanager
    def running(self, start: Callable[[], P]) -> Iterator[P | None]:
        """The process that `start` returns, which `stop` stops within the block.

        None where `stop` was called before; `start` is not called then.
        """
        with self._lock:
            child = None if self._stopping.is_set() else start()
            if child is not None:
                self._running.add(child)
        try:
            yield child
        finally:
            if child is not None:
                with self._lock:
                    self._running.discard(child)


EVERY = 0.5  # [s]


def end_with_parent() -> None:
    """End this process when the parent that started it as a `Child` ends.

    Otherwise it would keep the lock on its files without any use for its result.
    """
    parent = os.environ.pop(PARENT, "")
    if parent.isdigit():
        threading.Thread(target=_watch, args=(int(parent),), daemon=True).start()


def _watch(parent: int) -> None:
    tick = threading.Event()
    while os.getppid() == parent:
        tick.wait(EVERY)
    os.kill(os.getpid(), signal.SIGTERM)

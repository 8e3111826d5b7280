"""One process of a job: what it says is heard line by line, and it ends when it must.

A bake that a batch started ends when the batch is gone, whatever killed it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gf_usd.system.file_locks import INHERITED

TAIL = 6000  # characters of stderr that are kept
GRACE = 10.0  # [s] between the request to end and the end


PARENT = "GF_USD_PARENT"  # set by batch.child: the process that waits for this one


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a process ended."""

    status: int  # exit status; negative: the signal that ended it
    out: str
    err: str  # the last of stderr
    seconds: float
    cpu_seconds: float
    peak_memory: int  # [bytes]
    timed_out: bool
    stopped: bool  # by `Child.stop`


class Child:
    """A process in a session of its own, so that a signal reaches all that it started."""

    def __init__(self, command: Sequence[str], *, inherit: Sequence[int] = ()) -> None:
        self._began = time.monotonic()
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, errors="replace",
            start_new_session=True,
            pass_fds=tuple(inherit),
            env={
                **os.environ, PARENT: str(os.getpid()), INHERITED: ",".join(map(str, inherit)),
            },
        )  # fmt: skip
        self._lock = threading.Lock()
        self._reaped = self._stopped = self._timed_out = False

    @property
    def pid(self) -> int:
        return self._process.pid

    def stop(self) -> None:
        """Ask it to end, and end it if it does not within the grace."""
        self._stopped = True
        self._signal(signal.SIGTERM)
        timer = threading.Timer(GRACE, self._signal, (signal.SIGKILL,))
        timer.daemon = True
        timer.start()

    def wait(self, on_line: Callable[[str], None], timeout: float | None = None) -> Ended:
        """Hear it out.

        Parameters
        ----------
        on_line : called with each line of stderr.
        timeout : [s] after which it is stopped.
        """
        process = self._process
        stdout, stderr = process.stdout, process.stderr
        assert stdout is not None
        assert stderr is not None
        out: list[str] = []
        reader = threading.Thread(target=lambda: out.append(stdout.read()), daemon=True)
        reader.start()
        timer = threading.Timer(timeout or 0.0, self._time_out)
        if timeout:
            timer.daemon = True
            timer.start()
        tail = ""
        for line in stderr:
            tail = (tail + line)[-TAIL:]
            on_line(line.rstrip("\n"))
        reader.join()
        # not Popen.wait: only this call also tells what the process used
        _, code, usage = os.wait4(process.pid, 0)
        with self._lock:
            self._reaped = True
        timer.cancel()
        stdout.close()
        stderr.close()
        process.returncode = os.waitstatus_to_exitcode(code)
        return Ended(
            status=process.returncode,
            out="".join(out),
            err=tail,
            seconds=time.monotonic() - self._began,
            cpu_seconds=usage.ru_utime + usage.ru_stime,
            peak_memory=usage.ru_maxrss * (1 if os.uname().sysname == "Darwin" else 1024),
            timed_out=self._timed_out,
            stopped=self._stopped and not self._timed_out,
        )

    def _time_out(self) -> None:
        self._timed_out = True
        self.stop()

    def _signal(self, number: int) -> None:
        with self._lock:
            # before it is reaped its number cannot be another process's
            if not self._reaped:
                os.killpg(self._process.pid, number)


class Children:
    """The processes that run now, so that all of them can be stopped at once."""

    def __init__(self) -> None:
        self._running: set[Child] = set()
        self._lock = threading.Lock()
        self._stopping = threading.Event()

    @property
    def stopping(self) -> bool:
        """Nothing more is to be started."""
        return self._stopping.is_set()

    def pause(self, seconds: float) -> None:
        """Sleep, unless it is time to stop."""
        self._stopping.wait(seconds)

    def stop(self) -> None:
        """Stop what runs and start nothing more."""
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
    ) -> Ended | None:
        """Run a command to its end; None where nothing is to be started any more."""
        with self._lock:
            if self._stopping.is_set():
                return None
            child = Child(command, inherit=inherit)
            self._running.add(child)
        try:
            return child.wait(on_line, timeout)
        finally:
            with self._lock:
                self._running.discard(child)


EVERY = 0.5  # [s]


def end_with_parent() -> None:
    """Watch the parent that started this process to hear it out, if one did.

    Without it nobody would hear the result, while the lock on its files would still be held.
    """
    parent = os.environ.pop(PARENT, "")
    if parent.isdigit():
        threading.Thread(target=_watch, args=(int(parent),), daemon=True).start()


def _watch(parent: int) -> None:
    tick = threading.Event()
    while os.getppid() == parent:
        tick.wait(EVERY)
    os.kill(os.getpid(), signal.SIGTERM)

"""gf-usd worker: the process of `system.warm.workers`, which runs one bake after another."""

from __future__ import annotations

import contextlib
import gc
import os
import resource
import socket
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from gf_usd.cli import exit
from gf_usd.system.file_locks import INHERITED
from gf_usd.system.processes import peak_memory
from gf_usd.system.resources import system_file
from gf_usd.system.warm.workers import receive, send

if TYPE_CHECKING:
    from gf_usd.system.warm.fork_server import ForkServer

SOUND = (0, 2, 3, 4, 5)  # exit statuses after which the process can be used again
# modules that a child imports to read USD
READERS = (
    "gf_usd.readers.isolated",
    "gf_usd.readers.usd.asset",
    "gf_usd.readers.usd_bake.spec",
)
SCHEMA = "gf_usd.system.usd_schema"  # importing it starts threads of USD, unless disabled
MOST_JOBS = 100  # commands of one process
MOST_MEMORY = 2 << 30  # [bytes] that are in use between two commands


def follow(
    descriptor: int, command: Callable[[Sequence[str]], int], forks: ForkServer | None = None
) -> int:
    """Run requests until the other end is closed; returns the exit status.

    command : runs ``gf-usd`` with arguments and returns the exit status.
    forks : of the children that read files; its time is the commands'.
    """
    quiet = os.open(os.devnull, os.O_RDWR)
    with socket.socket(fileno=descriptor) as end:
        jobs = 0
        while (received := receive(end)) is not None:
            jobs += 1
            request, (stderr, *others) = received
            before = _cpu_seconds(forks)
            reply = _run(request, stderr, others, quiet, command)
            reply["cpu_seconds"] = _cpu_seconds(forks) - before
            reply["last"] = (
                reply["status"] not in SOUND or jobs == MOST_JOBS or _resident() > MOST_MEMORY
            )
            send(end, reply)
            if reply["last"]:
                return reply["status"]
    return 0


def forked_readers() -> ForkServer | None:
    """Fork the children that read files from now on; None if the system does not support it."""
    from gf_usd.system import sandbox
    from gf_usd.system.warm.fork_server import AVAILABLE, ForkServer

    if not AVAILABLE:
        return None
    forks = ForkServer((*READERS, SCHEMA))
    sandbox.set_starter(forks.start)
    return forks


def read_ahead() -> None:
    """Fork the child that reads the next file, unless a worker has others for that."""
    from gf_usd.system import sandbox
    from gf_usd.system.warm.fork_server import fork_ahead

    if sys.platform == "linux" and sandbox.starts_new_processes():
        fork_ahead(READERS)


def make_ready() -> None:
    """Import the modules of a bake, so that the first bake does not wait for them."""
    from gf_usd.layers import cache, root  # noqa: F401
    from gf_usd.layers.check import run as checks  # noqa: F401
    from gf_usd.physics import solvers  # noqa: F401
    from gf_usd.pipeline.run import run  # noqa: F401
    from gf_usd.system.taichi_runtime import import_taichi

    import_taichi()


def _run(
    request: dict[str, Any],
    stderr: int,
    others: Sequence[int],
    quiet: int,
    command: Callable[[Sequence[str]], int],
) -> dict[str, Any]:
    """One command with its stderr, events and locks."""
    events, *locks = others
    _forget_peak()
    os.dup2(stderr, 2)
    os.close(stderr)
    os.environ[INHERITED] = ",".join(map(str, locks))
    exit.watch(())
    os.chdir(request["folder"])
    # the command takes the descriptor for its own, and closes it
    given = os.dup(events)
    status = command([*request["arguments"], "--events", str(given)])
    gc.collect()
    sys.stderr.flush()
    if _same_file(given, events):  # it ended before that
        os.close(given)
    for descriptor in others:
        os.close(descriptor)
    os.dup2(quiet, 2)
    return {"status": status, "memory": _peak()}


def _same_file(one: int, other: int) -> bool:
    """Whether two descriptors refer to the same open file; a closed one may have been reused."""
    try:
        return os.path.samestat(os.fstat(one), os.fstat(other))
    except OSError:
        return False


def _cpu_seconds(forks: ForkServer | None) -> float:
    """[s] that this process and its children have used."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    forked = 0.0 if forks is None else forks.cpu_seconds
    return sum(one.ru_utime + one.ru_stime for one in used) + forked


def _forget_peak() -> None:
    """Reset the peak of memory that the kernel measures; only Linux supports it."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")


def _peak() -> int:
    """[bytes] the most that was in use since `_forget_peak`, or since the process began."""
    return _status("VmHWM") or peak_memory(resource.getrusage(resource.RUSAGE_SELF))


def _resident() -> int:
    """[bytes] in use now, or else their peak."""
    return _status("VmRSS") or _peak()


def _status(name: str) -> int:
    """[bytes] of a line of /proc/self/status; 0 where the system has none."""
    rows = (line.split() for line in system_file("/proc/self/status").splitlines())
    return next((1024 * int(row[1]) for row in rows if row and row[0] == f"{name}:"), 0)

"""What a child process of a test does, named as "isolated_tasks:NAME"."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gf_usd.core.errors import GfUsdError, InputError
from gf_usd.readers.isolated import read_untrusted
from gf_usd.system.sandbox import Limits, run_isolated

IMPORTED_BY = os.getpid()


def crash(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hang() -> None:
    time.sleep(60.0)


def eat() -> None:
    bytearray(10**13)


def fail() -> None:
    raise KeyError("points")


def vanish() -> None:
    os._exit(7)


def words_that_fail() -> None:
    b"\xff".decode()


def quoting() -> None:
    class Quoting(RuntimeError):
        def __str__(self) -> str:
            return b"\xff".decode()

    raise Quoting


def refuse_beside(seen: Path) -> None:
    """Refuse, and leave a temporary file, whose name goes into `seen`."""
    with tempfile.NamedTemporaryFile(delete=False) as left:
        seen.write_text(left.name)
    raise InputError("no", "none")


def refuse_for_memory() -> None:
    raise InputError("a.usdc is damaged: Encountered: std::bad_alloc", "none")


def write(path: Path, count: int) -> None:
    path.write_bytes(bytes(count))


def same(*values: object) -> tuple[object, ...]:
    return values


def unknown() -> object:
    return object()


def parent() -> int:
    return os.getppid()


def loaded_already() -> int:
    """1 where this module was imported before the process became a child."""
    return int(os.getpid() != IMPORTED_BY)


def files() -> int:
    """How many are open."""
    return len(os.listdir("/proc/self/fd"))


def folder() -> str:
    return os.getcwd()


def spin(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def talk() -> str:
    """Print, from Python and from a program."""
    print("x" * 100_000)
    subprocess.run(["echo", "from a program"], check=True)
    return "done"


def count(file: Path, seconds: float) -> None:
    """Add a letter to a file, then work for so long."""
    _add(file)
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        pass


def count_and_hang(file: Path, seconds: float) -> None:
    """Add a letter to a file, then sleep for so long."""
    _add(file)
    time.sleep(seconds)


def _add(file: Path) -> None:
    with file.open("a") as out:
        out.write("x")


def stay(file: Path) -> None:
    """Start a program that sleeps, write its number and this one's, and sleep."""
    child = subprocess.Popen(["sleep", "60"])
    file.with_suffix(".part").write_text(f"{os.getpid()} {child.pid}")
    file.with_suffix(".part").rename(file)
    time.sleep(60.0)


def loaded(path: Path) -> list[str]:
    """The modules that were loaded to read a file."""
    read_untrusted(path)
    return sorted(sys.modules)


def read_each(files: Sequence[Path]) -> None:
    """Read files one after the other; refusals with a message of gf-usd count as success."""
    for file in files:
        with contextlib.suppress(GfUsdError):
            read_untrusted(file)


def stopped(files: Sequence[Path], limits: Limits) -> dict[Path, str]:
    """Files that end in no words of the reader's own, and what the child was stopped for.

    All are tried in one child first, to start only one where nothing is found.
    """
    together = replace(limits, time=limits.time * max(1.0, len(files) / 10.0))
    with contextlib.suppress(InputError):
        run_isolated(files[0], "isolated_tasks:read_each", together, files)
        return {}
    found = {}
    for file in files:
        try:
            run_isolated(file, "isolated_tasks:read_each", limits, [file])
        except InputError as error:
            found[file] = error.message
    return found

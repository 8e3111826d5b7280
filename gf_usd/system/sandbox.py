"""Untrusted files are read in a child process first, under limits on time, memory and output.

Parsers in native code can crash, hang or eat memory, and take the process with them.  A forked
child does the reading; only where it came to an end, in words or with success, does the parent
read the file itself.  Without fork (Windows) nothing is tried and nothing is limited.
"""

from __future__ import annotations

import contextlib
import faulthandler
import math
import os
import re
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NoReturn

from gf_usd.core.errors import GfUsdError, InputError, UsageError

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
STILL = 0.1  # of its time: a child that ran for less stood still
TRUST = "if you trust the file, raise the limit or turn it off: --limits"
FINE = b"fine"
NO_MEMORY = b"memory"
FAILED = b"failed "


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What reading an untrusted file may take."""

    time: float = 300.0  # [s] by the clock
    memory: float = 16e9  # [B] of address space
    output: float = 1e9  # [B] of each file that a reader writes


def parse_limits(text: str | None) -> Limits | None:
    """Limits of `--limits`: `time=300,memory=16G,output=1G`, any of them; None for `none`.

    Raises UsageError for a name that is not there, or a size that is not above 0.
    """
    if text is None:
        return Limits()
    if text.strip() == "none":
        return None
    limits = Limits()
    for part in text.split(","):
        name, _, value = (word.strip() for word in part.partition("="))
        found = re.fullmatch(r"(\d+(?:\.\d+)?)([kMGT]?)", value)
        known = [field.name for field in fields(Limits)]
        size = float(found[1]) * UNITS[found[2]] if found else 0.0
        if name not in known or size <= 0.0:
            raise UsageError(
                f"--limits {text!r}: {part!r} is no limit",
                "give time=SECONDS, memory=BYTES and output=BYTES with commas, e.g."
                " --limits time=600,memory=32G, or --limits none",
            )
        limits = replace(limits, **{name: size})
    return limits


def _isolates(path: Path, limits: Limits | None) -> bool:
    """Whether a file is tried in a child at all: what is no file is refused without one."""
    return limits is not None and hasattr(os, "fork") and path.is_file()


def attempt(path: Path, work: Callable[[], object], limits: Limits | None) -> None:
    """Do `work` on a file in a child process; return if it ended, or ended in a GfUsdError.

    Call it before Taichi is started: the child is a fork, which takes along the locks that other
    threads hold at that moment, and nobody there opens them.  A child that stood still all its time
    is taken for one that met such a lock, and another is tried.  What a child writes to the
    temporary folder goes with it.

    Raises InputError where the child crashed, failed with an error that is not ours, took longer
    than `limits.time` or asked for more than `limits.memory`.
    """
    if limits is None or not _isolates(path, limits):
        return
    said, status, ran = _child(work, limits)
    if said is None and ran < STILL * limits.time:
        said, status, _ = _child(work, limits)
    if said is None:
        raise InputError(
            f"{path}: reading it took longer than {limits.time:g} s",
            f"the file may be damaged; {TRUST} time=SECONDS",
        )
    if said == NO_MEMORY:
        raise InputError(
            f"{path}: reading it asked for more than {limits.memory / 1e9:g} GB of memory",
            f"the file may be damaged; {TRUST} memory=BYTES",
        )
    if said.startswith(FAILED):
        raise InputError(
            f"{path} made its reader fail: {said.removeprefix(FAILED).decode(errors='replace')}",
            "the file is likely damaged: export it again; a sound file that does this is a fault"
            " of gf-usd, worth a report",
        )
    if said != FINE:
        number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        how = f"signal {number}, {signal.Signals(number).name}" if number else "without a word"
        raise InputError(
            f"{path} made its reader crash ({how})",
            "the file is likely damaged: export it again, or open it in a USD viewer first",
        )


def _child(work: Callable[[], object], limits: Limits) -> tuple[bytes | None, int, float]:
    """What a child said, its wait status, and how long [s] it ran; it has ended."""
    with tempfile.TemporaryDirectory(prefix="gf-usd-") as scratch:
        read_end, write_end = os.pipe()
        child = os.fork()
        if child == 0:
            _in_child(work, limits, write_end, scratch)
        os.close(write_end)
        try:
            said = _said(read_end, limits.time)
        finally:
            os.close(read_end)
            status, ran = _end(child)
    return said, status, ran


def _said(pipe: int, seconds: float) -> bytes | None:
    """All that a child writes until it ends; None where that takes longer than `seconds`."""
    until, said = time.monotonic() + seconds, b""
    while True:
        ready, _, _ = select.select([pipe], [], [], max(0.0, until - time.monotonic()))
        if not ready:
            return None
        block = os.read(pipe, 4096)
        if not block:
            return said
        said += block


def _end(child: int) -> tuple[int, float]:
    """Wait status of a child, the processor time [s] it took, and the end of its group.

    The group may hold programs that it started.
    """
    os.kill(child, signal.SIGKILL)  # it may not lead its group yet
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    _, status, used = os.wait4(child, 0)
    return status, used.ru_utime + used.ru_stime


def _in_child(work: Callable[[], object], limits: Limits, pipe: int, scratch: str) -> NoReturn:
    """Do the work and say how it ended; whatever happens, no line of the parent's runs here.

    This is the one place that takes any error: it is the end of a process, there is nobody above
    to pass it to, and what a parser written by others may raise cannot be listed.  Nothing is
    hidden by it: an error of ours is raised again, as it is, by the parent's own reading, and any
    other becomes an InputError with its type and words.
    """
    said = FINE
    try:
        os.setpgid(0, 0)
        faulthandler.disable()  # the parent says how it crashed
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        quiet = os.open(os.devnull, os.O_RDWR)
        for standard in (0, 1, 2):
            os.dup2(quiet, standard)
        tempfile.tempdir = os.environ["TMPDIR"] = scratch
        _limit(limits)
        try:
            work()
        except GfUsdError as error:
            # The parent meets it in the order of its own checks.  But a reader that ran into the
            # limit and says so in words would meet no limit there.
            if "bad_alloc" in str(error):
                said = NO_MEMORY
    finally:
        error = sys.exc_info()[1]
        if error is not None:
            said = _words(error)
        os.write(pipe, said)
        os._exit(0)  # no teardown: freeing a stage takes time, and its end is nobody's concern


def _words(error: BaseException) -> bytes:
    """NO_MEMORY, or type and first line of an error, whatever its words are."""
    try:
        first = (str(error).strip().splitlines() or [""])[0][:300]
    except UnicodeDecodeError:
        first = "its words are not UTF-8"
    if isinstance(error, MemoryError) or "bad_alloc" in first:
        return NO_MEMORY
    return FAILED + f"{type(error).__name__}: {first}".encode(errors="replace")


def _limit(limits: Limits) -> None:
    """The kernel's part: address space, size of a file, processor time should the parent die."""
    import resource

    seconds = math.ceil(limits.time) * (os.cpu_count() or 1)
    asked = {
        resource.RLIMIT_AS: int(limits.memory),
        resource.RLIMIT_FSIZE: int(limits.output),
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_CORE: 0,
    }
    for kind, most in asked.items():
        hard = resource.getrlimit(kind)[1]
        if hard != resource.RLIM_INFINITY:
            most = min(most, hard)
        # macOS does not limit address space
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (most, hard))

"""Reads untrusted files in a child process, with limits on time, memory and output.

Native parsers can crash, hang or exhaust memory, and take their process with them.  A child
therefore reads the file and returns the result, or the error; this process opens only files that a
child has read.  This needs POSIX: on Windows a task runs in this process, without limits.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import json
import math
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Protocol

from gf_usd.core import errors
from gf_usd.core.errors import GfUsdError, InputError, UsageError
from gf_usd.core.units import bytes_text
from gf_usd.system import exchange
from gf_usd.system.processes import Child, ProcessResult, end_with_parent

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
TRUST = "if you trust the file, raise the limit or turn it off: --limits"
NO_MEMORY = "memory"  # written by a child instead of its error message
FAILED = 1  # exit status of a child that has written an error
LEAST_MEMORY = 2e9  # [B] of address space: with 1.2e9 the libraries of the reader crash
REFUSALS = (
    "InputError",
    "UsageError",
    "BakeError",
    "GfUsdError",
)  # that are sent between processes
# -P: do not import modules from the working directory
START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from gf_usd.system.sandbox import serve; serve(sys.argv[2])"
)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits on reading an untrusted file.

    Raises UsageError for less memory than the reader needs for any file.
    """

    time: float = 300.0  # [s] wall time
    memory: float = 16e9  # [B] of address space
    output: float = 1e9  # [B] of each written file

    def __post_init__(self) -> None:
        if self.memory < LEAST_MEMORY:
            raise UsageError(
                f"the limits allow {bytes_text(self.memory)} of memory, less than the"
                f" {bytes_text(LEAST_MEMORY)} that the reader needs by itself",
                f"allow {bytes_text(LEAST_MEMORY)} or more: --limits memory=4G",
            )


def parse_limits(text: str | None) -> Limits | None:
    """Limits from `--limits`: `time=300,memory=16G,output=1G`, any of them; None for `none`.

    Raises UsageError for an unknown name, a size that is not above 0, or less memory than the
    reader needs for any file.
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
                f"--limits {text!r}: {part!r} is not a limit",
                "give time=SECONDS, memory=BYTES and output=BYTES with commas, e.g."
                " --limits time=600,memory=32G, or --limits none",
            )
        limits = replace(limits, **{name: size})
    return limits


class Scratch:
    """A temporary folder that is removed with the object, or at the end of the program."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="gf-usd-")).resolve()
        # Windows cannot remove a file that USD still maps.
        self._finalizer = weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)

    def remove(self) -> None:
        """Remove the folder now."""
        self._finalizer()

    def release(self) -> Path:
        """Keep the folder; returns its path."""
        self._finalizer.detach()
        return self.path


def run_isolated(path: Path, task: str, limits: Limits | None, *args: Any) -> Any:
    """The result of a task that reads a file; see `Isolated` for arguments and errors."""
    with Isolated(path, task, limits, *args) as isolated:
        return isolated.result()


class Reader(Protocol):
    """A child that runs a task."""

    def wait(self, on_line: Callable[[str], None], timeout: float | None = None) -> ProcessResult:
        """Read its output to the end."""
        ...

    def stop(self) -> None:
        """End it."""
        ...


def start(request: Path) -> Reader:
    """A new process for a request; see `serve`."""
    command = [sys.executable, "-P", "-c", START, json.dumps(sys.path), str(request)]
    return Child(command, binary=True, grace=0.0)


_starts: list[Callable[[Path], Reader]] = [start]


def set_starter(other: Callable[[Path], Reader]) -> None:
    """Replace the function that starts the children of this process, `start` by default."""
    _starts[:] = [other]


def starts_new_processes() -> bool:
    """Whether children of this process are new processes, not forks."""
    return _starts[-1] is start


class Isolated:
    """A task that reads a file in a child process, while this process continues.

    Parameters
    ----------
    path : the file, for messages.  If it does not exist, the task runs in this process, which
        reports it.
    task : the function, as "module:name"; its arguments and result are sent by `exchange`.
    limits : of the child; None: no child, the task runs in this process when its result is
        requested.
    """

    def __init__(self, path: Path, task: str, limits: Limits | None, *args: Any) -> None:
        self.scratch: Scratch | None = None  # the child's temporary folder
        self._path, self._task, self._args = path, task, args
        self._limits = limits
        self._delivered = False
        self._child: Reader | None = None
        self._ended: list[ProcessResult] = []
        if limits is None or os.name != "posix" or not path.is_file():
            return
        self.scratch = Scratch()
        # in a file, because the size of arguments is limited
        request = self.scratch.path / "request"
        with request.open("wb") as file:
            exchange.write({"task": task, "args": args, "limits": asdict(limits)}, file)
        self._child = _starts[-1](request)
        self._reader = threading.Thread(target=self._read, args=(self._child, limits), daemon=True)
        self._reader.start()

    def _read(self, child: Reader, limits: Limits) -> None:
        self._ended.append(child.wait(lambda line: None, limits.time))

    @property
    def in_child(self) -> bool:
        """Whether a child runs the task."""
        return self._child is not None

    def result(self) -> Any:
        """The result of the task.

        Raises the errors of the task that are of this package; InputError where the child crashed,
        raised another error, or exceeded `limits.time` or `limits.memory`.
        """
        if self._child is None or self._limits is None:
            return _function(self._task)(*self._args)
        self._reader.join()
        value = _answer(self._path, self._ended[0], self._limits)
        self._delivered = True
        return value

    def __enter__(self) -> Isolated:
        return self

    def __exit__(self, *error: object) -> None:
        """End the child if it still runs; without a result, its files are removed too."""
        if self._child is not None:
            self._child.stop()
            self._reader.join()
        if self.scratch is not None and not self._delivered:
            self.scratch.remove()


def _answer(path: Path, ended: ProcessResult, limits: Limits) -> Any:
    """The result of a child; raises the child's error, or InputError from its exit status."""
    if ended.timed_out:
        raise InputError(
            f"{path}: reading it took longer than {limits.time:g} s",
            f"the file may be damaged; {TRUST} time=SECONDS",
        )
    if ended.status == 0:
        answer = exchange.read(ended.reply)
        if answer["refusal"] is not None:
            name, message, hint = answer["refusal"]
            raise getattr(errors, name)(message, hint)
        return answer["value"]
    if ended.err == NO_MEMORY:
        raise InputError(
            f"{path}: reading it needed more than {bytes_text(limits.memory)} of memory",
            f"the file may be damaged; {TRUST} memory=BYTES",
        )
    if ended.status == FAILED and ended.err:
        raise InputError(
            f"{path} caused its reader to fail: {ended.err}",
            "the file is probably damaged: export it again; if an intact file causes this, it "
            "is a bug in gf-usd: please report it",
        )
    number = -ended.status
    how = f"signal {number}, {signal.Signals(number).name}" if number > 0 else "without output"
    least = Limits().memory
    lower = "; or raise --limits memory=BYTES" if limits.memory < least else ""
    raise InputError(
        f"{path} caused its reader to crash ({how})",
        "the file is probably damaged: export it again, or open it in a USD viewer first" + lower,
    )


def _function(task: str) -> Callable[..., Any]:
    module, name = task.split(":")
    return getattr(import_module(module), name)


def serve(request: str) -> NoReturn:
    """The child process: run the task of `Isolated`, write the result to stdout, and exit.

    Errors that are not of this package are handled by the exit hook, because the exceptions of
    native parsers cannot be listed.
    """
    reply, stderr = os.dup(1), os.dup(2)
    quiet = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1, 2):
        os.dup2(quiet, standard)

    def failed(kind: type[BaseException], error: BaseException, at: TracebackType | None) -> None:
        said = _message(error)
        if sys._getframe().f_back is not None and said != NO_MEMORY:
            return  # printed by a native parser, which continues: the task is still running
        os.write(stderr, said.encode(errors="replace"))
        os._exit(FAILED)

    sys.excepthook = failed
    faulthandler.disable()  # the parent reports the crash
    gc.disable()  # the process is too short-lived to benefit
    end_with_parent()
    request_read = exchange.read(Path(request).read_bytes())
    tempfile.tempdir = os.environ["TMPDIR"] = str(Path(request).parent)
    _limit(Limits(**request_read["limits"]))
    value, refusal = None, None
    try:
        value = _function(request_read["task"])(*request_read["args"])
    except GfUsdError as error:
        if "bad_alloc" in str(error):
            raise MemoryError from error
        name = next(of.__name__ for of in type(error).__mro__ if of.__name__ in REFUSALS)
        refusal = (name, error.message, error.hint)
    with os.fdopen(reply, "wb") as file:
        exchange.write({"value": value, "refusal": refusal}, file)
    os._exit(0)  # skip the teardown: freeing a stage takes time


def _message(error: BaseException) -> str:
    """NO_MEMORY, or the type and the first line of an error."""
    try:
        first = (str(error).strip().splitlines() or [""])[0][:300]
    except UnicodeDecodeError:
        first = "its messages are not UTF-8"
    if isinstance(error, MemoryError) or "bad_alloc" in first:
        return NO_MEMORY
    return f"{type(error).__name__}: {first}"


def _limit(limits: Limits) -> None:
    """Limits that the kernel enforces: address space, file size, and CPU time if the parent
    dies.
    """
    import resource

    seconds = math.ceil(limits.time) * (os.cpu_count() or 1)
    request_read = {
        resource.RLIMIT_AS: int(limits.memory),
        resource.RLIMIT_FSIZE: int(limits.output),
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_CORE: 0,
    }
    for kind, most in request_read.items():
        hard = resource.getrlimit(kind)[1]
        if hard != resource.RLIM_INFINITY:
            most = min(most, hard)
        # macOS does not limit address space
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (most, hard))

"""Runs a function in a separate process if this one cannot run it, and returns its result or error.

A host may have read USD's schema definitions before gf-usd was loaded, or may use Taichi itself,
which can run only once in a process.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import threading
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from gf_usd.core import errors
from gf_usd.core.errors import BakeError, GfUsdError, UsageError
from gf_usd.system import exchange
from gf_usd.system.processes import Child, end_with_parent
from gf_usd.system.sandbox import Scratch

DONE = "gf-usd progress "  # begins a line of stderr: frames done, frames in all
START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from gf_usd.api.host.own_process import serve; serve(sys.argv[2])"
)


def call(
    task: str, options: Mapping[str, Any], progress: Callable[[int, int], None] | None = None
) -> Any:
    """What a function returns that runs in a process of its own; it ends with this one.

    Parameters
    ----------
    task : the function, as "module:name"; options : its keywords.  Values, and what it returns,
        pass `exchange`.
    progress : is called with what the function reports to its own keyword `progress`.

    Raises what the function raised, where that is an error of ours; UsageError where no process can
    be started, and BakeError where it crashed.  What progress raises ends the process.
    """
    if os.name != "posix":
        raise UsageError(
            "this needs a separate process, which is only supported on POSIX systems",
            "import gf_usd.system.usd_schema before the first stage is opened, and leave Taichi to"
            " gf-usd",
        )
    scratch = Scratch()
    try:
        request = scratch.path / "request"
        with request.open("wb") as file:
            with_progress = progress is not None
            exchange.write(
                {"task": task, "options": dict(options), "progress": with_progress}, file
            )
        return _answer(request, progress)
    finally:
        scratch.remove()


def _answer(request: Path, progress: Callable[[int, int], None] | None) -> Any:
    try:
        child = Child(
            [sys.executable, "-P", "-c", START, json.dumps(sys.path), str(request)], binary=True
        )
    except OSError as error:
        raise UsageError(
            f"a separate process cannot be started with {sys.executable}: {error.strerror}",
            "set sys.executable to a Python that has gf-usd, or run gf-usd from a terminal",
        ) from error
    finished = False

    def on_line(line: str) -> None:
        if progress and line.startswith(DONE):
            done, total = line.removeprefix(DONE).split()
            progress(int(done), int(total))

    try:
        ended = child.wait(on_line)
        finished = True
    finally:
        if not finished:  # Ctrl-C, or an error of progress
            child.end()
    if ended.status != 0:
        how = f"with status {ended.status}" if ended.status > 0 else f"by signal {-ended.status}"
        last = (ended.err.strip().splitlines() or ["it printed nothing"])[-1]
        raise BakeError(
            f"the process that did the work ended {how}: {last}",
            "run the same with gf-usd in a terminal to see all of its output",
        )
    answer = exchange.read(ended.reply)
    if answer["error"] is not None:
        kind, message, hint, more = answer["error"]
        raise getattr(errors, kind)(message, hint, **more)
    return answer["value"]


def serve(request: str) -> NoReturn:
    """The process: run the task of `call`, and write its result to stdout."""
    reply = os.dup(1)
    quiet = os.open(os.devnull, os.O_RDWR)
    os.dup2(quiet, 0)
    os.dup2(2, 1)  # what libraries print is no part of the answer
    end_with_parent()
    gc.set_threshold(100_000, 20, 20)  # as the command line has it
    request_read = exchange.read(Path(request).read_bytes())
    options, stderr_lock = request_read["options"], threading.Lock()

    def progress(done: int, total: int) -> None:
        with stderr_lock:
            os.write(2, f"{DONE}{done} {total}\n".encode())

    if request_read["progress"]:
        options["progress"] = progress
    module, name = request_read["task"].split(":")
    value, error = None, None
    try:
        value = getattr(import_module(module), name)(**options)
    except GfUsdError as raised:
        more = {k: v for k, v in vars(raised).items() if k not in ("message", "hint")}
        error = (type(raised).__name__, raised.message, raised.hint, more)
    with os.fdopen(reply, "wb") as file:
        exchange.write({"value": value, "error": error}, file)
    os._exit(0)

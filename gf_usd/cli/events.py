"""Events of a bake as JSON, one object per line: ``--events``; docs/farm.md lists them."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from gf_usd.cli import exit
from gf_usd.core.errors import BakeError, GfUsdError, Unfinished, UsageError

STDOUT = "-"
FIRST = b'{"event": '  # begins each line

Emit = Callable[..., None]  # (name of the event, **its values)


@contextlib.contextmanager
def event_stream(target: str | None) -> Iterator[Emit]:
    """What writes events; how the bake within ends early is the last one.

    target : a file, which is replaced, "-" for stdout, or the number of an open file
        descriptor; None: nothing is written.

    Raises UsageError where it cannot be opened, BakeError where it takes no more.
    """
    if target is None:
        yield lambda event, **values: None
        return
    with _opened(target) as file:

        def emit(event: str, **values: object) -> None:
            line = json.dumps({"event": event, "time": round(time.time(), 3), **values})
            try:
                file.write(line + "\n")
                file.flush()
            except OSError as error:
                if file is not sys.stdout:
                    with contextlib.suppress(OSError):  # the rest of its buffer is lost
                        file.close()
                raise BakeError(
                    f"--events {target}: events cannot be written: {error.strerror}",
                    "check that it is being read and has space left",
                ) from error

        try:
            yield emit
        except (GfUsdError, SystemExit) as end:
            if not file.closed:
                with contextlib.suppress(BakeError):  # the first error is the one to report
                    _emit_end(emit, end)
            raise


def _emit_end(emit: Emit, end: GfUsdError | SystemExit) -> None:
    if isinstance(end, Unfinished):
        emit("sliced", variant=end.variant, look=end.variant, done=end.done, frames=end.frames)
    elif isinstance(end, GfUsdError):
        emit("error", status=end.exit_status, message=end.message, hint=end.hint)
    elif isinstance(end.code, int) and end.code > 128:  # a signal: see `main._stop`
        name = signal.Signals(end.code - 128).name
        emit("error", status=end.code, message=f"ended by {name}", hint=exit.message())


def _require_events(target: Path) -> None:
    """Raise UsageError for a file with other contents than events, such as the asset itself."""
    if target.is_file() and target.stat().st_size:
        with target.open("rb") as file:
            if file.read(len(FIRST)) != FIRST:
                raise UsageError(
                    f"--events {target} exists already and does not hold events",
                    "give a new file, - for stdout, or an open file descriptor",
                )


def _opened(target: str) -> contextlib.AbstractContextManager[IO[str]]:
    if target == STDOUT:
        return contextlib.nullcontext(sys.stdout)
    try:
        if target.isdigit():
            return os.fdopen(int(target), "w", encoding="utf-8")
        _require_events(Path(target))
        return open(target, "w", encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"--events {target} cannot be opened: {error.strerror}",
            "give a file in an existing folder, - for stdout, or an open file descriptor",
        ) from error

"""Handling of stdout and stderr that are closed or full, or whose reader has ended.

Messages during a bake must not end it: errors of stderr are ignored.  The result goes to stdout: a
failure to write it is an error.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

STANDARD = ("stdin", "stdout", "stderr")


def open_closed() -> None:
    """Redirect closed standard streams to the null device; called first.

    Otherwise the next opened file would get the stream's number, and the output.
    """
    for number, name in enumerate(STANDARD):
        try:
            os.fstat(number)
        except OSError:
            # numbers are given from the lowest on
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


class Stream:
    """A stream that leads nowhere from the first write on that fails.

    failed : is given the error of that, and may raise it.
    """

    def __init__(self, stream: TextIO, failed: Callable[[OSError], None]) -> None:
        self._stream, self._failed = stream, failed
        self._waits = False
        self._late: OSError | None = None

    def write(self, text: str) -> int:
        """See `TextIO`."""
        if text == "":  # how Click tries a stream, without regard for errors
            return 0
        try:
            self._stream.write(text)
        except OSError as error:
            self._lose(error)
        return len(text)

    def flush(self) -> None:
        """See `TextIO`."""
        try:
            self._stream.flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        with suppress(OSError):  # one without a number
            os.dup2(nowhere, self._stream.fileno())
            self._stream.flush()  # the rest of its buffer would fail again at exit
        os.close(nowhere)
        if self._waits:
            self._late = error
        else:
            self._failed(error)

    @contextmanager
    def failing_late(self) -> Iterator[Callable[[], None]]:
        """Within the block no write fails; the function that is given then does, if one had to."""
        self._waits = True

        def fail() -> None:
            if self._late is not None:
                self._failed(self._late)

        try:
            yield fail
        finally:
            self._waits = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def guarded() -> Iterator[list[OSError]]:
    """Guard both streams within the block; the list then holds the error of stdout, if it had one.

    That error is also raised where it happens.
    """
    broken: list[OSError] = []

    def fail(error: OSError) -> None:
        broken.append(error)
        raise error

    before = sys.stdout, sys.stderr
    sys.stdout = cast(TextIO, Stream(sys.stdout, fail))
    sys.stderr = cast(TextIO, Stream(sys.stderr, lambda error: None))
    try:
        yield broken
    finally:
        sys.stdout, sys.stderr = before


@contextmanager
def outlived() -> Iterator[Callable[[], None]]:
    """Within the block, an error of stdout, closed by its reader or full, does not end the program.

    For commands whose results are files.  The function that the block receives raises the error of
    stdout, if there was one; call it after the files are written.
    """
    if isinstance(sys.stdout, Stream):
        with sys.stdout.failing_late() as fail:
            yield fail
    else:
        yield lambda: None

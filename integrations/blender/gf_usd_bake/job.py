"""One bake, followed by its events (docs/farm.md) without waiting for it.

Nothing here knows Blender.
"""

from __future__ import annotations

import json
import queue
import subprocess
import threading
import time
from typing import IO, Any

from . import server
from .program import ProgramError, error_in, surroundings

GRACE = 20.0  # [s] that gf-usd has to stop after it is asked to: it finishes a step first
FAILED = 1  # exit status of gf-usd for a bake that broke off; 2 and 3 are refusals


class Job:
    """A running gf-usd: by the server, and where the system has none in a process of its own.

    Call `step` now and then; it returns True once the process has ended.  Then `result` holds the
    event `finished`, or `error` says why there is none.

    Parameters
    ----------
    words : that start gf-usd.
    arguments : of a bake; the option that makes it print its events is added.
    folder : that relative paths start at.

    Raises ProgramError where the process cannot be started.
    """

    def __init__(self, words: list[str], arguments: list[str], folder: str) -> None:
        self.done, self.total = 0, 0  # frames
        self.seconds_left: float | None = None
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.result: dict[str, Any] | None = None
        self.error: ProgramError | None = None
        self.canceled = False
        self.failed = False  # while it ran: what it wrote until then is there
        self._deadline = 0.0
        self._first: tuple[float, int] | None = None  # time and number of the first frame
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._printed = ""
        if server.AVAILABLE:
            bake = server.Bake(words, arguments, folder, self._lines.put)
            self._process: server.Bake | subprocess.Popen[str] = bake
            self._readers = [bake.reader]
            return
        try:
            process = subprocess.Popen(
                [*words, *arguments, "--events", "-"],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                encoding="utf-8", errors="replace", cwd=folder, env=surroundings(),
            )  # fmt: skip
        except OSError as error:
            raise ProgramError(f"{words[0]} does not run: {error}") from error
        assert process.stdout is not None
        assert process.stderr is not None
        self._process = process
        # both pipes are read at once, or a full one would stop the process
        self._readers = [
            threading.Thread(target=self._listen, args=(process.stdout,), daemon=True),
            threading.Thread(target=self._print, args=(process.stderr,), daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def share(self) -> float:
        """Of the frames that are done, 0 to 1."""
        return self.done / self.total if self.total else 0.0

    def step(self) -> bool:
        """Take in the events since the last call; whether the process has ended."""
        self._hear()
        status = self._process.poll()
        if status is None:
            if self.canceled and time.monotonic() > self._deadline:
                self._process.kill()
            return False
        for reader in self._readers:
            reader.join()
        self._hear()
        if isinstance(self._process, server.Bake):
            self._printed = self._process.printed
        self.failed = status == FAILED and not self.canceled
        if self.canceled:
            self.error = ProgramError("canceled")
        elif status and self.error is None:
            self.error = error_in(self._printed)
        elif not status and self.result is None:
            self.error = ProgramError("gf-usd ended without a result", self._printed[-200:])
        return True

    def wait(self, pause: float = 0.1) -> None:
        """Step until it is over."""
        while not self.step():
            time.sleep(pause)

    def cancel(self, grace: float = GRACE) -> None:
        """Ask the process to stop; `step` ends it where it has not done so within `grace` [s]."""
        self.canceled = True
        self._deadline = time.monotonic() + grace
        self._process.terminate()

    def _print(self, stream: IO[str]) -> None:
        with stream:
            self._printed = stream.read()

    def _listen(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                self._lines.put(line)

    def _hear(self) -> None:
        while not self._lines.empty():
            line = self._lines.get()
            try:
                event = json.loads(line)
            except json.JSONDecodeError:
                # of a program that does not know events, or was killed in the middle of one
                self.error = ProgramError(f"gf-usd printed no event: {line[:200]!r}")
                continue
            self._take(event)

    def _take(self, event: dict[str, Any]) -> None:
        what = event["event"]
        if what == "plan":
            self.seconds_left = event["estimated_seconds"]
        elif what == "frame":
            self._advance(event)
        elif what == "note":
            self.notes.append(event["message"])
        elif what == "warning":
            self.warnings.append(f"{event['message']}. {event['hint']}".strip())
        elif what == "finished":
            self.result = event
        elif what == "error":
            self.error = ProgramError(event["message"], event["hint"])

    def _advance(self, event: dict[str, Any]) -> None:
        self.done, self.total = event["done"], event["total"]
        if self._first is None:
            self._first = event["time"], self.done
            return
        began, first = self._first
        if self.done > first:
            each = (event["time"] - began) / (self.done - first)
            self.seconds_left = each * (self.total - self.done)

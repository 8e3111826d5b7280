"""A `gf-usd serve` of this Blender's own, so that the second bake starts at once (docs/farm.md).

Nothing here knows Blender.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import shutil
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .program import PATIENCE, ProgramError, error_in, surroundings

AVAILABLE = hasattr(socket, "AF_UNIX") and os.name == "posix"  # not on Windows
PARENT = "GF_USD_PARENT"  # environment variable: gf-usd ends with this process
IDLE = 1800.0  # [s] without a bake after which it ends, and frees its memory
KILLED = -9  # status of a bake whose connection was given up


class Server:
    """The server, which is started for the first bake and ends with Blender."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._words: list[str] = []
        self._process: subprocess.Popen[str] | None = None
        self._folder: Path | None = None

    def connect(self, words: list[str]) -> socket.socket:
        """A connection to the server of a gf-usd; it is started where it does not run.

        words : that start gf-usd.

        Raises ProgramError where it does not start.
        """
        with self._lock:
            if words != self._words or self._process is None or self._process.poll() is not None:
                self._stop()
                self._start(words)
            assert self._process is not None
            until = time.monotonic() + PATIENCE
            while True:
                end = socket.socket(socket.AF_UNIX)
                try:
                    end.connect(self._path)
                    return end
                except OSError:  # it does not listen yet
                    end.close()
                if self._process.poll() is not None:
                    raise error_in(self._stop())
                if time.monotonic() > until:
                    self._stop()
                    raise ProgramError(f"{words[0]} serve did not start within {PATIENCE:g} s")
                time.sleep(0.02)

    @property
    def _path(self) -> str:
        assert self._folder is not None
        return str(self._folder / "s")

    def _start(self, words: list[str]) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="gf-usd-"))  # for this user alone
        command = [*words, "serve", "--quiet", "--socket", self._path, "--idle", f"{IDLE:g}"]
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE, encoding="utf-8", errors="replace",
                env={**surroundings(), PARENT: str(os.getpid())},
            )  # fmt: skip
        except OSError as error:
            raise ProgramError(f"{words[0]} does not run: {error}") from error
        self._words = list(words)

    def stop(self) -> None:
        """End the server and the bakes that it runs; the next bake starts another."""
        with self._lock:
            self._stop()

    def _stop(self) -> str:
        """End it; returns what it printed."""
        printed = ""
        if self._process is not None:
            self._process.terminate()
            printed = self._process.communicate()[1]
        self._process, self._words = None, []
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None
        return printed


server = Server()
atexit.register(server.stop)


class Bake:
    """A bake by the server, with the methods of a process.

    Parameters
    ----------
    words : that start gf-usd.
    arguments : of gf-usd.
    folder : that relative paths start at.
    heard : called with each line of the events, in a thread.
    """

    def __init__(
        self, words: list[str], arguments: list[str], folder: str, heard: Callable[[str], None]
    ) -> None:
        self.returncode: int | None = None
        self.printed = ""  # what a process that failed printed last
        self._heard = heard
        self._end: socket.socket | None = None
        self._stopped = False
        self._request = {"arguments": arguments, "folder": folder}
        self.reader = threading.Thread(target=self._follow, args=(words,), daemon=True)
        self.reader.start()

    def poll(self) -> int | None:
        """The exit status; None while it runs."""
        return None if self.reader.is_alive() else self.returncode

    def terminate(self) -> None:
        """Ask it to stop."""
        self._shut(socket.SHUT_WR)

    def kill(self) -> None:
        """Wait for it no longer."""
        self._shut(socket.SHUT_RDWR)

    def _shut(self, how: int) -> None:
        self._stopped = True
        if self._end is not None:
            with contextlib.suppress(OSError):  # it has ended
                self._end.shutdown(how)

    def _follow(self, words: list[str]) -> None:
        status = KILLED
        try:
            with server.connect(words) as end:
                self._end = end
                if not self._stopped:
                    status = self._listen(end)
        except ProgramError as error:
            self.printed = f"Error: {error.message}\n\nhint: {error.hint}"
        except (OSError, ValueError):  # given up, or the server is gone
            self.printed = "Error: gf-usd serve ended before the bake"
        self.returncode = status

    def _listen(self, end: socket.socket) -> int:
        end.sendall(json.dumps(self._request).encode() + b"\n")
        with end.makefile("r", encoding="utf-8", errors="replace") as lines:
            for line in lines:
                event: dict[str, Any] = json.loads(line)
                if event["event"] == "ended":
                    self.printed = event["log"]
                    return int(event["status"])
                self._heard(line)
        raise OSError("the server is gone")

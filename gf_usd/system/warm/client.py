"""A client of ``gf-usd serve``."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gf_usd.core.errors import BakeError, UsageError
from gf_usd.system.warm.local_socket import connect
from gf_usd.system.warm.server import ENDED, SERVER


def events(path: Path, request: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Send a request to the server at a path; yields its events.

    Closing the iterator early ends the command.
    Raises UsageError where no server listens, BakeError where it ends before the command does.
    """
    end = connect(path)
    if end is None:
        raise UsageError(
            f"no gf-usd serve is listening at {path}",
            "start one with gf-usd serve, or bake without --serve",
        )
    last = ""
    gone = contextlib.suppress(BrokenPipeError, ConnectionResetError)
    with end, end.makefile("r", encoding="utf-8", errors="replace") as lines, gone:
        end.sendall(json.dumps(request).encode() + b"\n")
        for line in lines:
            event = json.loads(line)
            last = event["event"]
            yield event
    if last not in (ENDED, SERVER):
        raise BakeError(
            f"the server at {path} ended before the bake", "start it again: gf-usd serve"
        )


def status(path: Path, *, stop: bool = False) -> dict[str, Any] | None:
    """The status of the server at a path; None where there is none. stop : the server then ends."""
    end = connect(path)
    if end is None:
        return None
    with end:
        end.sendall(json.dumps({"ask": "stop" if stop else "status"}).encode() + b"\n")
        with end.makefile("r", encoding="utf-8") as lines:
            return json.loads(lines.readline())

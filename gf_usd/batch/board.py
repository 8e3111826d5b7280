"""Where every job of a batch stands, from the events it is told."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gf_usd.batch.job import CALM


@dataclass
class Row:
    """A job as a table shows it."""

    name: str
    state: str = "waiting"  # waiting, running, or one of job.STATES
    attempt: int = 0
    done: int = 0  # frames
    total: int = 0
    frames_per_second: float = 0.0
    seconds: float = 0.0
    began: float = 0.0
    message: str = ""

    @property
    def left(self) -> float | None:
        """[s] to its end; None while nobody knows."""
        if self.frames_per_second <= 0.0:
            return None
        return (self.total - self.done) / self.frames_per_second


class Board:
    """The rows of all jobs, and how far the whole is."""

    def __init__(
        self, names: Sequence[str], at_once: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.rows = {name: Row(name=name) for name in names}
        self._at_once, self._clock, self._began = at_once, clock, clock()

    def hear(self, event: Mapping[str, Any]) -> Row | None:
        """Take an event in; the row it is about."""
        row = self.rows.get(event.get("job", ""))
        if row is None:
            return None
        kind = event["event"]
        if row.state not in ("waiting", "running"):
            return row  # a cluster may tell what was before the end after it
        if kind == "started":
            row.state, row.attempt, row.began = "running", event["attempt"], self._clock()
            row.done, row.frames_per_second = 0, 0.0
        elif kind == "frame":
            row.state = "running"
            row.done, row.total = event["done"], event["total"]
            row.frames_per_second = event["frames_per_second"]
        elif kind == "finished":
            row.state, row.seconds = event["state"], event["seconds"]
            row.message, row.frames_per_second = event["message"], event["frames_per_second"]
        return row

    def of(self, *states: str) -> list[Row]:
        """The rows in any of these states."""
        return [row for row in self.rows.values() if row.state in states]

    @property
    def ended(self) -> list[Row]:
        """The rows that need no more time."""
        return [row for row in self.rows.values() if row.state not in ("waiting", "running")]

    @property
    def bad(self) -> list[Row]:
        """The rows that ended, and not well."""
        return [row for row in self.ended if row.state not in CALM]

    @property
    def seconds(self) -> float:
        """[s] since the start."""
        return self._clock() - self._began

    @property
    def left(self) -> float | None:
        """[s] to the end of all, from how long the others took; None before the first has."""
        took = [row.seconds for row in self.ended if row.seconds > 0.0]
        if not took:
            return None
        mean = sum(took) / len(took)
        running = sum(max(0.0, mean - self.running_for(row)) for row in self.of("running"))
        return (mean * len(self.of("waiting")) + running) / self._at_once

    @property
    def share(self) -> float:
        """Of the whole that is done, 0 to 1; frames of a running job count in part."""
        parts = (row.done / row.total for row in self.of("running") if row.total)
        return (len(self.ended) + sum(parts)) / max(1, len(self.rows))

    def running_for(self, row: Row) -> float:
        """[s] of the attempt that runs."""
        return self._clock() - row.began

"""The bake that runs, and what became of the last: of this session, never saved."""

from __future__ import annotations

from dataclasses import dataclass

from .job import Job


@dataclass
class State:
    """What the panel shows."""

    job: Job | None = None  # that runs
    message: str = ""
    hint: str = ""


state = State()

"""Long bakes in slices, so that one run of a batch has a bounded length.

A slice is a number of full value clips, after which a bake ends with its checkpoint; the next run
goes on from there.  On a farm the slices of all jobs are the parts of one bundle, each a step that
waits for the one before.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.record import read_record
from gf_usd.core.errors import UsageError
from gf_usd.prepare.options.texts import parse_frames
from gf_usd.prepare.outputs import interrupted, outputs

SETTLED = ("failed", "refused", "unsound")  # another slice would end them alike
UNTRIED = ("stopped", "busy")
PART = re.compile(r"([1-9]\d*)/([1-9]\d*)")


@dataclass(frozen=True, kw_only=True)
class Part:
    """Which slice of its jobs a run is."""

    number: int  # from 1
    of: int

    @property
    def last(self) -> bool:
        """No slice comes after it."""
        return self.number == self.of

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


def parse_part(text: str, clips: int | None) -> Part:
    """The part of "2/5".

    clips : of a slice.  Raises UsageError for what is none, or where there are no slices.
    """
    if not clips:
        raise UsageError(
            f"--part {text} is given without --slice",
            "give the number of clips per slice with --slice",
        )
    match = PART.fullmatch(text.strip())
    if match is None or int(match[1]) > int(match[2]):
        raise UsageError(f"--part is {text!r}", "give the part and the number of parts: 2/5")
    return Part(number=int(match[1]), of=int(match[2]))


def require_clips(jobs: Sequence[Job]) -> None:
    """Raise UsageError for a job that has no value clips to be sliced by."""
    for job in jobs:
        if not job.options.get("clip_frames"):
            raise UsageError(
                f"{job.name}: --slice counts value clips, but the job writes none",
                "give the number of frames per clip: --set clip_frames=24",
            )


def slices(job: Job, clips: int) -> int:
    """How many runs of so many full clips bring a job to its end, at most.

    With L looks, W frames written and n in a clip, L floor((W - 1) / n) clips become full, and the
    frames after the last of them want a run of their own where it ends a slice.

    Raises UsageError where the job does not say its frames: nobody reads the asset before.
    """
    require_clips([job])
    frames, length = job.options.get("frames"), int(job.options["clip_frames"])
    if not frames:
        raise UsageError(
            f"{job.name}: the number of slices depends on the number of frames, which is not given",
            "give it: --frames 240",
        )
    most = parse_frames(frames).frames
    if most is None:
        raise UsageError(
            f"{job.name}: the number of slices depends on when it comes to rest",
            "give the maximum number of frames: --frames rest:240",
        )
    intervals = most - 1 + 2 * int(job.options.get("handles") or 0)
    full, rest = len(job.materials) * (intervals // length), intervals % length
    return full // clips + 1 if rest else max(1, math.ceil(full / clips))


def settled(job: Job, identity: str | None) -> Outcome | None:
    """The outcome of an earlier slice that the next would only repeat; None where it goes on."""
    entry = read_record(job)
    if entry is None or identity is None or entry.get("identity") != identity:
        return None
    outcome = Outcome.of(entry["outcome"])
    return outcome if outcome.state in SETTLED and not resumable(job) else None


def spent(job: Job, identity: str | None) -> tuple[float, float]:
    """[s] of wall and of CPU time that the slices before took; 0 where there was none."""
    entry = read_record(job)
    if entry is None or identity is None or entry.get("identity") != identity:
        return 0.0, 0.0
    outcome = Outcome.of(entry["outcome"])
    if outcome.state != "sliced" or not resumable(job):
        return 0.0, 0.0
    return outcome.seconds, outcome.cpu_seconds


def resumable(job: Job) -> bool:
    """Whether a checkpoint of the job is there."""
    return interrupted(outputs(job.asset, job.looks, str(job.root)))


def faults(outcomes: Sequence[Outcome], part: Part | None) -> list[Outcome]:
    """The outcomes that make a run a failure.

    A part that is not the last fails only for jobs that another process may still do: a scheduler
    runs no step after one that failed, and no job is to keep the others from their next slice.
    The last one fails for all that is not done.
    """
    if part is None or part.last:
        return [outcome for outcome in outcomes if not outcome.good]
    return [outcome for outcome in outcomes if outcome.state in UNTRIED]


def exit_status(outcomes: Sequence[Outcome], part: Part | None) -> int:
    """0 where all is done, 5 where nothing but slices are left, 1 otherwise."""
    bad = faults(outcomes, part)
    if part is None and bad and all(outcome.state == "sliced" for outcome in bad):
        return 5
    return 1 if bad else 0

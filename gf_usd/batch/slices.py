"""Divides long bakes into slices, so that one run of a batch has a bounded length.

A slice is a number of complete value clips, after which a bake ends with its checkpoint; the next
run resumes from it.  On a farm, the slices of all jobs are the parts of one bundle, each a step
that waits for the previous one.
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
from gf_usd.prepare.outputs.outputs import interrupted, outputs

SETTLED = ("failed", "refused", "unsound")  # another slice would end the same
NOT_ATTEMPTED = ("stopped", "busy")
PART = re.compile(r"([1-9]\d*)/([1-9]\d*)")


@dataclass(frozen=True, kw_only=True)
class Part:
    """The number of a slice in a run."""

    number: int  # from 1
    of: int

    @property
    def last(self) -> bool:
        """Whether it is the last slice."""
        return self.number == self.of

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


def parse_part(text: str, clips: int | None) -> Part:
    """The part of a text such as "2/5".

    clips : of a slice.  Raises UsageError for an invalid text, or without slices.
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
    """Raise UsageError for a job without value clips."""
    for job in jobs:
        if not job.options.get("clip_frames"):
            raise UsageError(
                f"{job.name}: --slice counts value clips, but the job writes none",
                "give the number of frames per clip: --set clip_frames=24",
            )


def slice_count(job: Job, clips: int) -> int:
    """Number of runs of `clips` complete clips that complete a job, at most.

    With L variants, W frames written and n frames in a clip, L floor((W - 1) / n) clips are
    completed.  The frames after the last of them need another run where that clip ends a slice.

    Raises UsageError where the job does not give its frames, because the asset is not read here.
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


def final_outcome(job: Job, identity: str | None) -> Outcome | None:
    """The outcome of an earlier slice that another one would only repeat; None: it continues."""
    entry = read_record(job)
    if entry is None or identity is None or entry.get("identity") != identity:
        return None
    outcome = Outcome.of(entry["outcome"])
    return outcome if outcome.state in SETTLED and not resumable(job) else None


def time_spent(job: Job, identity: str | None) -> tuple[float, float]:
    """[s] wall and CPU time of earlier slices; 0 where there were none."""
    entry = read_record(job)
    if entry is None or identity is None or entry.get("identity") != identity:
        return 0.0, 0.0
    outcome = Outcome.of(entry["outcome"])
    if outcome.state != "sliced" or not resumable(job):
        return 0.0, 0.0
    return outcome.seconds, outcome.cpu_seconds


def resumable(job: Job) -> bool:
    """Whether the job has a checkpoint."""
    return interrupted(outputs(job.asset, job.variant_names, str(job.root)))


def failing_outcomes(outcomes: Sequence[Outcome], part: Part | None) -> list[Outcome]:
    """The outcomes that make a run fail.

    A part before the last one fails only for jobs that were not attempted: a scheduler runs no step
    after one that failed, and a failed job must not prevent the next slice of the others.  The last
    part fails for all jobs that are not done.
    """
    if part is None or part.last:
        return [outcome for outcome in outcomes if not outcome.good]
    return [outcome for outcome in outcomes if outcome.state in NOT_ATTEMPTED]


def exit_status(outcomes: Sequence[Outcome], part: Part | None) -> int:
    """0 where all is done, 5 where only slices remain, 1 otherwise."""
    bad = failing_outcomes(outcomes, part)
    if part is None and bad and all(outcome.state == "sliced" for outcome in bad):
        return 5
    return 1 if bad else 0

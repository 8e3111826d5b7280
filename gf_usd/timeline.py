"""Which samples are simulated, and which of them are written.

Frames are counted from 0, the body at rest where it was put, at the time code `Settings.start`.
The simulation runs from there to the last frame that is written.  With n samples per frame the
solver is asked for n times as many frames at n times the rate; sample k is frame k / n.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.errors import UsageError
from gf_usd.model import BakedFrame, GaussianPose, Health, MeshPose, Settings

if TYPE_CHECKING:
    from gf_usd.planning import Request

ROUNDING = 1e-6  # frames: time codes are typed in decimals


def sampled(settings: Settings) -> Settings:
    """The settings under which every sample is a frame: those of the solver and its inputs."""
    n = settings.samples_per_frame
    if n == 1:
        return settings
    return replace(
        settings,
        fps=settings.fps * n,
        frames=(settings.frames - 1) * n + 1,
        first=settings.first * n,
        samples_per_frame=1,
    )


def written(settings: Settings) -> int:
    """Number of frames written, those that hold the rest pose included."""
    return settings.frames - settings.first


def parse_range(text: str) -> tuple[float | None, float | None]:
    """Time codes of "10:20", "10:" or ":20"; None where the range is open.

    Raises UsageError for anything else.
    """
    first, colon, last = text.partition(":")
    try:
        low = float(first) if first.strip() else None
        high = float(last) if last.strip() else None
    except ValueError:
        low = high = np.nan
    finite = all(code is None or np.isfinite(code) for code in (low, high))
    ordered = low is None or high is None or low <= high
    if not (colon and finite and ordered):
        raise UsageError(f"--range is {text!r}", "give two time codes FIRST:LAST; 10: is open")
    return low, high


def span(request: Request, start: float, step: float, frames: int) -> tuple[int, int]:
    """(first frame that is written, number of frames simulated) with range and handles.

    Parameters
    ----------
    start : time code of frame 0; step : time codes per frame.
    frames : of the bake without a range.

    A first frame below 0 holds the rest pose.  Raises UsageError for a range outside the bake.
    """
    first, last = 0, frames - 1
    if request.range is not None:
        low, high = parse_range(request.range)
        if low is not None:
            first = int(np.ceil((low - start) / step - ROUNDING))
        if high is not None:
            last = int(np.floor((high - start) / step + ROUNDING))
        _require_inside(request, first, last, start, step, frames)
    return first - (request.handles or 0), last + 1 + (request.handles or 0)


def _require_inside(
    request: Request, first: int, last: int, start: float, step: float, frames: int
) -> None:
    said = f"--range {request.range}"
    if first < 0:
        raise UsageError(
            f"{said} begins before the simulation, which starts at time code {start:g}",
            "start later; --handles holds the rest pose before the start",
        )
    if last < first:
        raise UsageError(
            f"{said} holds no frame: frames are at {start:g} + k * {step:g}",
            "give a range with a frame in it",
        )
    if request.frames and last > frames - 1:
        raise UsageError(
            f"{said} ends after the last of --frames {frames}, at time code"
            f" {start + (frames - 1) * step:g}",
            "leave --frames out: the range says how long is simulated",
        )


def with_held(samples: Iterable[BakedFrame], settings: Settings) -> Iterator[BakedFrame]:
    """The samples, with those before the start that are written: the first pose, standing still.

    settings : as `sampled`.
    """
    for sample in samples:
        if sample.index == 0:
            for index in range(settings.first, 0):
                yield _standing(sample, index, settings.time_code(index))
        yield sample


def _standing(first: BakedFrame, index: int, time_code: float) -> BakedFrame:
    def stop(pose: MeshPose | GaussianPose) -> MeshPose | GaussianPose:
        return replace(pose, velocities=np.zeros_like(pose.velocities))

    nothing = (0.0, 0.0, 0.0)
    return replace(
        first,
        index=index,
        time_code=time_code,
        meshes={path: stop(pose) for path, pose in first.meshes.items()},
        gaussians=stop(first.gaussians),
        health=replace(first.health, kinetic=0.0, momentum=nothing, angular_momentum=nothing),
    )


SUMS = ("substeps", "friction_capped", "rollbacks", "work", "injected")
MOSTS = (
    *("penetration", "overlap", "let_go", "max_J", "max_stretch", "inverted", "clamped"),
    "stress_capped",
    "flying",
    "sleeping",
)
LEASTS = ("min_J", "min_stretch")


def joined(samples: Sequence[Health]) -> Health:
    """The health of a frame from that of its samples, the last of which is at its time.

    Counts and work add up, extremes are those of all samples, the rest is the state at the end.
    """
    rows = ((SUMS, sum), (MOSTS, max), (LEASTS, min))
    values = {
        name: how(getattr(sample, name) for sample in samples)
        for names, how in rows
        for name in names
    }
    return replace(samples[-1], **values)

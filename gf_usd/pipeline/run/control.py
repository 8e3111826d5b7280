"""What watches and limits a bake while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gf_usd.pipeline.checkpoint import CheckpointWriter
from gf_usd.pipeline.cost.forecast import Forecast, Stages

Progress = Callable[[int, int], None]  # (frames done, frames in all)


@dataclass(frozen=True, kw_only=True)
class Control:
    """What watches and limits a bake while it runs; all variants share it."""

    progress: Progress | None
    checkpoints: CheckpointWriter
    forecast: Forecast
    stages: Stages

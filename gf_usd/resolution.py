"""How finely a body is filled: by a spacing or by a count, from the options or from the stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gf_usd import body_materials
from gf_usd.planning import DEFAULT_PARTICLES, PAPER_PARTICLES, Request
from gf_usd.stage_reading import StageWords


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """What is asked for."""

    spacing: float | None  # [m]; None: by the count
    particles: int  # that hold where there is no spacing
    note: str = ""


def resolution(
    request: Request, words: StageWords, unit: float, volumes: Callable[[], Mapping[str, float]]
) -> Resolution:
    """An option wins over what the stage says, and that over the defaults.

    unit : [m] of the stage's; volumes : [m^3] of each surface, by prim path, asked where needed.
    """
    paper = request.preset == "paper"
    particles = request.particles or (PAPER_PARTICLES if paper else DEFAULT_PARTICLES)
    spacing, note = request.spacing * unit if request.spacing else None, ""
    if spacing is None and request.particles is None and not paper:
        spacing, note = body_materials.stated_spacing(words, volumes())
    return Resolution(spacing=spacing, particles=particles, note=note)

"""From what a person asked to `Settings` with nothing left open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gf_usd.errors import UsageError
from gf_usd.materials import FILTER_RATE, G0, SHOT_LENGTH, time_scale
from gf_usd.model import Floats, Settings, StageFacts

DEFAULT_PARTICLES = 8000  # quality and time: a duck looks smooth and bakes in seconds
DEFAULT_FPS = 24.0
DEFAULT_DROP = "3r"


@dataclass(frozen=True, kw_only=True)
class Request:
    """The options of a bake as asked; None where nothing was said."""

    particles: int | None = None
    spacing: float | None = None  # [stage units]
    frames: int | None = None
    fps: float | None = None
    start: float | None = None  # time code
    drop: str | None = None  # "3r" or a length in stage units
    gravity: str | None = None  # "9.81" along -up, or "x,y,z" [m/s^2]
    seed: int = 0
    device: str = "cpu"
    threads: int | None = None

    def check(self) -> None:
        """Raise UsageError for values that make no sense, before anything is read."""
        _positive("--particles", self.particles)
        _positive("--spacing", self.spacing)
        _positive("--frames", self.frames)
        _positive("--fps", self.fps)
        _positive("--threads", self.threads)
        if self.particles and self.spacing:
            raise UsageError(
                f"--particles {self.particles} and --spacing {self.spacing:g} were both given",
                "give one: the number of particles follows from the spacing",
            )
        if self.device not in ("cpu", "cuda"):
            raise UsageError(f"there is no device {self.device!r}", "choose cpu or cuda")
        if self.seed < 0:
            raise UsageError(f"--seed is {self.seed}", "give a number of 0 or more")
        if self.start is not None and not np.isfinite(self.start):
            raise UsageError(f"--start is {self.start}", "give a finite time code")
        parse_length("--drop", self.drop or DEFAULT_DROP, 1.0, 1.0)
        parse_gravity(self.gravity, np.array([0.0, 1.0, 0.0]))


def resolve(request: Request, facts: StageFacts, radius: float, lowest: float) -> Settings:
    """Settings of a bake.

    radius : r = (3 V / 4 pi)^(1/3) [m]; lowest : height of the asset's lowest point [m].
    """
    fps = request.fps or facts.time_codes_per_second or DEFAULT_FPS
    authored = facts.time_codes_per_second
    drop = request.drop or ("0" if facts.says_physics else DEFAULT_DROP)
    height = parse_length("--drop", drop, radius, facts.units.length)
    T = time_scale(radius)
    frames = request.frames or int(np.ceil(SHOT_LENGTH * T * fps)) + 1
    start = request.start if request.start is not None else facts.start_time_code
    return Settings(
        frames=frames,
        fps=fps,
        time_codes_per_second=authored or fps,
        start=1.0 if start is None else start,
        gravity=parse_gravity(request.gravity, facts.up),
        up=(float(facts.up[0]), float(facts.up[1]), float(facts.up[2])),
        floor=0.0,
        lift=tuple(float(x) for x in (height - lowest) * facts.up),  # type: ignore[arg-type]
        seed=request.seed,
        filter_rate=FILTER_RATE / T,
        device=request.device,
        threads=request.threads,
    )


def parse_length(option: str, text: str, radius: float, unit: float) -> float:
    """Metres of "2.5" (stage units) or "3r" (radii)."""
    body, scale = (text[:-1], radius) if text.endswith("r") else (text, unit)
    value = _number(option, body, "a length such as 2.5 (stage units) or 3r (radii of the body)")
    if value < 0.0:
        raise UsageError(f"{option} is {text}", "give a length of 0 or more")
    return value * scale


def parse_gravity(text: str | None, up: Floats) -> tuple[float, float, float]:
    """[m/s^2] of "9.81" (along minus up) or "x,y,z"."""
    parts = str(G0 if text is None else text).split(",")
    what = "9.81 (m/s^2, downward) or three numbers x,y,z"
    if len(parts) not in (1, 3):
        raise UsageError(f"--gravity is {text!r}", f"give {what}")
    values = np.array([_number("--gravity", part, what) for part in parts])
    g = -values[0] * up if len(values) == 1 else values
    return (float(g[0]) + 0.0, float(g[1]) + 0.0, float(g[2]) + 0.0)


def _number(option: str, text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise UsageError(f"{option}: {text!r} is no number", f"give {what}")
    return value


def _positive(option: str, value: float | None) -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise UsageError(f"{option} is {value:g}", "give a number above 0")

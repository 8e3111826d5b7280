"""The option values of ``preview``: sizes, spans and ranges, and which options can be combined."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gf_usd.core.errors import UsageError
from gf_usd.core.units import code_text
from gf_usd.prepare.options import values

FILMS = (".mp4", ".gif")
SUFFIXES = (".png", *FILMS)
# where --size is not given: a picture, a film for a page, a tile of a sheet
SIZES = {".png": (960, 720), ".mp4": (960, 720), ".gif": (480, 360)}
TILE = (320, 240)
MOST_FRAMES = 100_000


@dataclass(frozen=True, kw_only=True)
class Options:
    """The requested output, as far as it can be checked before the stage is opened."""

    target: Path
    size: tuple[int, int]  # (width, height) [pixels] of a picture, a frame or a tile
    frame: float | None  # time code of a single picture
    span: Span | None  # of a film or a sheet; None: the whole motion
    sheet: int | None  # number of tiles
    columns: int | None
    fps: float | None
    limits: tuple[float, float] | None  # range of the colors

    @property
    def film(self) -> bool:
        """True for mp4 and gif."""
        return self.target.suffix.lower() in FILMS


@dataclass(frozen=True, kw_only=True)
class Span:
    """Time codes from first to last; None: from the start, to the end, a frame at a time."""

    first: float | None
    last: float | None
    step: float | None


def read_options(
    target: Path,
    *,
    size: str | None,
    frame: float | None,
    frames: str | None,
    sheet: int | None,
    columns: int | None,
    fps: float | None,
    color: str | None,
    limits: str | None,
) -> Options:
    """The checked options.  Raises UsageError for invalid values and combinations."""
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(
            f"{target} does not end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}",
            "preview writes images as .png and films as .mp4 or .gif: -o out.png",
        )
    film = suffix in FILMS
    _refuse(sheet is not None and film, f"--sheet writes a PNG, not {target.name}", "-o out.png")
    many = film or sheet is not None
    for given, name, needed, hint in (
        (frame is not None, "--frame", not many, "use --time-codes A:B for films and sheets"),
        (frames is not None, "--time-codes", many, "use --frame for a single image, or --sheet 12"),
        (fps is not None, "--fps", film, "write a film: -o out.mp4"),
        (columns is not None, "--columns", sheet is not None, "make a sheet: --sheet 12"),
        (
            limits is not None,
            "--color-range",
            color is not None,
            "give --color strain, elastic, plastic or stress",
        ),
    ):
        _refuse(given and not needed, f"{name} does not apply to the other options", hint)
    for value, name in ((sheet, "--sheet"), (columns, "--columns")):
        _refuse(value is not None and value < 1, f"{name} {value} is too small", "give 1 or more")
    _refuse(
        fps is not None and not (math.isfinite(fps) and 0.0 < fps <= 1000.0),
        f"--fps {fps} is not a frame rate",
        "give frames per second above 0, at most 1000",
    )
    default = TILE if sheet is not None else SIZES[suffix]
    return Options(
        target=target,
        size=default if size is None else parse_size(size),
        frame=frame,
        span=None if frames is None else parse_span(frames),
        sheet=sheet,
        columns=columns,
        fps=fps,
        limits=None if limits is None else parse_limits(limits),
    )


def joined(name: str, value: Any, sign: str, counts: tuple[int, ...]) -> str:
    """Numbers of Python as the command line has them, with a sign between; texts are theirs.

    Raises UsageError for anything else, and for another count of numbers.
    """
    if isinstance(value, str):
        return value
    wanted = f"{' or '.join(map(str, counts))} numbers, such as ({', '.join('1' * counts[0])})"
    parts = values.items(name, value, wanted)
    sound = all(part is None or values.is_number(part) for part in parts)
    if len(parts) not in counts or not sound:
        raise values.refuse(name, value, wanted)
    return sign.join("" if part is None else values.digits(part) for part in parts)


def _refuse(wrong: bool, message: str, hint: str) -> None:
    if wrong:
        raise UsageError(message, hint)


def parse_size(text: str) -> tuple[int, int]:
    """ "640x480" -> (640, 480).

    Raises UsageError for anything else; the renderer holds the limits.
    """
    match = re.fullmatch(r"\s*(\d{1,6})\s*[xX×]\s*(\d{1,6})\s*", text)
    if match is None or 0 in (int(match[1]), int(match[2])):
        raise UsageError(f"--size {text} is not a size", "give width x height, e.g. --size 640x480")
    return int(match[1]), int(match[2])


def parse_span(text: str) -> Span:
    """ "1:24", "1:24:2", "10:" or ":24" in time codes, the last one included.

    Raises UsageError for anything else.
    """
    hint = "give time codes as FIRST:LAST or FIRST:LAST:STEP, e.g. --time-codes 1:24:2"
    parts = text.split(":")
    _refuse(len(parts) not in (2, 3), f"--time-codes {text} is not a range", hint)
    numbers = [_number(part, f"--time-codes {text} is not a range", hint) for part in parts]
    first, last, step = (*numbers, None)[:3]
    _refuse(step is not None and step <= 0.0, f"--time-codes {text}: the step is not above 0", hint)
    backwards = first is not None and last is not None and last < first
    _refuse(backwards, f"--time-codes {text} ends before it begins", hint)
    return Span(first=first, last=last, step=step)


def parse_limits(text: str) -> tuple[float, float]:
    """ "0:0.5" -> (0.0, 0.5).  Raises UsageError for anything else, and for an empty range."""
    hint = "give it as LOW:HIGH, in pascals for stress, e.g. --color-range 0:0.5"
    parts = text.split(":")
    _refuse(len(parts) != 2, f"--color-range {text} is not a range", hint)
    low, high = (_number(part, f"--color-range {text} is not a range", hint) for part in parts)
    if low is None or high is None or not low < high:
        raise UsageError(f"--color-range {text} is empty", hint)
    return low, high


def _number(text: str, message: str, hint: str) -> float | None:
    """None where nothing is written."""
    if not text.strip():
        return None
    try:
        value = float(text)
    except ValueError:
        raise UsageError(message, hint) from None
    _refuse(not math.isfinite(value), message, hint)
    return value


def time_codes(span: Span | None, known: tuple[float, ...], step: float, path: Path) -> list[float]:
    """The time codes of a film's frames.

    Parameters
    ----------
    known : time codes at which the stage has samples.
    step : time codes from a frame of playback to the next.

    Raises
    ------
    UsageError : the stage does not move, the span leaves its motion, or has too many frames.
    """
    _refuse(
        len(known) < 2,
        f"{path} does not move",
        "render a single image: -o out.png, without --sheet",
    )
    span = span or Span(first=None, last=None, step=None)
    first = known[0] if span.first is None else span.first
    last = known[-1] if span.last is None else span.last
    _refuse(
        first < known[0] or last > known[-1] or last < first,
        f"--time-codes {code_text(first)}:{code_text(last)} is outside the motion of {path}",
        f"its time codes run from {code_text(known[0])} to {code_text(known[-1])}",
    )
    count = math.floor((last - first) / (span.step or step) + 1e-6) + 1
    _refuse(
        count > MOST_FRAMES,
        f"{count} frames are more than the limit of {MOST_FRAMES}",
        "give a shorter range or a larger step: --time-codes FIRST:LAST:STEP",
    )
    return [first + i * (span.step or step) for i in range(count)]

"""Parses the texts of options.

The values do not depend on the asset: lengths are in stage units, directions do not assume an up
axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from gf_usd.core.errors import UsageError
from gf_usd.core.units import STRONGEST, Precision, number, positive
from gf_usd.prepare.options.fields import GravityKeys, is_key_file, read_gravity_keys

LONGEST = 1e9  # of a fall, in stage units or radii: a faster one has no step
NONE = "none"
AUTO = "auto"
UPRIGHT = 0.1  # least part of a floor's normal along the up axis

Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Height:
    """A length, in stage units or in radii of the body."""

    value: float
    in_radii: bool

    def meters(self, radius: float, unit: float) -> float:
        """[m] on a body of radius [m] in a stage of unit [m]."""
        return self.value * (radius if self.in_radii else unit)


@dataclass(frozen=True, kw_only=True)
class Floor:
    """A plane."""

    text: str  # as given
    height: float | None = 0.0  # [stage units] of where it meets the up axis; None: no floor
    normal: Triple | None = None  # not zero, of any length; None: the up axis

    def require_upright(self, slope: float) -> None:
        """Raise UsageError for a normal that is too far from the up axis."""
        if slope <= UPRIGHT:
            raise UsageError(
                f"--floor {self.text}: the normal {self.text.rpartition(':')[2]} does not point up",
                f"give {FLOOR}",
            )


FLOOR = "none, a height such as 0.5 (stage units), a normal x,y,z, or both: 0.5:0.2,1,0"


def parse_time_scale(text: str) -> float | str:
    """Simulated seconds per second of playback, or "auto"."""
    if text == AUTO:
        return text
    value = number("--time-scale", text, "a number such as 0.2 (five times slower), or auto")
    if value <= 0.0:
        raise UsageError(f"--time-scale is {text}", "give a number above 0, or auto")
    positive("--time-scale", value)
    return value


def parse_edge_length(text: str) -> float | str:
    """A length in stage units, or "auto"."""
    if text == AUTO:
        return text
    value = number("--max-edge-length", text, "a length such as 0.1 (stage units), or auto")
    if not 0.0 < value < math.inf:
        raise UsageError(f"--max-edge-length is {text}", "give a length above 0, or auto")
    return value


REST = "rest"
FRAMES = "give a whole number such as 48, rest, or rest:480 for 480 at most"


@dataclass(frozen=True, kw_only=True)
class Length:
    """The length of the simulation."""

    frames: int | None  # at most, where it ends at rest; None: by the size of the body
    rest: bool  # until everything is at rest


def parse_frames(text: str | int) -> Length:
    """The length of "48", "rest" or "rest:480"."""
    word, colon, most = str(text).partition(":")
    rest = word == REST
    count = most if rest else str(text)
    if rest and not colon:
        return Length(frames=None, rest=True)
    try:
        frames = int(count)
    except ValueError as error:
        raise UsageError(f"--frames is {text}", FRAMES) from error
    positive("--frames", frames)
    return Length(frames=frames, rest=rest)


MOST_CYCLES = 16  # that --loop auto simulates


@dataclass(frozen=True, kw_only=True)
class Cycles:
    """The number of simulated cycles."""

    times: int  # at most, where it ends by itself
    until_periodic: bool = False  # until it is periodic, and once more

    @property
    def repeats(self) -> int:
        """Cycles before the written one, at most."""
        return self.times - 1


def parse_loop(text: str | int) -> Cycles:
    """The cycles of "4" or "auto".  Raises UsageError for anything else."""
    if text == AUTO:
        return Cycles(times=MOST_CYCLES, until_periodic=True)
    try:
        times = int(text)
    except ValueError as error:
        raise UsageError(
            f"--loop is {text!r}", "give a number of times, or auto: until it is periodic"
        ) from error
    positive("--loop", times)
    return Cycles(times=times)


def parse_drop(text: str) -> Height:
    """The height of "2.5" (stage units) or "3r" (radii)."""
    in_radii = text.endswith("r")
    value = number(
        "--drop",
        text[:-1] if in_radii else text,
        "a length such as 2.5 (stage units) or 3r (radii of the body)",
    )
    if value < 0.0:
        raise UsageError(f"--drop is {text}", "give a length of 0 or more")
    if value > LONGEST:
        raise UsageError(f"--drop is {text}", f"give a length of up to {LONGEST:g}")
    return Height(value=value, in_radii=in_radii)


def parse_floor(text: str) -> Floor:
    """The floor of "none", "1.5" (height), "x,y,z" (normal) or "1.5:x,y,z".

    Raises UsageError for anything else, and for a normal that points up along no axis of USD.
    """
    if text == NONE:
        return Floor(text=text, height=None)
    height, _, direction = text.rpartition(":") if "," in text else (text, "", "")
    normal = None
    if direction:
        parts = direction.split(",")
        if len(parts) != 3:
            raise UsageError(f"--floor is {text!r}", f"give {FLOOR}")
        x, y, z = normal = _triple([number("--floor", part, FLOOR) for part in parts])
        length = math.hypot(x, y, z)
        Floor(text=text).require_upright(max(y, z) / length if length else 0.0)
    at = number("--floor", height, FLOOR) if height else 0.0
    return Floor(text=text, height=at, normal=normal)


def _triple(values: list[float]) -> Triple:
    x, y, z = values
    return x, y, z


def parse_gravity(text: str) -> float | Triple | GravityKeys:
    """[m/s^2] of "9.81" (along minus up) or "x,y,z"; the keys of a file that is named."""
    if is_key_file(text):
        return read_gravity_keys(Path(text))
    parts = text.split(",")
    what = "9.81 (m/s^2, downward), three numbers x,y,z, or a .csv or .txt file"
    if len(parts) not in (1, 3):
        raise UsageError(f"--gravity is {text!r}", f"give {what}")
    values = [number("--gravity", part, what) for part in parts]
    if max(abs(value) for value in values) > STRONGEST:
        raise UsageError(f"--gravity is {text}", f"give at most {STRONGEST:g} m/s^2")
    return values[0] if len(values) == 1 else _triple(values)


FASTEST = 1e9  # of a velocity or a spin, in units a second


def parse_velocity(text: str) -> Triple:
    """[stage units/s] of "x,y,z".  Raises UsageError for anything else."""
    return _motion("--velocity", text, "stage units per second")


def parse_spin(text: str) -> Triple:
    """[degrees/s] of "x,y,z".  Raises UsageError for anything else."""
    return _motion("--spin", text, "degrees per second")


def _motion(option: str, text: str, unit: str) -> Triple:
    wanted = f"three numbers x,y,z ({unit})"
    parts = text.split(",")
    if len(parts) != 3:
        raise UsageError(f"{option} is {text!r}", f"give {wanted}")
    found = _triple([number(option, part, wanted) for part in parts])
    if max(map(abs, found)) > FASTEST:
        raise UsageError(f"{option} is {text}", f"give at most {FASTEST:g} {unit}")
    return found


def parse_range(text: str) -> tuple[float | None, float | None]:
    """Time codes of "10:20", "10:" or ":20"; None where the range is open.

    Raises UsageError for anything else.
    """
    first, colon, last = text.partition(":")
    try:
        low = float(first) if first.strip() else None
        high = float(last) if last.strip() else None
    except ValueError:
        low = high = math.nan
    finite = all(code is None or math.isfinite(code) for code in (low, high))
    ordered = low is None or high is None or low <= high
    if not (colon and finite and ordered):
        raise UsageError(
            f"--range is {text!r}",
            "give two time codes FIRST:LAST, the smaller one first; 10: is open",
        )
    return low, high


def parse_clamp(text: str) -> tuple[float, float] | None:
    """Limits of the singular values of F, of "0.2:5"; None for "none"."""
    if text == NONE:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = math.nan
    if not 0.0 < low < 1.0 < high < math.inf:
        raise UsageError(
            f"--clamp is {text!r}", "give two stretches about 1, such as 0.2:5, or none"
        )
    return low, high


def parse_cap(text: str) -> float | None:
    """[Pa] of "2e4"; None for "none"."""
    if text == NONE:
        return None
    try:
        cap = float(text)
    except ValueError:
        cap = math.nan
    if not 0.0 < cap < math.inf:
        raise UsageError(f"--stress-cap is {text!r}", "give a stress above 0 [Pa], or none")
    return cap


def parse_only(text: str) -> tuple[str, ...]:
    """The shapes of "mesh" or "gaussians,points", in the order of SHAPES.

    Raises UsageError for words that are none of them.
    """
    from gf_usd.core.frames.choices import SHAPES

    words = [word.strip() for word in text.split(",")]
    for word in words:
        if word not in SHAPES:
            raise UsageError(
                f"--only {text}: there is no {word!r}",
                f"give one or more of {', '.join(SHAPES)}, with commas between",
            )
    return tuple(shape for shape in SHAPES if shape in words)


LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
COARSEST = 0.1  # share of the radius: with a larger error it is another motion


def parse_precision(text: str) -> Precision:
    """Tolerance of stored values, from "0.5%" of the radius, "0.2mm", "1cm" or "0.001m".

    Raises UsageError for anything else, and for more than a tenth of the radius.
    """
    hint = "give a share of the radius or a length: --precision 0.5%, --precision 0.2mm"
    plain = text.strip().lower()
    unit = next((unit for unit in ("%", *LENGTHS) if plain.endswith(unit)), "")
    if not unit:
        raise UsageError(f"--precision {text!r} has no unit", hint)
    try:
        value = float(plain.removesuffix(unit))
    except ValueError as error:
        raise UsageError(f"--precision {text!r} is not a length", hint) from error
    value *= 0.01 if unit == "%" else LENGTHS[unit]
    if not (math.isfinite(value) and value > 0.0):
        raise UsageError(f"--precision {text!r} is not a length above 0", hint)
    if unit == "%" and value > COARSEST:
        raise UsageError(
            f"--precision {text} is more than {100 * COARSEST:g} % of the radius", hint
        )
    return Precision(value=value, relative=unit == "%")

"""Conversion between stage units and SI, which happens only here.

A stage measures length in units of ``meters_per_unit`` [m] and mass in units of
``kilograms_per_unit`` [kg]; inside the program everything is SI.

Numbers from options, or a UsageError that shows the expected form; numbers of bytes as text.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gf_usd.core.errors import UsageError

LEAST, MOST = 1e-30, 1e30  # of a length: its cube and the ratio of two stay numbers

PLAUSIBLE = (0.02, 20.0)  # [m] width of the things people make soft: a grape to a lorry
# [m] of a file that names none, in the order in which they are tried: printers take millimeters.
USUAL_UNITS = (1.0, 0.01, 0.001)
PRINTED_UNITS = (1.0, 0.001, 0.01)

STRONGEST = 1e9  # [m/s^2] of gravity: a stronger one has no step


@dataclass(frozen=True, kw_only=True)
class Precision:
    """The allowed error of stored values: a length, or a fraction of the radius of each body."""

    value: float  # [m], or a share
    relative: bool

    def meters(self, radius: float) -> float:
        """[m] for a body of this radius [m]."""
        return self.value * radius if self.relative else self.value

    @property
    def text(self) -> str:
        """As text, for notes."""
        return f"{100.0 * self.value:g} % of the radius" if self.relative else f"{self.value:g} m"


@dataclass(frozen=True, kw_only=True)
class StageUnits:
    """Sizes of the units of a stage.  Multiply a stage value by the property to get SI."""

    meters_per_unit: float = 1.0
    kilograms_per_unit: float = 1.0

    @property
    def length(self) -> float:
        """[m] per stage length."""
        return self.meters_per_unit

    @property
    def volume(self) -> float:
        """[m^3] per stage volume."""
        return self.meters_per_unit**3

    @property
    def mass(self) -> float:
        """[kg] per stage mass."""
        return self.kilograms_per_unit

    @property
    def density(self) -> float:
        """[kg/m^3] per stage density."""
        return self.kilograms_per_unit / self.meters_per_unit**3

    @property
    def pressure(self) -> float:
        """[Pa] per stage pressure: E[Pa] = E[stage] * kilogramsPerUnit / metersPerUnit."""
        return self.kilograms_per_unit / self.meters_per_unit

    def factor(self, unit: str) -> float:
        """[unit] per stage unit, of a unit in SI; seconds are seconds."""
        return {"": 1.0, "s": 1.0, "1/s": 1.0, "Pa": self.pressure, "Pa s": self.pressure}[unit]


def plausible_unit(width: float, usual: tuple[float, ...] = USUAL_UNITS) -> float:
    """[m] the first usual unit in which so many units are a PLAUSIBLE width; else the first."""
    low, high = PLAUSIBLE
    return next((unit for unit in usual if low <= width * unit <= high), usual[0])


# From which length [m] on, per meter, and the name.
LENGTHS = (
    (1e3, 1e-3, "km"),
    (1.0, 1.0, "m"),
    (1e-2, 1e2, "cm"),
    (1e-3, 1e3, "mm"),
    (0.0, 1e6, "µm"),
)


def bytes_text(count: float) -> str:
    """A number of bytes to three significant digits, in B, kB, MB or GB (powers of 1000)."""
    value = float(count)
    for unit in ("B", "kB", "MB"):
        if value < 999.5:  # rounds to at most 999
            return f"{value:.3g} {unit}"
        value /= 1000.0
    return f"{value:.3g} GB" if value < 999.5 else f"{value:.0f} GB"


def code_text(code: float) -> str:
    """A time code to five decimals, without an exponent: 1000000 is not 1e+06."""
    return f"{round(code, 5) + 0.0:.15g}"  # without the sign of -0


def length_unit(meters: float) -> tuple[float, str]:
    """How many of the unit that fits a length are a meter, and its name; m for 0."""
    if meters == 0.0:
        return 1.0, "m"
    near = (unit for unit in LENGTHS if abs(meters) >= 0.9995 * unit[0])  # rounds to its start
    _, scale, name = next(near, LENGTHS[-1])
    return scale, name


def length_text(meters: float) -> str:
    """A length to three significant digits, in µm, mm, cm, m or km; 0 in m."""
    scale, name = length_unit(meters)
    value = scale * meters
    return f"{value:.3g} {name}" if abs(value) < 999.5 else f"{value:.0f} {name}"


# Below which volume [m^3], per cubic meter, and the name.
VOLUMES = ((1e-6, 1e9, "mm³"), (1e-2, 1e6, "cm³"))


def volume_text(cubic_meters: float) -> str:
    """A volume to three significant digits, in mm³, cm³ or m³; up to 1e9 m³ without an exponent."""
    small = (unit for unit in VOLUMES if cubic_meters < unit[0])
    _, scale, name = next(small, (math.inf, 1.0, "m³"))
    return f"{number_text(scale * cubic_meters)} {name}"


def number_text(value: float) -> str:
    """A number to three significant digits; from 1000 to 1e9 without an exponent."""
    return _rounded(value, 3)


def rounded_text(value: float) -> str:
    """A number to two significant digits; from 100 to 1e9 without an exponent."""
    return _rounded(value, 2)


def _rounded(value: float, digits: int) -> str:
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if 10.0**digits <= abs(float(text)) < 1e9 else text


def percent_text(share: float) -> str:
    """A share in percent, to two significant digits: 100 %, not 1e+02 %."""
    return f"{rounded_text(100.0 * share)} %"


def check_unit(meters_per_unit: float | None) -> None:
    """Raise UsageError for an option that is no size of a unit."""
    if meters_per_unit is not None and not LEAST < meters_per_unit < MOST:
        raise UsageError(
            f"--meters-per-unit {meters_per_unit:g} is not a size",
            "give the size of the file's unit in meters, e.g. 0.01 for centimeters",
        )


def number(option: str, text: str, what: str) -> float:
    """A finite number from text; what : it should have been, for the hint."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option}: {text!r} is not a number", f"give {what}")
    return value


def positive(option: str, value: float | None) -> None:
    """Raise UsageError unless a number is above 0 and of a size that can be worked with."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise UsageError(f"{option} is {value:g}", "give a number above 0")
    if value is not None and not LEAST < value < MOST:
        raise UsageError(f"{option} is {value:g}", f"give a number from {LEAST:g} to {MOST:g}")

"""Round numbers for a scale, and how they are written."""

from __future__ import annotations

import math

PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"))
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # of a scale, times a power of ten


def ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Up to `most` multiples of a round step within low..high, with the ends where they are round.

    Fewer than two where the range is empty: then the two ends.
    """
    span = high - low
    if not (math.isfinite(span) and span > 0.0):
        return [low]
    power = 10.0 ** math.floor(math.log10(span / max(1, most - 1)))
    for step in (factor * power for factor in (*STEPS, 20.0)):
        first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
        if last - first + 1 <= most:
            found = [i * step for i in range(first, last + 1)]
            return found if len(found) > 1 else [low, high]
    return [low, high]


def rounded_up(value: float) -> float:
    """The next number above `value` (> 0) whose two leading digits are all it has; 0 stays 0."""
    if not (math.isfinite(value) and value > 0.0):
        return 0.0
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / power - 1e-9) * power


def prefix(largest: float, unit: str) -> tuple[float, str]:
    """Divisor and unit that suit numbers up to `largest`; a pure number stays as it is."""
    if not unit:
        return 1.0, ""
    for size, sign in PREFIXES:
        if abs(largest) >= size:
            return size, f"{sign}{unit}"
    return 1.0, unit


def written(value: float) -> str:
    """Up to three digits, and no exponent below 100,000."""
    text = f"{value:.3g}" if abs(value) < 1e3 or abs(value) >= 1e5 else f"{value:.0f}"
    return "0" if float(text) == 0.0 else text

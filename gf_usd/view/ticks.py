"""Tick values of axes, and the formatting of numbers with SI prefixes."""

from __future__ import annotations

import math

PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"))
TICK_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # times a power of ten


def ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Tick values: up to `most` multiples of a round step within low..high.

    Both ends where fewer than two multiples are in the range; low alone for an empty range.
    """
    span = high - low
    if not (math.isfinite(span) and span > 0.0):
        return [low]
    power = 10.0 ** math.floor(math.log10(span / max(1, most - 1)))
    for step in (factor * power for factor in (*TICK_STEPS, 20.0)):
        first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
        if last - first + 1 <= most:
            found = [i * step for i in range(first, last + 1)]
            return found if len(found) > 1 else [low, high]
    return [low, high]


def round_up(value: float) -> float:
    """`value` rounded up to two significant digits; 0 for values that are not positive."""
    if not (math.isfinite(value) and value > 0.0):
        return 0.0
    power = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / power - 1e-9) * power


def si_prefix(largest: float, unit: str) -> tuple[float, str]:
    """Divisor and prefixed unit for numbers up to `largest`; 1 and "" for pure numbers."""
    if not unit:
        return 1.0, ""
    for factor, letter in PREFIXES:
        if abs(largest) >= factor:
            return factor, f"{letter}{unit}"
    return 1.0, unit


def format_number(value: float) -> str:
    """Up to three significant digits, without an exponent below 100,000."""
    text = f"{value:.3g}" if abs(value) < 1e3 or abs(value) >= 1e5 else f"{value:.0f}"
    return "0" if float(text) == 0.0 else text

"""Numbers out of options, or a UsageError that says what a right one looks like."""

from __future__ import annotations

import math

from gf_usd.errors import UsageError
from gf_usd.units import LEAST, MOST


def number(option: str, text: str, what: str) -> float:
    """A finite number out of words; what : it should have been, for the hint."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option}: {text!r} is no number", f"give {what}")
    return value


def positive(option: str, value: float | None) -> None:
    """Raise UsageError unless a number is above 0 and of a size that can be worked with."""
    if value is not None and not (math.isfinite(value) and value > 0):
        raise UsageError(f"{option} is {value:g}", "give a number above 0")
    if value is not None and not LEAST < value < MOST:
        raise UsageError(f"{option} is {value:g}", f"give a number from {LEAST:g} to {MOST:g}")

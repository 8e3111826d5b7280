"""Where a bake begins and how its time codes run, where the source leaves it open.

The rest pose, the physics, the pins and the settings of a bake all ask here, so that the first
frame is the source at one and the same time.
"""

from __future__ import annotations

from gf_usd.model import StageFacts

FIRST = 1.0  # the time code of the first frame where neither the source nor the user says one
USD_RATE = 24.0  # what USD takes for the time codes per second of a file that says none


def first_time_code(facts: StageFacts, asked: float | None = None) -> float:
    """The time code asked for, else the source's startTimeCode, else 1."""
    if asked is not None:
        return asked
    return FIRST if facts.start_time_code is None else facts.start_time_code


def authored_rate(facts: StageFacts) -> float | None:
    """Time codes per second that a bake must keep; None where no time sample depends on them."""
    if facts.time_codes_per_second is None and facts.animated:
        return USD_RATE
    return facts.time_codes_per_second

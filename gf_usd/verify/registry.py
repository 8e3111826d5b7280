"""All cases, in the order of the table."""

from __future__ import annotations

from gf_usd.verify import (
    bar,
    cantilever,
    drop,
    flight,
    floor,
    law,
    locking,
    manufactured,
    patch,
    sides,
    vertical,
)
from gf_usd.verify.case import Case

CASES: tuple[Case, ...] = (
    *flight.CASES,
    *patch.CASES,
    *law.CASES,
    *bar.CASES,
    *vertical.CASES,
    *cantilever.CASES,
    *locking.CASES,
    *manufactured.CASES,
    *floor.CASES,
    *drop.CASES,
    *sides.CASES,
)

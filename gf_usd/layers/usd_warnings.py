"""USD's warnings, which go to the terminal line by line: gathered, counted and told once."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager

from pxr import UsdUtils

SHOWN = 2  # kinds that a note quotes
# What tells one stage from another with the same fault.
PLACE = re.compile(r"\s*\((re)?(composing|instantiating)[^()]*( stage on stage [^()]*)?\)\s*$")


class Warned:
    """What USD warned of so far."""

    def __init__(self) -> None:
        self._delegate: UsdUtils.CoalescingDiagnosticDelegate | None = (
            UsdUtils.CoalescingDiagnosticDelegate()
        )
        self._said: Counter[str] = Counter()

    @property
    def said(self) -> Counter[str]:
        """How often USD said what."""
        for one in self._delegate.TakeUncoalescedDiagnostics() if self._delegate else ():
            self._said[_kind(one.commentary)] += 1
        return self._said

    def end(self) -> None:
        """From here on the terminal has USD's words again."""
        _ = self.said
        self._delegate = None

    def lines(self, told: Collection[str] = ()) -> tuple[str, ...]:
        """One note on the warnings that were not told yet; none where there is nothing."""
        said = self.said
        kinds = sorted(text for text in said if text not in told)
        if not kinds:
            return ()
        count = sum(said[text] for text in kinds)
        quoted = "; ".join(kinds[:SHOWN])
        times = "once" if count == 1 else f"{count} times"
        more = f"; and {len(kinds) - SHOWN} more" if len(kinds) > SHOWN else ""
        return (f"USD warned {times}: {quoted}{more}",)


@contextmanager
def gathered() -> Iterator[Warned]:
    """Keep USD's warnings from the terminal: what is yielded has them."""
    found = Warned()
    try:
        yield found
    finally:
        found.end()


def _kind(text: str) -> str:
    return PLACE.sub("", " ".join(text.split()))

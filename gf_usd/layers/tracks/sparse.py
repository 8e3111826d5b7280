"""Which samples a cache needs: those between which USD's interpolation is off by too much.

Prims that move as one have their samples at the same times, so that their arrays stay shared and
what is made of several of them fits together.  From a sample that is kept, the next one is the
farthest that can be had with every sample between within what is allowed (see `accuracy`): the
first that fails ends it.  It is found as frames come, in a window of a few samples; at the end of
one in which nothing moved, the prim is held: the sample is repeated only once it moves again.
What is as the asset says from the start is held without a first sample, and has none if it never
moves.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pxr import Sdf

from gf_usd.core.arrays import Floats
from gf_usd.layers.tracks.accuracy import Allowed, off, rows_of

Values = Mapping[Sdf.Path, Any]
Kept = tuple[float, Values]  # a time code and the samples at it


@dataclass(frozen=True)
class _Sample:
    time: float
    values: Values
    rows: Mapping[str, np.ndarray]
    turn: Floats


@dataclass
class Tally:
    """What leaving samples out came to, of prims that move as one."""

    samples: int = 0  # that there were
    kept: int = 0
    bytes: int = 0  # of the arrays of all samples; what equals the one before counts once
    written: int = 0  # of the arrays that are kept
    largest: dict[str, float] = field(default_factory=dict)  # errors, as `accuracy.off` has them

    def note(self, errors: Mapping[str, float]) -> None:
        """Take errors into the largest ones."""
        for kind, error in errors.items():
            self.largest[kind] = max(self.largest.get(kind, 0.0), error)


class Sparse:
    """The samples of prims that move as one.

    Parameters
    ----------
    allowed : what a sample that is left out may be off by.
    window : samples that are held at most, and the longest gap in motion.
    turn : gives (3, 3) from the space of the prims to the world at a time code, for rows.
    tally : of a bake that is gone on with.
    rest : what the asset says at all times, of all the arrays; None: it does not.
    """

    def __init__(
        self,
        allowed: Allowed,
        window: int,
        turn: Callable[[float], Floats],
        tally: Tally | None = None,
        rest: Values | None = None,
    ) -> None:
        self.tally = tally or Tally()
        self._rest = rest
        self._allowed, self._most, self._turn = allowed, max(2, window), turn
        self._start: _Sample | None = None
        self._window: list[_Sample] = []
        self._errors: list[dict[str, float]] = []  # of the window but its last, on a line to it
        self._held: float | None = None  # time code of the last sample of a hold
        self._before: Values = {}  # the last sample that came
        self._written: Values = {}  # the last that was kept

    def begin(self, time_code: float, values: Values) -> None:
        """Go on from a sample that is written already, at the end of a clip."""
        self._start = self._sample(time_code, values)
        self._before = self._written = values

    def take(self, time_code: float, values: Values, *, last: bool = False) -> Iterator[Kept]:
        """Samples to write, now that another one is there.

        last : write it in any case; what comes then goes on from it.
        """
        self.tally.samples += 1
        self.tally.bytes += _new_bytes(values, self._before)
        self._before = values
        now = self._sample(time_code, values)
        if self._start is None:
            if not last and self._unmoved(now):
                self._held = time_code
                return
            self._start = now
            yield self._keep(now)
            return
        yield from self._next(now)
        if last:
            yield from self._end_held()
            yield from self._cut()
            self._before = self._written

    def close(self) -> Iterator[Kept]:
        """The samples that are still to be written; what is held to the end is not repeated."""
        if self._window and self._still(self._window):
            self._window = []
        yield from self._cut()
        self._held = None

    def _next(self, now: _Sample) -> Iterator[Kept]:
        if self._held is not None:
            if self._still([now]):
                self._held = now.time
                return
            yield from self._end_held()
        errors = self._between(self._window, now)
        if errors is None:
            yield from self._cut()
            errors = []
        self._window.append(now)
        self._errors = errors
        if len(self._window) < self._most:
            return
        if self._still(self._window):
            self._held, self._window = now.time, []
        else:
            yield from self._cut()

    def _between(self, window: Sequence[_Sample], now: _Sample) -> list[dict[str, float]] | None:
        """Errors of a window on the line from the start to a sample; None: it cannot be."""
        assert self._start is not None
        a, found = self._start, []
        # the middle of the window is most likely to be off
        for one in sorted(window, key=lambda x: abs(x.time - 0.5 * (a.time + now.time))):
            s = (one.time - a.time) / (now.time - a.time)
            errors = off(a.rows, now.rows, one.rows, s, self._allowed, one.turn)
            if np.inf in errors.values():
                return None
            found.append(errors)
        return found

    def _unmoved(self, first: _Sample) -> bool:
        """Whether what the asset says stands for the first sample, and is the start then."""
        if self._rest is None:
            return False
        start = self._sample(first.time, self._rest)
        if {k: v.shape for k, v in start.rows.items()} != {
            k: v.shape for k, v in first.rows.items()
        }:
            return False
        self._start = start
        if self._still([first]):
            return True
        self._start = None
        return False

    def _still(self, samples: Sequence[_Sample]) -> bool:
        """Whether the start stands for these samples; their errors are noted if it does."""
        assert self._start is not None
        rows, found = self._start.rows, []
        for one in samples:
            errors = off(rows, rows, one.rows, 0.0, self._allowed, one.turn)
            if np.inf in errors.values():
                return False
            found.append(errors)
        for errors in found:
            self.tally.note(errors)
        return True

    def _cut(self) -> Iterator[Kept]:
        """Keep the last sample of the window."""
        if self._window:
            for errors in self._errors:
                self.tally.note(errors)
            self._start, self._window, self._errors = self._window[-1], [], []
            yield self._keep(self._start)

    def _end_held(self) -> Iterator[Kept]:
        """Repeat the start where a hold ended."""
        if self._held is not None:
            assert self._start is not None
            self._start = self._sample(self._held, self._start.values)
            self._held = None
            yield self._keep(self._start)

    def _keep(self, one: _Sample) -> Kept:
        self.tally.kept += 1
        self.tally.written += _new_bytes(one.values, self._written)
        self._written = one.values
        return one.time, one.values

    def _sample(self, time_code: float, values: Values) -> _Sample:
        return _Sample(time_code, values, rows_of(values), self._turn(time_code))


@dataclass
class Saved:
    """[bytes] of the arrays of an attribute, or what a choice saves of them.

    Equal ones in a row are stored once.
    """

    bytes: int = 0
    digest: str = ""  # of the last array

    def count(self, array: np.ndarray, size: int) -> None:
        """Add so many bytes for an array, unless it equals the one before."""
        digest = hashlib.blake2b(np.ascontiguousarray(array).data, digest_size=8).hexdigest()
        if digest != self.digest:
            self.bytes, self.digest = self.bytes + size, digest


def _new_bytes(values: Values, before: Values) -> int:
    """[bytes] of arrays that a crate does not have yet: it stores equal ones once."""
    unique: list[np.ndarray] = []
    for path, value in values.items():
        array = np.asarray(value)
        known = [np.asarray(before[path])] if path in before else []
        if not any(_same(array, other) for other in (*known, *unique)):
            unique.append(array)
    return sum(array.nbytes for array in unique)


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and np.array_equal(a, b)

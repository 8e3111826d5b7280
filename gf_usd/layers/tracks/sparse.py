"""Selects the samples that a cache needs: USD's interpolation must be accurate in between.

Prims that move together have samples at the same times, so that they can share arrays.  The sample
after a kept one is the farthest for which the interpolation error of every sample in between is
within its tolerance (see `accuracy`), up to the first that is not.  It is found while frames
arrive, in a window of a few samples.  After a window without motion the prim is held: the last held
sample is written only once the prim moves again.  A prim that starts as the asset has it needs no
first sample, and no sample at all if it never moves.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pxr import Sdf

from gf_usd.core.arrays import Floats
from gf_usd.layers.tracks.accuracy import Allowed, interpolation_errors, rows_of

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
    """Statistics of the samples of prims that move together."""

    samples: int = 0  # before selection
    kept: int = 0
    bytes: int = 0  # of the arrays of all samples; repeated arrays count once
    written: int = 0  # of the arrays that are kept
    largest: dict[str, float] = field(
        default_factory=dict
    )  # errors of `accuracy.interpolation_errors`

    def note(self, errors: Mapping[str, float]) -> None:
        """Update the largest errors."""
        for kind, error in errors.items():
            self.largest[kind] = max(self.largest.get(kind, 0.0), error)


class Sparse:
    """Selects the samples of prims that move together.

    Parameters
    ----------
    allowed : tolerances of a sample that is left out.
    window : number of samples that are buffered at most, and the longest gap in motion.
    turn : (3, 3) from the space of the prims to the world at a time code, for rows.
    tally : of a resumed bake.
    rest : the asset's constant values of all the arrays; None: it has none.
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
        self._errors: list[
            dict[str, float]
        ] = []  # of the window's samples, interpolated to its last one
        self._held: float | None = None  # time code of the last held sample
        self._before: Values = {}  # the last sample
        self._written: Values = {}  # the last kept sample

    def begin(self, time_code: float, values: Values) -> None:
        """Continue from a written sample, at the end of a clip."""
        self._start = self._sample(time_code, values)
        self._before = self._written = values

    def take(self, time_code: float, values: Values, *, last: bool = False) -> Iterator[Kept]:
        """Add a sample; yields the samples to write.

        last : write this sample in any case; later ones are selected relative to it.
        """
        self.tally.samples += 1
        self.tally.bytes += _new_bytes(values, self._before)
        self._before = values
        now = self._sample(time_code, values)
        if self._start is None:
            if not last and self._rest_applies(now):
                self._held = time_code
                return
            self._start = now
            yield self._keep(now)
            return
        yield from self._next(now)
        if last:
            yield from self._end_held()
            yield from self._keep_last()
            self._before = self._written

    def close(self) -> Iterator[Kept]:
        """The remaining samples to write; a hold at the end needs none."""
        if self._window and self._is_held(self._window):
            self._window = []
        yield from self._keep_last()
        self._held = None

    def _next(self, now: _Sample) -> Iterator[Kept]:
        if self._held is not None:
            if self._is_held([now]):
                self._held = now.time
                return
            yield from self._end_held()
        errors = self._between(self._window, now)
        if errors is None:
            yield from self._keep_last()
            errors = []
        self._window.append(now)
        self._errors = errors
        if len(self._window) < self._most:
            return
        if self._is_held(self._window):
            self._held, self._window = now.time, []
        else:
            yield from self._keep_last()

    def _between(self, window: Sequence[_Sample], now: _Sample) -> list[dict[str, float]] | None:
        """Errors of a window, interpolated from the start to a sample; None: one exceeds its
        tolerance.
        """
        assert self._start is not None
        a, found = self._start, []
        # the middle of the window is likely to have the largest error
        for one in sorted(window, key=lambda x: abs(x.time - 0.5 * (a.time + now.time))):
            s = (one.time - a.time) / (now.time - a.time)
            errors = interpolation_errors(a.rows, now.rows, one.rows, s, self._allowed, one.turn)
            if np.inf in errors.values():
                return None
            found.append(errors)
        return found

    def _rest_applies(self, first: _Sample) -> bool:
        """Whether the asset's values equal the first sample; they are then the start."""
        if self._rest is None:
            return False
        start = self._sample(first.time, self._rest)
        if {k: v.shape for k, v in start.rows.items()} != {
            k: v.shape for k, v in first.rows.items()
        }:
            return False
        self._start = start
        if self._is_held([first]):
            return True
        self._start = None
        return False

    def _is_held(self, samples: Sequence[_Sample]) -> bool:
        """Whether these samples equal the start, within tolerance; if so, their errors are
        recorded.
        """
        assert self._start is not None
        rows, found = self._start.rows, []
        for one in samples:
            errors = interpolation_errors(rows, rows, one.rows, 0.0, self._allowed, one.turn)
            if np.inf in errors.values():
                return False
            found.append(errors)
        for errors in found:
            self.tally.note(errors)
        return True

    def _keep_last(self) -> Iterator[Kept]:
        """Keep the last sample of the window."""
        if self._window:
            for errors in self._errors:
                self.tally.note(errors)
            self._start, self._window, self._errors = self._window[-1], [], []
            yield self._keep(self._start)

    def _end_held(self) -> Iterator[Kept]:
        """Write the start again at the end of a hold."""
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
    """[bytes] of the arrays of an attribute, or those saved by a choice.

    Consecutive equal arrays are stored once.
    """

    bytes: int = 0
    digest: str = ""  # of the last array

    def count(self, array: np.ndarray, size: int) -> None:
        """Add the bytes of an array, unless it equals the previous one."""
        digest = hashlib.blake2b(np.ascontiguousarray(array).data, digest_size=8).hexdigest()
        if digest != self.digest:
            self.bytes, self.digest = self.bytes + size, digest


def _new_bytes(values: Values, before: Values) -> int:
    """[bytes] of arrays that are not yet in the crate file, which stores equal ones once."""
    unique: list[np.ndarray] = []
    for path, value in values.items():
        array = np.asarray(value)
        known = [np.asarray(before[path])] if path in before else []
        if not any(_same(array, other) for other in (*known, *unique)):
            unique.append(array)
    return sum(array.nbytes for array in unique)


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and np.array_equal(a, b)

"""Nonlinear least squares over simulations, in coordinates of 0..1: deterministic, few evaluations.

A design of points that fill the cube (the Halton sequence without scrambling) finds where to begin.
From the best of them the method of trust-region reflective steps (scipy.optimize.least_squares
[Branch, Coleman and Li 1999]) minimizes

    1/2 |r(z)|^2 + 1/2 |(z - z0) / s|^2

with the whitened residuals r and a wide prior, mean z0 and standard deviation s, that keeps in
place what the residuals say nothing of.  No derivative is asked for: Jacobians are differences over
steps that are longer than the noise which rounding and whole numbers of substeps make.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from gf_usd.core.arrays import Floats

STEP = 0.01  # of differences: 7 % of a modulus between bounds three decades apart
PRIOR = 0.5  # standard deviation: half of what lies between the bounds
DESIGN = 6  # points of the design for each unknown
APART = 0.1  # points to begin from that are nearer to each other lead to the same minimum
LOCAL = 2  # points to begin from
BATCH = 8  # points of the design between two looks at the clock
MOST = 30  # steps from each of them
TOLERANCE = 1e-3  # of z, where a search has converged: 0.7 % of a modulus, before the last step
ENOUGH = 0.01  # standard deviations left in the mean: nothing better can be told from it
POLISH = 4  # last steps at most, a simulation each
SMALL = 0.01  # of a standard deviation: such a last step is not taken
FAILED = 1e3  # of each residual where a simulation fails: worse than any that does not

# Residuals (m,) at each of several points (n,); None where a simulation failed.  It raises
# OutOfTime when the time is over, unless the flag says that the answer is needed all the same.
Evaluate: TypeAlias = Callable[[Sequence[Floats], bool], Sequence[Floats | None]]


class OutOfTime(Exception):
    """The time for the search is over."""


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """Where the search ended."""

    z: Floats  # (n,)
    residual: Floats  # (m,) whitened, there
    jacobian: Floats  # (m, n) of the residuals, by central differences
    converged: bool  # False: the time limit was reached first


class _Enough(Exception):
    """What is left is far below the standard deviations."""


class NothingRuns(Exception):
    """Every simulation of the design failed."""


def search(evaluate: Evaluate, start: Floats, *, design: int | None = None) -> Minimum:
    """Minimize the sum of the squares of the residuals, and of the prior about `start`.

    start : (n,) mean of the prior, and the first point of the design; design : its other points,
    None: DESIGN for each unknown.

    Raises NothingRuns where no simulation succeeds.
    """
    known = _Known(evaluate, start)
    converged = True
    try:
        known.at([start], late=True)
        points = _halton(len(start), DESIGN * len(start) if design is None else design)
        for first in range(0, len(points), BATCH):
            known.at(points[first : first + BATCH])
        begin = known.best(LOCAL)
        threads = ThreadPoolExecutor(len(begin))
        try:
            for done in [threads.submit(_descend, known, z) for z in begin]:
                done.result()
        finally:  # an interrupt does not wait for what the others do
            threads.shutdown(wait=False, cancel_futures=True)
    except OutOfTime:
        converged = False
    return _polished(known, converged=converged)


class _Known:
    """The points that were evaluated, in the order of their numbers."""

    def __init__(self, evaluate: Evaluate, start: Floats) -> None:
        self._evaluate, self.start = evaluate, start
        self._rows: dict[tuple[float, ...], Floats | None] = {}
        self._count = 0

    def at(self, points: Sequence[Floats], *, late: bool = False) -> list[Floats | None]:
        """Residuals (m,) of each point; None where it fails."""
        new = {key: z for z in points if (key := tuple(map(float, z))) not in self._rows}
        found = self._evaluate(list(new.values()), late) if new else []
        self._rows.update(zip(new, found, strict=True))
        self._count = max([self._count, *(len(row) for row in found if row is not None)])
        return [self._rows[tuple(map(float, z))] for z in points]

    def whole(self, points: Sequence[Floats]) -> list[Floats]:
        """Residuals with those of the prior (m + n,) of each point, large where it fails."""
        rows = self.at(points)
        return [
            np.concatenate([np.full(self._count, FAILED) if row is None else row, self._prior(z)])
            for z, row in zip(points, rows)
        ]

    def _prior(self, z: Floats) -> Floats:
        return (z - self.start) / PRIOR

    def best(self, count: int) -> list[Floats]:
        """Points of least cost that are apart from each other, the best first."""
        ran = [np.array(key) for key, row in self._rows.items() if row is not None]
        if not ran:
            raise NothingRuns
        cost = {tuple(z): float(np.sum(self.whole([z])[0] ** 2)) for z in ran}
        chosen: list[Floats] = []
        for z in sorted(ran, key=lambda z: (cost[tuple(z)], tuple(z))):
            if all(np.abs(z - other).max() > APART for other in chosen):
                chosen.append(z)
        return chosen[:count]


def _halton(dimensions: int, count: int) -> list[Floats]:
    from scipy.stats import qmc

    # the first point of the sequence is a corner
    return list(qmc.Halton(dimensions, scramble=False).random(count + 1)[1:])


def _descend(known: _Known, start: Floats) -> None:
    from scipy.optimize import least_squares

    def left(z: Floats) -> Floats:
        row = known.whole([z])[0]
        if np.mean(row[: -len(z)] ** 2) < ENOUGH**2:
            raise _Enough
        return row

    differences: Any = partial(_one_sided, known)  # scipy's types know its own only
    with suppress(_Enough):
        least_squares(
            left, start, jac=differences, bounds=(0.0, 1.0), method="trf", xtol=TOLERANCE,
            ftol=1e-5, gtol=1e-12, max_nfev=MOST,
        )  # fmt: skip


def _one_sided(known: _Known, z: Floats) -> Floats:
    """(m + n, n) by differences into the cube."""
    steps = np.where(z + STEP <= 1.0, STEP, -STEP)
    here, *there = known.whole([z, *(z + np.diag(steps))])
    return np.stack([(row - here) / step for row, step in zip(there, steps)], axis=1)


def _central(known: _Known, z: Floats) -> Floats:
    """(m, n) of the residuals without the prior's, by central differences where there is room."""
    up, down = np.minimum(z + STEP, 1.0), np.maximum(z - STEP, 0.0)
    ends = [np.where(np.arange(len(z)) == k, e, z) for k in range(len(z)) for e in (up, down)]
    rows = known.at([z, *ends], late=True)
    here, columns = rows[0], []
    assert here is not None
    for k in range(len(z)):
        above, below = rows[1 + 2 * k], rows[2 + 2 * k]
        high, low = (up[k], above), (down[k], below)
        if above is None:
            high = (z[k], here)
        if below is None:
            low = (z[k], here)
        span = high[0] - low[0]
        assert high[1] is not None
        assert low[1] is not None
        columns.append((high[1] - low[1]) / span if span > 0.0 else np.zeros_like(here))
    return np.stack(columns, axis=1)


def _polished(known: _Known, *, converged: bool) -> Minimum:
    """The best point, after Gauss-Newton steps with the central Jacobian as long as they help.

    Intervals may be narrower than TOLERANCE: the steps end where they are a small part of those.
    """
    (z,) = known.best(1)
    jacobian = _central(known, z)
    normal = jacobian.T @ jacobian + np.eye(len(z)) / PRIOR**2
    for _ in range(POLISH):
        (residual,) = known.at([z])
        assert residual is not None  # a minimum is a point that ran
        gradient = jacobian.T @ residual + (z - known.start) / PRIOR**2
        step = np.linalg.solve(normal, gradient)
        if step @ normal @ step < SMALL**2 * max(1.0, float(np.mean(residual**2))):
            break
        known.at([np.clip(z - step, 0.0, 1.0)], late=True)
        (better,) = known.best(1)
        if np.array_equal(better, z):
            break
        z = better
    (residual,) = known.at([z])
    assert residual is not None
    return Minimum(z=z, residual=residual, jacobian=jacobian, converged=converged)

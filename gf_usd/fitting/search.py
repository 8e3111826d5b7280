"""Nonlinear least squares with simulations as the model; deterministic, with few evaluations.

Unknowns have coordinates z in 0..1.  A space-filling design (the Halton sequence without
scrambling) gives the starting points.  From the best of them the trust-region reflective method
(scipy.optimize.least_squares [Branch, Coleman and Li 1999]) minimizes

    1/2 |r(z)|^2 + 1/2 |(z - z0) / s|^2

with the whitened residuals r and a wide prior of mean z0 and standard deviation s, which
regularizes unknowns that the residuals do not determine.  Jacobians are finite differences; their
step is larger than the noise due to rounding and to integer numbers of substeps.
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

STEP = 0.01  # of finite differences: 7 % of a modulus with bounds three decades apart
PRIOR = 0.5  # standard deviation: half of the range between the bounds
DESIGN = 6  # points of the design per unknown
MIN_SEPARATION = 0.1  # of starting points: closer ones lead to the same minimum
LOCAL_STARTS = 2  # number of starting points
BATCH = 8  # points of the design between two checks of the time limit
MAX_ITERATIONS = 30  # from each starting point
TOLERANCE = 1e-3  # of z at convergence: 0.7 % of a modulus, before the Newton steps
NEGLIGIBLE_RESIDUAL = 0.01  # [standard deviations] rms at which a search stops
MAX_NEWTON_STEPS = 4  # after the search, each with one simulation
MIN_NEWTON_STEP = 0.01  # [standard deviations] smaller steps are not taken
FAILURE_RESIDUAL = 1e3  # of each residual of a failed simulation: larger than real ones

# Residuals (m,) at each of several points (n,); None where a simulation failed.  Raises OutOfTime
# after the time limit, unless the flag is set.
Evaluate: TypeAlias = Callable[[Sequence[Floats], bool], Sequence[Floats | None]]


class OutOfTime(Exception):
    """The time limit of the search is exceeded."""


@dataclass(frozen=True, kw_only=True)
class Minimum:
    """The result of a search."""

    z: Floats  # (n,)
    residual: Floats  # (m,) whitened residuals at z
    jacobian: Floats  # (m, n) of the residuals, by central differences
    converged: bool  # False: the time limit was reached first


class _ResidualNegligible(Exception):
    """The residuals are far below the standard deviations."""


class AllSimulationsFailed(Exception):
    """All simulations of the design failed."""


def search(evaluate: Evaluate, start: Floats, *, design: int | None = None) -> Minimum:
    """Minimize the objective of this module.

    start : (n,) mean of the prior, and the first point of the design.
    design : number of its other points; None: DESIGN per unknown.

    Raises AllSimulationsFailed where no simulation of the design succeeds.
    """
    evaluated = _EvaluatedPoints(evaluate, start)
    converged = True
    try:
        evaluated.evaluate([start], late=True)
        points = _halton(len(start), DESIGN * len(start) if design is None else design)
        for first in range(0, len(points), BATCH):
            evaluated.evaluate(points[first : first + BATCH])
        starts = evaluated.best(LOCAL_STARTS)
        threads = ThreadPoolExecutor(len(starts))
        try:
            for done in [threads.submit(_minimize_from, evaluated, z) for z in starts]:
                done.result()
        finally:  # an interrupt does not wait for the other threads
            threads.shutdown(wait=False, cancel_futures=True)
    except OutOfTime:
        converged = False
    return _refine(evaluated, converged=converged)


class _EvaluatedPoints:
    """A cache of residuals at the evaluated points."""

    def __init__(self, evaluate: Evaluate, start: Floats) -> None:
        self._evaluate, self.start = evaluate, start
        self._rows: dict[tuple[float, ...], Floats | None] = {}
        self._count = 0

    def evaluate(self, points: Sequence[Floats], *, late: bool = False) -> list[Floats | None]:
        """Residuals (m,) at each point; None where the simulation failed."""
        new = {key: z for z in points if (key := tuple(map(float, z))) not in self._rows}
        found = self._evaluate(list(new.values()), late) if new else []
        self._rows.update(zip(new, found, strict=True))
        self._count = max([self._count, *(len(row) for row in found if row is not None)])
        return [self._rows[tuple(map(float, z))] for z in points]

    def with_prior(self, points: Sequence[Floats]) -> list[Floats]:
        """Residuals with those of the prior (m + n,); FAILURE_RESIDUAL for failed simulations."""
        rows = self.evaluate(points)
        failed = np.full(self._count, FAILURE_RESIDUAL)
        return [
            np.concatenate([failed if row is None else row, self._prior_residual(z)])
            for z, row in zip(points, rows)
        ]

    def _prior_residual(self, z: Floats) -> Floats:
        return (z - self.start) / PRIOR

    def best(self, count: int) -> list[Floats]:
        """Points of lowest cost with distances above MIN_SEPARATION, the best first."""
        successful = [np.array(key) for key, row in self._rows.items() if row is not None]
        if not successful:
            raise AllSimulationsFailed
        cost = {tuple(z): float(np.sum(self.with_prior([z])[0] ** 2)) for z in successful}
        chosen: list[Floats] = []
        for z in sorted(successful, key=lambda z: (cost[tuple(z)], tuple(z))):
            if all(np.abs(z - other).max() > MIN_SEPARATION for other in chosen):
                chosen.append(z)
        return chosen[:count]


def _halton(dimensions: int, count: int) -> list[Floats]:
    from scipy.stats import qmc

    # the first point of the sequence is a corner of the cube
    return list(qmc.Halton(dimensions, scramble=False).random(count + 1)[1:])


def _minimize_from(evaluated: _EvaluatedPoints, start: Floats) -> None:
    from scipy.optimize import least_squares

    def residual_with_prior(z: Floats) -> Floats:
        row = evaluated.with_prior([z])[0]
        if np.mean(row[: -len(z)] ** 2) < NEGLIGIBLE_RESIDUAL**2:
            raise _ResidualNegligible
        return row

    differences: Any = partial(_one_sided_jacobian, evaluated)  # SciPy's types exclude callables
    with suppress(_ResidualNegligible):
        least_squares(
            residual_with_prior, start, jac=differences, bounds=(0.0, 1.0), method="trf",
            xtol=TOLERANCE,
            ftol=1e-5, gtol=1e-12, max_nfev=MAX_ITERATIONS,
        )  # fmt: skip


def _one_sided_jacobian(evaluated: _EvaluatedPoints, z: Floats) -> Floats:
    """Jacobian (m + n, n) by one-sided differences that stay inside 0..1."""
    steps = np.where(z + STEP <= 1.0, STEP, -STEP)
    base, *shifted = evaluated.with_prior([z, *(z + np.diag(steps))])
    return np.stack([(row - base) / step for row, step in zip(shifted, steps)], axis=1)


def _central_jacobian(evaluated: _EvaluatedPoints, z: Floats) -> Floats:
    """Jacobian (m, n) without the prior, by central differences, one-sided at bounds."""
    up, down = np.minimum(z + STEP, 1.0), np.maximum(z - STEP, 0.0)
    shifted_points = [
        np.where(np.arange(len(z)) == k, e, z) for k in range(len(z)) for e in (up, down)
    ]
    rows = evaluated.evaluate([z, *shifted_points], late=True)
    base, columns = rows[0], []
    assert base is not None
    for k in range(len(z)):
        above, below = rows[1 + 2 * k], rows[2 + 2 * k]
        high, low = (up[k], above), (down[k], below)
        if above is None:
            high = (z[k], base)
        if below is None:
            low = (z[k], base)
        span = high[0] - low[0]
        assert high[1] is not None
        assert low[1] is not None
        columns.append((high[1] - low[1]) / span if span > 0.0 else np.zeros_like(base))
    return np.stack(columns, axis=1)


def _refine(evaluated: _EvaluatedPoints, *, converged: bool) -> Minimum:
    """Refine the best point by Gauss-Newton steps with the central Jacobian while they improve it.

    Intervals may be narrower than TOLERANCE; steps end where they are small relative to these.
    """
    (z,) = evaluated.best(1)
    jacobian = _central_jacobian(evaluated, z)
    normal = jacobian.T @ jacobian + np.eye(len(z)) / PRIOR**2
    for _ in range(MAX_NEWTON_STEPS):
        (residual,) = evaluated.evaluate([z])
        assert residual is not None  # the best point is one that succeeded
        gradient = jacobian.T @ residual + (z - evaluated.start) / PRIOR**2
        step = np.linalg.solve(normal, gradient)
        if step @ normal @ step < MIN_NEWTON_STEP**2 * max(1.0, float(np.mean(residual**2))):
            break
        evaluated.evaluate([np.clip(z - step, 0.0, 1.0)], late=True)
        (better,) = evaluated.best(1)
        if np.array_equal(better, z):
            break
        z = better
    (residual,) = evaluated.evaluate([z])
    assert residual is not None
    return Minimum(z=z, residual=residual, jacobian=jacobian, converged=converged)

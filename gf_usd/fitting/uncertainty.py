"""How well residuals determine unknowns: intervals, sensitivities, what cannot be told.

With the whitened residuals r (m,) and their Jacobian J (m, n) at the minimum, in coordinates whose
prior has the standard deviation s, the covariance is (J^T J / q + 1 / s^2)^-1.  Its factor q, the
noise over what was stated, is |r|^2 / (m - k) with k directions that the residuals determine.

Errors of a model are not independent: where a simulation is off it is off for neighbors and for a
while.  Where residuals belong to points and times, the sandwich

    C = B M B,   B = (J^T J + 1 / s^2)^-1,   M = sum over clusters of (J_c^T r_c)(J_c^T r_c)^T

[Liang and Zeger 1986] counts each cluster once; M is that of points plus that of times less that of
single residuals [Cameron, Gelbach and Miller 2011].  The larger of the two variances holds.

The singular values S of J tell what is determined: along a right singular vector the standard
deviation is sqrt(q) / S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints

LEVEL = 0.95  # of the intervals
# Half an interval, of what lies between the bounds: what is wider tells little more than they do.
USELESS = 0.25
# Noise over what was assumed: no simulation is right to 0.1 % of a number or of the radius, and
# differences of single precision over a step show no more.
LEAST = 0.1
# Of the largest singular value: the error of differences over steps, of which smaller ones consist.
# Where two unknowns act as one the rest was 5e-4 and 1.8e-3 of it (a ball, its density and its
# modulus, at two revisions).
ERROR = 3e-3
PART = 0.3  # of a unit vector: unknowns that take part in a direction


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """What residuals tell of n unknowns, in coordinates of 0..1."""

    half: Floats  # (n,) half of the intervals at LEVEL
    identifiable: tuple[bool, ...]  # (n,)
    singular: Floats  # (n,) singular values of J over the noise, descending
    directions: Floats  # (n, n) a row for each, unit
    noise: float  # sqrt(q): scatter of the residuals over the stated standard deviations
    correlation: Floats  # (n, n) of the estimates

    @property
    def undetermined(self) -> tuple[tuple[tuple[int, ...], Floats], ...]:
        """Directions (n,) that are not determined, each with the numbers of its unknowns."""
        return tuple(
            (tuple(np.flatnonzero(np.abs(row) > PART).tolist()), row)
            for s, row in zip(self.singular, self.directions)
            if _quantile(np.inf) > USELESS * s
        )


def uncertainty(
    jacobian: Floats,
    residual: Floats,
    clusters: Sequence[Ints],
    *,
    prior: float,
    stated: bool,
) -> Uncertainty:
    """The uncertainty at a minimum.

    Parameters
    ----------
    jacobian, residual : (m, n) and (m,), over the standard deviations.
    clusters : (m,) number of the cluster of each residual, for each way to form clusters (points
        and times); none: all are independent.
    prior : standard deviation of the prior of each coordinate.
    stated : somebody stated the standard deviations: less scatter is luck, and more is not.
    """
    m, n = jacobian.shape
    u, plain, v = np.linalg.svd(jacobian, full_matrices=False)
    plain = np.where(plain < ERROR * plain.max(initial=0.0), 0.0, plain)
    jacobian = u * plain @ v
    ranks = int((plain * USELESS > 1.0).sum())
    left = m - min(ranks, n)
    q = float(residual @ residual) / left if left > 0 else 1.0
    q = max(q, 1.0 if stated or left <= 0 else LEAST**2)
    weak = np.eye(n) / prior**2
    covariance = np.linalg.inv(jacobian.T @ jacobian / q + weak)
    variance = np.diag(covariance).copy()
    degrees = float(left) if left > 0 and not stated else np.inf
    if clusters:
        robust = _sandwich(jacobian, residual, clusters, weak)
        grown = np.diag(robust) > variance
        variance = np.where(grown, np.minimum(np.diag(robust), prior**2), variance)
        fewest = min(len(np.unique(c)) for c in clusters)
        if grown.any():
            degrees = min(degrees, max(1.0, fewest - 1.0))
    # directions with the larger variance: the Jacobian in units in which each unknown has it
    stretch = np.sqrt(np.diag(covariance) / variance)
    _, singular, directions = np.linalg.svd(jacobian / np.sqrt(q) * stretch, full_matrices=False)
    singular = np.pad(singular, (0, n - len(singular)))
    if len(directions) < n:
        directions = np.linalg.svd(jacobian * stretch, full_matrices=True)[2]
    half = _quantile(degrees) * np.sqrt(variance)
    deviation = np.sqrt(np.diag(covariance))
    return Uncertainty(
        half=half,
        identifiable=tuple(bool(one <= USELESS) for one in half),
        singular=singular,
        directions=directions,
        noise=float(np.sqrt(q)),
        correlation=covariance / np.outer(deviation, deviation),
    )


def _quantile(degrees: float) -> float:
    """Half an interval over the standard deviation, by Student's distribution."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * LEVEL, degrees))


def _sandwich(jacobian: Floats, residual: Floats, clusters: Sequence[Ints], weak: Floats) -> Floats:
    """(n, n) B M B with the sums of M over one or two ways to form clusters."""
    n = jacobian.shape[1]
    scores = jacobian * residual[:, None]
    meat = np.zeros((n, n))
    for labels in clusters:
        meat += _squared(scores, labels)
    if clusters[1:]:
        both = np.unique(np.stack(clusters), axis=1, return_inverse=True)[1].ravel()
        meat -= (len(clusters) - 1) * _squared(scores, both)
    values, vectors = np.linalg.eigh(meat)  # a difference of sums may be slightly indefinite
    meat = vectors * np.maximum(values, 0.0) @ vectors.T
    bread = np.linalg.inv(jacobian.T @ jacobian + weak)
    return bread @ meat @ bread


def _squared(scores: Floats, labels: Ints) -> Floats:
    """(n, n) sum over clusters of their summed scores, squared; corrected for few clusters."""
    count, index = np.unique(labels, return_inverse=True)
    sums = np.zeros((len(count), scores.shape[1]))
    np.add.at(sums, index.ravel(), scores)
    few = len(count) / (len(count) - 1.0) if len(count) > 1 else 1.0
    return few * sums.T @ sums

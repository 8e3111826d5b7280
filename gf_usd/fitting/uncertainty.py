"""Uncertainty of a least-squares estimate: confidence intervals and identifiability.

With the whitened residuals r (m,) and their Jacobian J (m, n) at the minimum, in coordinates whose
prior has the standard deviation s, the covariance is (J^T J / q + 1 / s^2)^-1.  The factor q, the
variance of the residuals over the stated one, is |r|^2 / (m - k), where k is the number of
directions that the residuals determine.

Model errors are correlated between neighboring points and successive times.  Where residuals belong
to points and times, the covariance is therefore the sandwich estimator

    C = B M B,   B = (J^T J + 1 / s^2)^-1,   M = sum over clusters of (J_c^T r_c)(J_c^T r_c)^T

[Liang and Zeger 1986], with M = M(points) + M(times) - M(single residuals) for two-way clustering
[Cameron, Gelbach and Miller 2011].  Each variance is the larger of the two estimates.

Along a right singular vector of J with singular value S the standard deviation is sqrt(q) / S;
directions of small S are not identifiable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gf_usd.core.arrays import Floats, Ints

LEVEL = 0.95  # of the intervals
# Half width of an interval relative to the range of the bounds: wider ones add little to these.
MAX_HALF_WIDTH = 0.25
# Lower bound of the noise relative to the assumed one: model errors and the single precision of
# finite differences are about 0.1 % of a number or of the radius.
MIN_NOISE = 0.1
# Error of finite differences relative to the largest singular value; smaller singular values are
# set to 0.  For two unknowns with the same effect (density and modulus of a ball) it is 5e-4 and
# 1.8e-3 in two measurements.
JACOBIAN_ERROR = 3e-3
MIN_COMPONENT = 0.3  # of a unit vector: smaller components are not reported


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """Uncertainty of n unknowns, in coordinates of 0..1."""

    half: Floats  # (n,) half width of the intervals at LEVEL
    identifiable: tuple[bool, ...]  # (n,)
    singular: Floats  # (n,) singular values of J over the noise, descending
    directions: Floats  # (n, n) a row for each, unit
    noise: float  # sqrt(q): scatter of the residuals relative to the stated standard deviations
    correlation: Floats  # (n, n) of the estimates

    @property
    def undetermined(self) -> tuple[tuple[tuple[int, ...], Floats], ...]:
        """Undetermined directions (n,), each with the indices of the unknowns involved."""
        return tuple(
            (tuple(np.flatnonzero(np.abs(row) > MIN_COMPONENT).tolist()), row)
            for s, row in zip(self.singular, self.directions)
            if _t_quantile(np.inf) > MAX_HALF_WIDTH * s
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
    clusters : (m,) label of the cluster of each residual, for each clustering (points and times);
        empty: all residuals are independent.
    prior : standard deviation of the prior of each coordinate.
    stated : the standard deviations were given; a smaller scatter does not reduce the variance.
    """
    m, n = jacobian.shape
    u, singular_values, v = np.linalg.svd(jacobian, full_matrices=False)
    singular_values = np.where(
        singular_values < JACOBIAN_ERROR * singular_values.max(initial=0.0), 0.0, singular_values
    )
    jacobian = u * singular_values @ v
    rank = int((singular_values * MAX_HALF_WIDTH > 1.0).sum())
    degrees_of_freedom = m - min(rank, n)
    q = float(residual @ residual) / degrees_of_freedom if degrees_of_freedom > 0 else 1.0
    q = max(q, 1.0 if stated or degrees_of_freedom <= 0 else MIN_NOISE**2)
    prior_precision = np.eye(n) / prior**2
    covariance = np.linalg.inv(jacobian.T @ jacobian / q + prior_precision)
    variance = np.diag(covariance).copy()
    degrees = float(degrees_of_freedom) if degrees_of_freedom > 0 and not stated else np.inf
    if clusters:
        robust = _sandwich_covariance(jacobian, residual, clusters, prior_precision)
        enlarged = np.diag(robust) > variance
        variance = np.where(enlarged, np.minimum(np.diag(robust), prior**2), variance)
        cluster_count = min(len(np.unique(c)) for c in clusters)
        if enlarged.any():
            degrees = min(degrees, max(1.0, cluster_count - 1.0))
    # rescale the columns of J so that directions have the enlarged variances
    scale = np.sqrt(np.diag(covariance) / variance)
    _, singular, directions = np.linalg.svd(jacobian / np.sqrt(q) * scale, full_matrices=False)
    singular = np.pad(singular, (0, n - len(singular)))
    if len(directions) < n:
        directions = np.linalg.svd(jacobian * scale, full_matrices=True)[2]
    half = _t_quantile(degrees) * np.sqrt(variance)
    deviation = np.sqrt(np.diag(covariance))
    return Uncertainty(
        half=half,
        identifiable=tuple(bool(width <= MAX_HALF_WIDTH) for width in half),
        singular=singular,
        directions=directions,
        noise=float(np.sqrt(q)),
        correlation=covariance / np.outer(deviation, deviation),
    )


def _t_quantile(degrees: float) -> float:
    """Half width of an interval over the standard deviation, by Student's t distribution."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * LEVEL, degrees))


def _sandwich_covariance(
    jacobian: Floats, residual: Floats, clusters: Sequence[Ints], prior_precision: Floats
) -> Floats:
    """Sandwich covariance B M B (n, n) for one or two clusterings."""
    n = jacobian.shape[1]
    scores = jacobian * residual[:, None]
    meat = np.zeros((n, n))
    for labels in clusters:
        meat += _sum_of_squares(scores, labels)
    if clusters[1:]:
        intersections = np.unique(np.stack(clusters), axis=1, return_inverse=True)[1].ravel()
        meat -= (len(clusters) - 1) * _sum_of_squares(scores, intersections)
    values, vectors = np.linalg.eigh(meat)  # the difference may be slightly indefinite
    meat = vectors * np.maximum(values, 0.0) @ vectors.T
    bread = np.linalg.inv(jacobian.T @ jacobian + prior_precision)
    return bread @ meat @ bread


def _sum_of_squares(scores: Floats, labels: Ints) -> Floats:
    """M (n, n) = c / (c - 1) times the sum over c clusters of (J_c^T r_c)(J_c^T r_c)^T."""
    count, index = np.unique(labels, return_inverse=True)
    sums = np.zeros((len(count), scores.shape[1]))
    np.add.at(sums, index.ravel(), scores)
    correction = len(count) / (len(count) - 1.0) if len(count) > 1 else 1.0
    return correction * sums.T @ sums

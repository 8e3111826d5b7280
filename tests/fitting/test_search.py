"""The search and its intervals on a damped oscillator, whose motion is a closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from gf_usd.core.arrays import Floats
from gf_usd.fitting.search import PRIOR, AllSimulationsFailed, Minimum, OutOfTime, search
from gf_usd.fitting.uncertainty import LEVEL, Uncertainty, uncertainty

TIMES = np.linspace(0.0, 3.0, 40)  # [s]
POINTS = 5
NOISE = 0.01  # of the amplitude, 1 m


def motion(z: Floats) -> Floats:
    """(POINTS, 40) x(t) = a exp(-c t) cos(w t) for z = (stiffness, damping, nothing).

    The frequency spans a decade, as the root of a modulus does over two.
    """
    w, c = 2.0 * 10.0 ** z[0], 0.05 * 10.0 ** (2.0 * z[1])
    return np.linspace(0.5, 1.0, POINTS)[:, None] * np.exp(-c * TIMES) * np.cos(w * TIMES)


TRUTH = np.array([0.62, 0.45, 0.3])
START = np.array([0.5, 0.5, 0.5])


def found(target: Floats, sigma: float = NOISE) -> Minimum:
    def evaluate(points: Sequence[Floats], late: bool) -> list[Floats | None]:
        return [((motion(z) - target) / sigma).ravel() for z in points]

    return search(evaluate, START)


def judged(minimum: Minimum, *, stated: bool = True) -> Uncertainty:
    point, time = np.meshgrid(np.arange(POINTS), np.arange(len(TIMES)), indexing="ij")
    return uncertainty(
        minimum.jacobian, minimum.residual, [point.ravel(), time.ravel()], prior=PRIOR,
        stated=stated,
    )  # fmt: skip


@pytest.mark.slow
def test_the_truth_is_found_and_what_has_no_effect_stays() -> None:
    minimum = found(motion(TRUTH))
    assert minimum.converged
    # the prior pulls by its share of the information, some 1e-6 here; the rest is the tolerance
    assert minimum.z[:2] == pytest.approx(TRUTH[:2], abs=1e-4)
    assert minimum.z[2] == pytest.approx(START[2], abs=1e-9)  # rounding of the normal equations
    judgment = judged(minimum)
    assert judgment.identifiable == (True, True, False)
    assert [members for members, _ in judgment.undetermined] == [(2,)]


def test_a_search_repeats_itself() -> None:
    target = motion(TRUTH) + NOISE * np.random.default_rng(1).standard_normal((POINTS, 40))
    assert np.array_equal(found(target).z, found(target).z)


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    hits, runs = np.zeros(2), 60
    widths = []
    for seed in range(runs):
        noise = NOISE * np.random.default_rng(seed).standard_normal((POINTS, 40))
        minimum = found(motion(TRUTH) + noise)
        judgment = judged(minimum)
        hits += np.abs(minimum.z - TRUTH)[:2] <= judgment.half[:2]
        widths.append(judgment.half[:2])
    # 3 standard deviations of a binomial count below LEVEL; the larger of two variances is wider
    least = LEVEL - 3.0 * np.sqrt(LEVEL * (1.0 - LEVEL) / runs)
    assert (hits / runs >= least).all()
    # and no wider than twice what independent noise of this size allows
    exact = np.linalg.inv(found(motion(TRUTH)).jacobian[:, :2].T @ minimum.jacobian[:, :2])
    assert (np.median(widths, 0) < 2.0 * 2.0 * np.sqrt(np.diag(exact))).all()


@pytest.mark.slow
def test_intervals_grow_with_the_noise() -> None:
    noise = np.random.default_rng(3).standard_normal((POINTS, 40))
    little = judged(found(motion(TRUTH) + 0.003 * noise), stated=False)
    much = judged(found(motion(TRUTH) + 0.03 * noise), stated=False)
    ratio = much.half[:2] / little.half[:2]
    assert (ratio > 5.0).all()  # ten, but for what is not linear
    assert (ratio < 20.0).all()
    assert much.noise == pytest.approx(3.0, rel=0.15)  # 200 residuals: 5 % scatter


def test_errors_that_last_count_once() -> None:
    # the same error at all points: five points give no more than one
    wave = NOISE * np.random.default_rng(5).standard_normal(40)
    alike = judged(found(motion(TRUTH) + wave))
    apart = judged(
        found(motion(TRUTH) + NOISE * np.random.default_rng(6).standard_normal((POINTS, 40)))
    )
    assert (alike.half[:2] > 1.4 * apart.half[:2]).all()  # root 5 where errors were equal in share


def test_two_that_act_alike_are_reported_as_one_combination() -> None:
    def evaluate(points: Sequence[Floats], late: bool) -> list[Floats | None]:
        target = motion(TRUTH)
        return [((motion([z[0] - z[1] + 0.5, z[2]]) - target) / NOISE).ravel() for z in points]

    minimum = search(evaluate, START)
    judgment = uncertainty(minimum.jacobian, minimum.residual, [], prior=PRIOR, stated=True)
    assert judgment.identifiable == (False, False, True)
    assert [members for members, _ in judgment.undetermined] == [(0, 1)]
    assert judgment.correlation[0, 1] == pytest.approx(1.0, abs=1e-3)


def test_failed_simulations_are_walked_around() -> None:
    target = motion(TRUTH)

    def evaluate(points: Sequence[Floats], late: bool) -> list[Floats | None]:
        return [None if z[0] > 0.7 else ((motion(z) - target) / NOISE).ravel() for z in points]

    assert search(evaluate, START).z[:2] == pytest.approx(TRUTH[:2], abs=1e-3)
    with pytest.raises(AllSimulationsFailed):
        search(lambda points, late: [None for _ in points], START)


def test_the_best_so_far_is_kept_when_the_time_is_over() -> None:
    target, count = motion(TRUTH), 0

    def evaluate(points: Sequence[Floats], late: bool) -> list[Floats | None]:
        nonlocal count
        if count > 20 and not late:
            raise OutOfTime
        count += len(points)
        return [((motion(z) - target) / NOISE).ravel() for z in points]

    minimum = search(evaluate, START)
    assert not minimum.converged
    start = ((motion(START) - target) / NOISE).ravel()
    assert np.sum(minimum.residual**2) < np.sum(start**2)
    assert count < 40  # what is left is the Jacobian

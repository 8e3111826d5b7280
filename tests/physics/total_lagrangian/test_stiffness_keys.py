"""Moduli that change with time: what they do to the motion, the energy and the step."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from solids import ball, look, settings

from gf_usd.core.materials.keys import StiffnessKeys
from gf_usd.physics.frame_loop import energy
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


@pytest.fixture(scope="module")
def body():
    return ball(300)[0]


def keyed(body, times, factors):
    """The body with one factor for all particles."""
    keys = StiffnessKeys(
        times=np.asarray(times, float),
        factors=np.asarray(factors, float)[:, None],
        of=np.zeros(len(body), int),
    )
    return replace(body, stiffness=keys)


def solver(particles, stiffer=1.0, **changes):
    """A ball of rubber without damping that starts to swing."""
    made = look("rubber", particles, damping_time=0.0, law="neoHookean")
    made = replace(made, youngs_modulus=stiffer * made.youngs_modulus)
    stretched = np.diag([2.0, -1.0, -1.0])
    return TotalLagrangian(
        particles, [made], settings(**changes), velocity=lambda X: X @ stretched, real=np.float64
    )


def test_factors_are_straight_between_keys_and_the_same_beyond():
    keys = StiffnessKeys(
        times=np.array([10.0, 20.0]), factors=np.array([[1.0, 2.0], [3.0, 1.0]]),
        of=np.array([1, 0, 1]),
    )  # fmt: skip
    for code, wanted in ((0.0, [2, 1, 2]), (10.0, [2, 1, 2]), (15.0, [1.5, 2, 1.5]),
                         (20.0, [1, 3, 1]), (99.0, [1, 3, 1])):  # fmt: skip
        np.testing.assert_allclose(keys.at(code), wanted, rtol=1e-15)
    np.testing.assert_allclose(keys.most([12.0, 15.0]), [1.8, 2.0, 1.8], rtol=1e-15)
    alone = StiffnessKeys(times=np.array([3.0]), factors=np.array([[2.0]]), of=np.array([0]))
    np.testing.assert_array_equal(alone.at(-1.0), [2.0])


@pytest.mark.slow
def test_a_factor_that_stays_is_another_material(body):
    """Four times the moduli from the start are four times the moduli."""
    frames = [
        list(one.frames())
        for one in (solver(keyed(body, [0.0, 99.0], [4.0, 4.0])), solver(body, stiffer=4.0))
    ]
    for ours, plain in zip(*frames, strict=True):
        np.testing.assert_allclose(ours.particles.x, plain.particles.x, atol=1e-12)
        assert ours.health.elastic == pytest.approx(plain.health.elastic, rel=1e-9, abs=1e-12)
        assert ours.health.substeps == plain.health.substeps
        assert ours.health.work == 0.0


@pytest.mark.slow
def test_the_work_of_stiffening_is_in_the_energy_book(body):
    """Moduli that rise fourfold give a swinging ball energy, all of which is work.

    What is left in each frame is the error of the integrator, of second order in the step: a
    sixteenth with a quarter of the step, of which half is asked.
    """
    left = []
    for safety in (0.5, 0.125):
        frames = list(solver(keyed(body, [1.0, 10.0], [1.0, 4.0]), safety=safety).frames())
        total = energy(frames[0].health)
        gains = [
            (energy(now.health) - energy(last.health), now.health.work)
            for last, now in pairwise(frames)
        ]
        assert sum(gain for gain, _ in gains) > 0.2 * total
        left.append(max(abs(gain - work) for gain, work in gains) / total)
    assert left[0] < 0.02  # what the guard lets pass
    assert left[1] < left[0] / 8.0


def test_the_step_follows_the_stiffest_moduli(body):
    """Waves are twice as fast at four times the moduli, whenever they come."""
    soft = solver(body)
    stiff = solver(keyed(body, [1.0, 10.0], [1.0, 4.0]))
    # The middle of the last way is half a frame before the last key.
    assert soft.body.step.dt / stiff.body.step.dt == pytest.approx(np.sqrt(1 + 3 * 8.5 / 9))
    early = solver(keyed(body, [100.0, 109.0], [1.0, 4.0]))
    assert early.body.step.dt == soft.body.step.dt


def test_a_bake_goes_on_alike_from_a_checkpoint(body):
    particles = keyed(body, [1.0, 10.0], [1.0, 4.0])
    whole = solver(particles)
    frames = list(whole.frames())
    first = solver(particles)
    steps = first.frames()
    for _ in range(5):
        frame = next(steps)
    later = solver(particles)
    later.load(first.save())
    rest = list(later.frames_after(4, frame.health))
    assert np.array_equal(rest[-1].particles.x, frames[-1].particles.x)
    assert [f.health.work for f in rest] == [f.health.work for f in frames[5:]]

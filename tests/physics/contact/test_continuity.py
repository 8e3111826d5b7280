"""New planes store what the old ones did, with springs that harden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gf_usd.physics.contact.planes.contact_planes import nothing
from gf_usd.physics.contact.planes.continuity import EnergyBudget, Stored, continued

N, A = 40, 0.4  # samples, and the depth [m] at which a spring is twice as strong


def stored(depth, pair) -> Stored:
    planes = replace(nothing(N), normal=np.tile([0.0, 1.0, 0.0], (N, 1)))
    k = np.linspace(1.0, 3.0, N)
    return Stored(planes=planes, depth=depth, stiffness=k, hardening=A**-2, pair=pair)


def alike(power: float):
    """The power [W] of every pair."""
    return lambda pairs: np.full(len(pairs), power)


def budget(power: float, reserve: float = 1e9) -> EnergyBudget:
    """Of three bodies that meet only themselves."""
    return EnergyBudget(alike(power), np.arange(3), np.full(3, reserve))


def energies(one: Stored, pairs: int = 3):
    return np.bincount(one.pair, one.normal_energy, pairs)


def test_the_energy_is_that_of_the_force():
    pair, d, step = np.zeros(N, int), np.linspace(0.0, 1.0, N), 1e-6
    slope = (stored(d + step, pair).normal_energy - stored(d, pair).normal_energy) / step
    np.testing.assert_allclose(slope, np.linspace(1.0, 3.0, N) * d * (1 + (d / A) ** 2), atol=1e-4)


def test_each_pair_keeps_its_energy_whatever_the_true_depths_are():
    random = np.random.default_rng(0)
    pair = np.arange(N) % 3
    old = stored(random.uniform(0.1, 0.6, N), pair)
    true = stored(old.depth * random.uniform(0.8, 1.2, N), pair)
    new = continued(old, true, ease=1.0, budget=budget(0.0), elapsed=1.0)
    np.testing.assert_allclose(energies(new), energies(old), rtol=1e-12)
    # All samples of a pair are moved alike, each along its normal.
    scale = new.depth / true.depth
    for k in range(3):
        np.testing.assert_allclose(scale[pair == k], scale[k], rtol=1e-12)
    np.testing.assert_allclose(new.planes.point[:, 1], new.depth - true.depth, atol=1e-15)


def test_a_budget_takes_the_energy_to_the_true_one():
    pair = np.arange(N) % 3
    old, true = stored(np.full(N, 0.2), pair), stored(np.full(N, 0.3), pair)
    gap = energies(true) - energies(old)
    power = 0.25 * float(gap.min())
    some = continued(old, true, ease=1.0, budget=budget(power), elapsed=2.0)
    np.testing.assert_allclose(energies(some) - energies(old), 0.5 * gap.min(), rtol=1e-9)
    plenty = budget(1e9)
    np.testing.assert_allclose(
        energies(continued(old, true, ease=1.0, budget=plenty, elapsed=1.0)),
        energies(true),
        rtol=1e-12,
    )


def test_a_plane_that_changes_sides_again_and_again_is_given_a_bounded_energy():
    """A sample between two sheets: what pushed it is gone at every detection, and it is deep anew.

    A soft penguin was given 0.27 % of its energy so, a share in every frame, and never rested.
    """
    pair = np.arange(N) % 3
    nothing_pressed, deep = stored(np.zeros(N), pair), stored(np.full(N, 0.3), pair)
    limited, given = budget(0.1, 0.7), np.zeros(3)
    for _ in range(50):
        new = continued(nothing_pressed, deep, ease=1.0, budget=limited, elapsed=1.0)
        given += energies(new)
    np.testing.assert_allclose(given, 0.7, rtol=1e-9)
    np.testing.assert_allclose(limited.given, 0.7, rtol=1e-12)
    assert (new.depth == 0.0).all()
    # What a detection takes back may be given again.
    shallow = stored(np.full(N, 0.2), pair)
    continued(deep, shallow, ease=1.0, budget=limited, elapsed=1.0)
    np.testing.assert_allclose(limited.given, 0.6, rtol=1e-12)
    new = continued(nothing_pressed, deep, ease=1.0, budget=limited, elapsed=1.0)
    np.testing.assert_allclose(energies(new), 0.1, rtol=1e-9)


def test_between_bodies_and_obstacles_the_true_depth_is_reached_at_every_detection():
    """What slides in a bowl follows its planes a little too deep, again and again."""
    pair = np.arange(N) % 3
    old, true = stored(np.full(N, 0.25), pair), stored(np.full(N, 0.3), pair)
    limited = EnergyBudget(alike(5.0), np.array([1]), np.array([0.7]))
    for _ in range(100):
        new = continued(old, true, ease=1.0, budget=limited, elapsed=1.0)
        np.testing.assert_allclose(new.depth[pair != 1], 0.3, rtol=1e-9)
    assert (new.depth[pair == 1] < 0.26).all(), "of the body with itself"


def test_each_body_has_a_reserve_of_its_own():
    """What a heavy body may be given is no measure of a light one."""
    made = EnergyBudget.of_bodies(np.array([1e3, 1e-3]), np.array([0.6, 6e-3]), 0, 10.0)
    light = np.full(N, 3)
    nothing_pressed, deep = stored(np.zeros(N), light), stored(np.full(N, 0.3), light)
    for _ in range(20):
        continued(nothing_pressed, deep, ease=1.0, budget=made, elapsed=10.0)
    np.testing.assert_allclose(made.given, [0.0, 4e-4 * 1e-3 * 10.0 * 6e-3], rtol=1e-9)


def test_a_pair_has_the_power_of_its_lighter_body_whatever_else_is_in_the_scene():
    """Each pair of a heap of bodies had the power of the whole heap."""
    mass, radius = np.array([5.0, 1e3, 0.2, 1e3]), np.array([0.1, 0.6, 0.04, 0.6])
    made = EnergyBudget.of_bodies(mass, radius, 1, 10.0)  # five partners each: first the obstacle
    given = made.spend(np.full(20, 1e9), 2.0).reshape(4, 5)
    power = 1e-4 * mass * 10.0 * radius * np.sqrt(9.81 / radius)
    np.testing.assert_allclose(given[:, 0], 2.0 * power, rtol=1e-12)
    for a, b in ((0, 1), (0, 2), (1, 2), (1, 3)):
        np.testing.assert_allclose(given[a, 1 + b], 2.0 * min(power[a], power[b]), rtol=1e-12)
        assert given[a, 1 + b] == given[b, 1 + a]
    alone = EnergyBudget.of_bodies(mass[:1], radius[:1], 1, 10.0)
    assert alone.spend(np.full(1, 1e9), 2.0) == given[0, 0]


def test_a_flow_and_a_body_have_the_power_of_the_one_that_has_less():
    """A pebble on a ton of sand had the power of the sand."""
    mass, radius = np.array([1e-2, 5e3]), np.array([0.01, 0.9])
    made = EnergyBudget.of_flow(1e3, 0.5, (mass, radius), 2, 10.0)
    given = made.spend(np.full(4, 1e9), 2.0)  # two obstacles first
    flow, pebble, _ = (
        1e-4 * np.array([1e3, *mass]) * 10.0 * np.sqrt(9.81 * np.array([0.5, *radius]))
    )
    np.testing.assert_allclose(given, 2.0 * np.array([flow, flow, pebble, flow]), rtol=1e-12)

"""What bodies that stretch by their own weight are estimated to take."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import contact_solver
from solids import cube, fill, preset_material, settings, solid

from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Pin
from gf_usd.physics.time_step import StableStep, strained_step
from gf_usd.pipeline.cost.hanging import TIMES, Hanging, bar_stretches, hanging

G = 9.81
DOWN = {"gravity": (0.0, -G, 0.0)}
ROPE = cube((-0.1, -4.0, -0.1), (0.2, 4.0, 0.2), path="/Rope")


def pin(low: float, high: float) -> Pin:
    """Everything between two heights [m]."""
    middle = 0.5 * (low + high)

    def nearest(X: Any) -> Any:
        X = np.array(X, float)
        X[:, 1] = np.where(X[:, 1] < middle, low, high)
        return X

    return Pin(
        name="pin",
        inside=lambda X: (X[:, 1] >= low) & (X[:, 1] <= high),
        nearest=nearest,
        anchors=np.array([[0.0, middle, 0.0]]),
        path=np.array([[[0.0, middle, 0.0]]]),
    )


TOP, BOTTOM = pin(-0.2, 0.1), pin(-4.1, -3.8)


@pytest.fixture(scope="module")
def rope() -> Particles:
    """Of 4 m, 0.2 m thick: about two cells across."""
    return fill(solid(ROPE), 1200)[0]


def material(rope: Particles, **changes: Any) -> Material:
    return preset_material("rubber", rope, **{"law": "corotated", **changes})


def test_a_rope_is_stretched_by_the_weight_below_the_pin(rope: Particles) -> None:
    """e = rho g (L - d) / E at a distance d from the pin, which holds the uppermost 0.2 m; so it is
    longer by half of rho g L^2 / E.
    """
    rubber = material(rope)
    found = hanging(rope, [rubber], [TOP], settings(**DOWN))
    e = rubber.density * G * 3.8 / rubber.youngs_modulus
    # a layer of two spacings of the 3.8 m is 4 % of them, and so is half a cell at the pin
    assert found.stretch - 1.0 == pytest.approx(e, rel=0.08)
    assert found.longer == pytest.approx(0.5 * e * 3.8, rel=0.12)
    twice = hanging(rope, [replace(rubber, youngs_modulus=2.0 * rubber.youngs_modulus)], [TOP],
                    settings(**DOWN))  # fmt: skip
    assert twice.stretch - 1.0 == pytest.approx(0.5 * (found.stretch - 1.0))


@pytest.mark.parametrize(
    ("pins", "changes"),
    [((), DOWN), ((BOTTOM,), DOWN), ((TOP,), {}), ((replace(TOP, rigid=True),), DOWN)],
    ids=["no pin", "it stands on the pin", "no gravity", "a rigid region"],
)
def test_what_does_not_hang_is_not_stretched(
    rope: Particles, pins: tuple[Pin, ...], changes: dict[str, Any]
) -> None:
    assert hanging(rope, [material(rope)], pins, settings(**changes)) == Hanging()


def test_stretches_of_a_bar(rope: Particles) -> None:
    e = np.array([0.0, 1e-3, 0.1, 1.0, 10.0])
    stretch = bar_stretches(e, material(rope, law="neoHookean"))
    np.testing.assert_allclose(stretch - stretch**-2, 3.0 * e, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(bar_stretches(e, material(rope)), 1.0 + e)
    clay = preset_material("clay", rope)
    assert clay.yield_strain is not None
    assert bar_stretches(e, clay).max() == 1.0 + clay.yield_strain


def test_it_falls_and_swings_about_its_length_at_rest() -> None:
    made = Hanging(stretch=5.0, longer=2.0, damping_time=0.0, gravity=G)
    early, period = 0.01, 2.0 * np.pi * np.sqrt(2.0 / G)
    start, lowest, back = made.stretches(np.array([early, 0.5 * period, period]))
    # longer by g t^2 / 2, as in free fall
    assert (start - 1.0) / 4.0 * 2.0 == pytest.approx(0.5 * G * early**2, rel=1e-3)
    assert lowest == pytest.approx(9.0)
    assert back == pytest.approx(1.0)
    damped = replace(made, damping_time=0.5)
    assert damped.stretches(np.array([50.0]))[0] == pytest.approx(5.0)


STEP = StableStep(
    elastic=1e3, contact=0.0, viscous_time=1e-4, contact_damping=0.0, safety=0.5
)  # fmt: skip


def test_substeps_are_those_of_the_damping_of_the_stretch() -> None:
    still = Hanging(stretch=20.0, longer=1e-9, damping_time=1.0, gravity=G)
    (first, *_, last) = still.profile(STEP, 1.0)
    assert first <= last == pytest.approx(STEP.dt / strained_step(
        STEP, 1.0, 1.0, 1.0, STEP.elastic, damping=400.0))  # fmt: skip
    assert still.profile(None, 1.0) == []
    assert Hanging().profile(STEP, 1.0) == []
    assert replace(still, stretch=1.5).profile(STEP, 1.0) == [], (
        "as at rest: `safety` allows for it"
    )
    means = [np.mean(replace(still, stretch=s).profile(STEP, 1.0)) for s in (10.0, 20.0, 40.0)]
    assert means[0] < means[1] < means[2]
    assert len(still.profile(STEP, 1.0)) == TIMES


@pytest.mark.slow
def test_a_soft_rope_takes_the_substeps_that_are_foretold() -> None:
    """A cable of rubber that carried a lamp took 14 times the estimated time."""
    changes = {"law": "neoHookean", "youngs_modulus": 2e4, "damping_time": 0.05}
    solver = contact_solver(
        ROPE, particles=1200, pins=[TOP], changes=changes, frames=24, **DOWN
    )  # fmt: skip
    rubber = preset_material("rubber", solver.particles, **changes)
    made = hanging(solver.particles, [rubber], [TOP], solver.settings)
    profile = made.profile(solver.body.step, solver.frame_time * 23)
    done = sum(frame.health.substeps for frame in solver.frames())
    assert done > 1.5 * 23 * solver.coarse
    assert 0.5 < done / (23 * solver.coarse * float(np.mean(profile))) < 2.0

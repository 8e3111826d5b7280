"""A note on masses of the stage that a preset of --material replaces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from planned import cubes, mass, planner

from gf_usd.prepare.plan import Plan

HEAVY = "float physics:mass = 80"
MASS = ("PhysicsRigidBodyAPI", "PhysicsMassAPI")


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


def replaced(made: Plan) -> list[str]:
    return [note for note in made.notes if "replaces" in note]


def test_a_preset_says_which_masses_it_replaces(plan) -> None:
    """Bodies of 20 and 80 kg weighed the same without a word."""
    made = plan(cubes(HEAVY, apis=MASS), material="rubber")
    assert mass(made, 0) == pytest.approx(1100.0, rel=0.05)
    assert replaced(made) == [
        "--material rubber replaces the mass that the stage gives </One>: leave --material out to"
        " keep it"
    ]
    kept = plan(cubes(HEAVY, apis=MASS))
    assert mass(kept, 0) == pytest.approx(80.0, rel=1e-3)
    assert not replaced(kept)


def test_a_density_counts_and_bodies_without_either_do_not(plan) -> None:
    made = plan(cubes("float physics:density = 300", apis=MASS), material="jelly")
    (note,) = replaced(made)
    assert note.startswith("--material jelly replaces the density that the stage gives </One>:")
    assert not replaced(plan(cubes(), material="jelly"))

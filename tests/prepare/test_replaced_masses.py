"""A note on masses of the stage that a preset of --material replaces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from physics_stages import mesh
from planned import at, cubes, mass, planner

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


@pytest.mark.parametrize(
    ("more", "start", "end"),
    [
        (
            {"preset": "paper"},
            "--preset paper with the material rubber replaces the mass",
            "bakes without --preset and --material keep it",
        ),
        (
            {"material_sweep": "youngs=1e5:2e5:2"},
            "--material-sweep replaces the mass",
            "bakes without --material-sweep and --material keep it",
        ),
    ],
)
def test_options_that_imply_a_preset_are_named(plan, more, start: str, end: str) -> None:
    """The note said to leave out --material, which was not given."""
    (note,) = replaced(plan(cubes(HEAVY, apis=MASS), **more))
    assert note == f"{start} that the stage gives </One>: {end}"


def test_other_bodies_are_counted(plan) -> None:
    made = plan(cubes(HEAVY, apis=MASS) + mesh("Far", at(9.0), HEAVY, apis=MASS), material="jelly")
    (note,) = replaced(made)
    assert "gives </One> and 1 more: " in note

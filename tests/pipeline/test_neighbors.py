"""What contact of bodies that are next to each other from the start is estimated to take."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import contact_solver, half_space
from solids import cube

from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.pipeline.cost.neighbors import contact_factors, step_of
from gf_usd.pipeline.cost.solvers import TOUCH, Demand


def cubes(gap: float, **options: object) -> TotalLagrangian:
    """One of 1 m above another, with a spacing of about 0.2 m."""
    return contact_solver(
        cube(path="/A"), cube((0.0, 1.0 + gap, 0.0), path="/B"), particles=250,
        gravity=(0.0, -9.81, 0.0), floor=-0.01, **options,
    )  # type: ignore[arg-type]  # fmt: skip


def test_only_what_is_near_adds_substeps() -> None:
    near, far = contact_factors(cubes(0.08)), contact_factors(cubes(3.0))
    assert 1.3 < near[0] <= near[1]
    assert far[0] == 1.0
    assert far[1] == pytest.approx(near[1], rel=0.05), "a bound for whatever they may touch"


def test_the_solver_stays_as_it_is() -> None:
    solver = cubes(0.08)
    before = {name: np.array(value, copy=True) for name, value in solver.save().items()}
    contact_factors(solver)
    after = solver.save()
    assert before.keys() == after.keys()
    for name, value in before.items():
        np.testing.assert_array_equal(value, after[name], err_msg=name)


def test_an_obstacle_next_to_a_body_is_its_neighbor() -> None:
    def touching(height: float) -> float:
        return contact_factors(
            contact_solver(cube(), particles=150, colliders=(half_space(height=height),))
        )[0]

    assert touching(-2.0) == 1.0 < touching(-0.01)


def test_a_body_alone_has_no_factor() -> None:
    solver = contact_solver(cube(), particles=150)
    assert contact_factors(solver)[0] == 1.0
    assert step_of(solver) is solver.body.step


def test_the_first_frames_take_what_their_neighbors_take() -> None:
    """A gear train took 1.8 times as many substeps as estimated."""
    solver = cubes(0.06, frames=7)
    touching, _ = contact_factors(solver)
    took = [frame.health.substeps for frame in solver.frames()][1:]
    assert 1.0 + 0.5 * (touching - 1.0) < max(took) / solver.coarse < 1.5 * touching


def test_expected_factors_of_contact() -> None:
    unknown = Demand(substeps=100)
    assert unknown.expected(1.3, 1.7) == 1.7
    assert unknown.most == 1.0
    near = Demand(substeps=100, touching=3.0, crowded=3.4)
    assert near.expected(1.3, 1.0) == 1.0 + 2.0 * TOUCH
    assert near.expected(1.3, 2.8) == 2.8
    assert near.most == 1.0 + 2.4 * TOUCH
    stiff = Demand(substeps=100, touching=1.0, crowded=1.1)
    assert stiff.expected(1.3, 1.7) == 1.1, "its own waves take more than any contact"

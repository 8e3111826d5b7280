"""What a stage keeps out of a bake, and what of the scene holds unless the command line speaks."""

from __future__ import annotations

import numpy as np
import pytest
from physics_stages import BOX, SLIDE, mesh, prim
from planned import at, cubes, noted, plan_fixture  # noqa: F401

from gf_usd.core.errors import InputError

COLLISION, RIGID = "PhysicsCollisionAPI", "PhysicsRigidBodyAPI"
OFF = "bool gaussianFlesh:enabled = false"
KINEMATIC = "bool physics:kinematicEnabled = true"
SCENE = prim(
    "PhysicsScene", "Scene", "vector3f physics:gravityDirection = (1, 0, 0)",
    "float physics:gravityMagnitude = 5",
)  # fmt: skip
TABLE = mesh("Table", at(0.0, -2.0), apis=[COLLISION])


def soft(plan) -> list[str]:
    return [s.path for s in plan.asset.surfaces]


def test_a_collider_that_could_not_be_baked_is_called_an_obstacle(plan) -> None:
    ground = prim("Plane", "Ground", 'uniform token axis = "Y"', at(0.0, -2.0), apis=[COLLISION])
    wall = mesh("Wall", at(9.0), 'token visibility = "invisible"', apis=[COLLISION])
    seen = plan(mesh("One", at(0.0, 4.0)), ground, wall, prim("Plane", "Backdrop"))
    assert [c.path for c in seen.contact_setup.colliders] == ["/Ground", "/Wall"]
    assert noted(seen, "</Wall> is not baked: static colliders are obstacles")
    assert noted(seen, "</Ground> is not baked: static colliders are obstacles")
    assert noted(
        seen,
        "</Backdrop> is not baked: Plane: only meshes, solid shapes, points and splats are made"
        " soft; it keeps the place and motion of its source and does not follow what is baked:",
    )
    assert not noted(seen, "</Ground> is not baked: Plane")


def test_colliders_are_obstacles_and_no_bodies(plan) -> None:
    tray = mesh("Tray", SLIDE, KINEMATIC, apis=[COLLISION, RIGID])
    seen = plan(mesh("One", at(0.0, 4.0)), TABLE, tray)
    assert soft(seen) == ["/One"]
    assert [c.path for c in seen.contact_setup.colliders] == ["/Table", "/Tray"]
    assert [c.moves for c in seen.contact_setup.colliders] == [False, True]
    assert noted(seen, "</Table> is not baked: static colliders are obstacles")
    assert noted(seen, "</Tray> is not baked: kinematic colliders are obstacles")
    # SLIDE moves by two meters a time code: frames 0, 1 and 2 are at 1, 2 and 3.
    np.testing.assert_allclose(seen.contact_setup.colliders[1].offset[:, 0], [0.0, 2.0, 4.0])


def test_an_obstacle_may_deform(plan) -> None:
    # What the stage says is read before its frames are known, and again at all of them.
    lifted = BOX.split("points = ")[1].strip().replace(",1)", ",3)")
    alive = BOX.rstrip() + "\npoint3f[] points.timeSamples = { 1: [], 3: [] }"
    rest = BOX.split("points = ")[1].strip()
    alive = alive.replace("1: []", f"1: {rest}").replace("3: []", f"3: {lifted}")
    floor = prim("Mesh", "Floor", alive, at(0.0, -2.0), apis=[COLLISION])
    (found,) = plan(mesh("One", at(0.0, 4.0)), floor).contact_setup.colliders
    np.testing.assert_array_equal([found.positions(k)[7, 2] for k in range(3)], [1.0, 2.0, 3.0])


def test_what_is_turned_off_stays_as_it_is(plan) -> None:
    seen = plan(cubes(OFF))
    assert soft(seen) == ["/Two"]
    assert noted(seen, "the stage turns off its bake (gaussianFlesh:enabled)")
    assert seen.contact_setup.colliders == ()


def test_a_prim_asked_for_by_name_is_baked_all_the_same(plan) -> None:
    assert soft(plan(cubes(OFF), prims=["/One"])) == ["/One"]
    assert soft(plan(cubes(), TABLE, prims=["/Table"])) == ["/Table"]
    assert soft(plan(mesh("Wall", "bool gaussianFlesh:enabled = true", apis=[COLLISION]))) == [
        "/Wall"
    ]


def test_a_stage_of_obstacles_only_is_refused_with_every_reason(plan) -> None:
    with pytest.raises(InputError, match="excludes every mesh from the bake") as refused:
        plan(TABLE, mesh("One", OFF, at(3.0)))
    assert "</Table>: static colliders are obstacles" in str(refused.value)
    assert "</One>: the stage turns off its bake" in str(refused.value)
    assert "--prim" in (refused.value.hint or "")


def test_gravity_is_the_scene_s_unless_asked(plan) -> None:
    seen = plan(cubes(), SCENE)
    assert seen.settings.gravity == pytest.approx((5.0, 0.0, 0.0))
    assert noted(seen, "gravity is that of </Scene>: (5, 0, 0) m/s^2")
    assert plan(cubes(), SCENE, gravity="3").settings.gravity == pytest.approx((0.0, -3.0, 0.0))
    assert plan(cubes()).settings.gravity == pytest.approx((0.0, -9.81, 0.0))


def test_obstacles_take_the_place_of_the_floor_unless_asked(plan) -> None:
    assert plan(cubes()).settings.floor == 0.0
    seen = plan(cubes(), TABLE)
    assert seen.settings.floor is None
    assert noted(seen, "there is 1 obstacle, so there is no floor; --floor 0")
    assert plan(cubes(), TABLE, floor="-3").settings.floor == -3.0


def test_seed_and_solver_are_the_stage_s_unless_asked(plan) -> None:
    layer = cubes("int gaussianFlesh:seed = 7")
    seen = plan(layer)
    assert noted(seen, "seed is 7, from the stage")
    other = plan(layer, seed=8)
    assert not noted(other, "from the stage")
    assert (seen.settings.seed, other.settings.seed) == (7, 8)
    assert np.array_equal(seen.particles.X, other.particles.X), "nothing is drawn at random"
    paper = plan(layer, preset="paper")
    assert np.array_equal(paper.particles.X, plan(cubes(), preset="paper", seed=7).particles.X)
    assert not np.array_equal(paper.particles.X, plan(layer, preset="paper", seed=8).particles.X)
    ul = mesh("One", 'token gaussianFlesh:solver = "updatedLagrangian"')
    assert plan(ul).settings.solver == "ul"
    assert plan(ul, solver="tl").settings.solver == "tl"


@pytest.mark.parametrize(
    ("name", "one", "two", "message"),
    [
        ("seed", "int gaussianFlesh:seed = 1", "int gaussianFlesh:seed = 2", "seed 1"),
        (
            "solver",
            'token gaussianFlesh:solver = "updatedLagrangian"',
            'token gaussianFlesh:solver = "totalLagrangian"',
            "solver ul",
        ),
    ],
)
def test_prims_that_disagree_are_refused_in_words(plan, name, one, two, message) -> None:
    both = mesh("One", one) + mesh("Two", two, at(3.0))
    with pytest.raises(InputError, match="a bake has one") as refused:
        plan(both)
    assert f"</One> has {message}" in str(refused.value)
    assert "</Two>" in str(refused.value)
    assert f"--{name}" in (refused.value.hint or "")
    assert soft(plan(both, **{name: {"seed": 3, "solver": "tl"}[name]})) == ["/One", "/Two"]


def test_updated_lagrangian_knows_obstacles(plan) -> None:
    made = plan(cubes(), TABLE, solver="ul")
    assert made.settings.solver == "ul"
    assert len(made.contact_setup.colliders) == 1

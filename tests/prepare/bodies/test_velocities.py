"""What bodies do at the start, and obstacles of other files: options of the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from physics_stages import mesh
from planned import at, cubes, noted, planner

from gf_usd.core.errors import InputError, UsageError
from gf_usd.prepare.plan import Plan

PLATE = """o plate
v -4 -1 -4
v 4 -1 -4
v 4 -1 4
v -4 -1 4
v -4 -2 -4
v 4 -2 -4
v 4 -2 4
v -4 -2 4
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""


@pytest.fixture
def plan(tmp_path: Path) -> Callable[..., Plan]:
    return planner(tmp_path)


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    path = tmp_path / "plate.obj"
    path.write_text(PLATE, encoding="utf-8")
    return path


def test_every_body_has_the_velocity_and_turns_about_its_own_center(plan) -> None:
    made = plan(cubes(), velocity="1,2,0", spin="0,180,0")
    unit = made.asset.facts.units.length
    assert len(made.velocity) == 2
    for k, motion in enumerate(made.velocity):
        mine = made.particles.body == k
        X, V0 = made.particles.X[mine], made.particles.V0[mine]
        v = motion(X)
        np.testing.assert_allclose(
            np.average(v, axis=0, weights=V0), np.array([1.0, 2.0, 0.0]) * unit, atol=1e-9
        )
        center = np.average(X, axis=0, weights=V0)
        turning = np.cross([0.0, np.pi, 0.0], X - center)
        np.testing.assert_allclose(v - np.array([1.0, 2.0, 0.0]) * unit, turning, atol=1e-9)


def test_one_of_the_two_leaves_the_other_to_the_stage(plan) -> None:
    layer = mesh(
        "One",
        "vector3f physics:velocity = (0, 0, 3)",
        "vector3f physics:angularVelocity = (90, 0, 0)",
        apis=("PhysicsRigidBodyAPI", "PhysicsCollisionAPI"),
    )
    made = plan(layer, spin="0,0,0", velocity="1,0,0")
    (motion,) = made.velocity
    v = motion(made.particles.X)
    np.testing.assert_allclose(v, np.broadcast_to((1.0, 0.0, 0.0), v.shape), atol=1e-12)
    (motion,) = plan(layer, velocity="1,0,0").velocity
    v = motion(made.particles.X)
    assert np.ptp(v[:, 2]) > 0.5, "it turns as the stage says"
    assert abs(np.average(v[:, 2], weights=made.particles.V0)) < 1e-9, "the velocity is replaced"


def carried(*bodies: str, samples: str = "1: (0, 9, 0), 5: (4, 9, 0)") -> str:
    """A root prim /Up with these bodies, that an animated transform moves."""
    move = f"double3 xformOp:translate.timeSamples = {{ {samples} }}"
    order = 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    return f'def Xform "Up"\n{{\n{move}\n{order}\n{"".join(bodies)}\n}}\n'


def alone(plan: Plan) -> list[str]:
    return [note.split(": its transform is animated")[0] for note in plan.notes if ANIMATED in note]


ANIMATED = "its transform is animated: the simulation starts from its pose at the first frame"


def test_a_note_says_that_animated_transforms_are_not_followed(plan) -> None:
    three = mesh("One"), mesh("Two", at(3.0)), mesh("Three", at(6.0))
    assert alone(plan(carried(*three[:2]))) == ["each of </Up/One> and </Up/Two>"]
    assert alone(plan(carried(*three))) == ["each of </Up/One> and 2 more"]
    assert alone(plan(mesh("One"))) == []


def test_animation_that_ends_at_the_first_frame_is_not_left(plan) -> None:
    body = carried(mesh("One"), samples="-4: (0, 9, 0), 1: (0, 8, 0)")
    assert alone(plan(body, start=1.0)) == []
    assert alone(plan(body, start=0.0)) == ["</Up/One>"]


def test_pinned_bodies_and_obstacles_follow_animated_transforms(plan) -> None:
    two = carried(mesh("One"), mesh("Two", at(3.0)))
    assert alone(plan(two, pins=["/Up/One"])) == ["</Up/Two>"]
    tray = mesh("Tray", at(0.0, -3.0), apis=("PhysicsCollisionAPI",))
    assert alone(plan(carried(mesh("One"), tray))) == ["</Up/One>"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"velocity": "1,2"}, "--velocity is '1,2'"),
        ({"velocity": "1,2,x"}, "--velocity: 'x' is not a number"),
        ({"spin": "1e12,0,0"}, "--spin is 1e12,0,0"),
        ({"spin": "inf,0,0"}, "--spin: 'inf' is not a number"),
    ],
)
def test_what_is_no_motion_is_refused(plan, options, message) -> None:
    with pytest.raises(UsageError) as caught:
        plan(cubes(), **options)
    assert message in caught.value.message


def test_the_meshes_of_another_file_are_obstacles(plan, plate) -> None:
    made = plan(mesh("One", at(0.0)), colliders=(str(plate),))
    assert made.contact_setup is not None
    (one,) = made.contact_setup.colliders
    assert one.path.startswith("plate.obj:/plate")
    np.testing.assert_allclose(np.ptp(one.points, axis=0), (8.0, 1.0, 8.0))
    assert not one.moves
    assert made.settings.floor is None
    assert noted(made, "there is 1 obstacle, so there is no floor; --floor 0 adds one")
    assert noted(
        made,
        "plate.obj: 1 obstacle, with 1 m per unit and Y up assumed (a USD file states them); the"
        " result does not contain the file",
    )
    assert made.collider_files == (plate,)
    with_floor = plan(mesh("One", at(0.0)), colliders=(str(plate),), floor="-3", drop="10")
    assert with_floor.settings.floor is not None


def test_obstacles_are_turned_to_the_up_axis_of_the_asset(plan, plate, tmp_path) -> None:
    stage = tmp_path / "upright.usda"
    stage.write_text('#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\n' + mesh("Box"))
    made = plan(mesh("One"), colliders=(str(stage),))
    assert made.contact_setup is not None
    (one,) = made.contact_setup.colliders
    assert noted(made, "upright.usda: 1 obstacle, turned from Z up; the result")
    # USD's Z is up there, Y here: (x, y, z) -> (x, z, -y)
    straight = plan(mesh("One"), colliders=(str(stage),), up_axis="Z").contact_setup.colliders[0]
    np.testing.assert_allclose(one.points[:, 1], straight.points[:, 2], atol=1e-12)
    np.testing.assert_allclose(one.points[:, 2], -straight.points[:, 1], atol=1e-12)


def test_a_file_that_is_none_is_refused(plan, tmp_path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        plan(mesh("One"), colliders=(str(tmp_path / "none.obj"),))

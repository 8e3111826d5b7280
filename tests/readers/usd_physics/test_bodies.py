"""Mass, density and first velocities of what is baked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from physics_stages import BOX, head, mesh, physics_of, prim

from gf_usd.core.errors import InputError
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import BodyPhysics, StagePhysics

Write = Callable[..., Path]

REL = 1e-6  # values in a file are float32
RIGID, MASS, COLLISION = "PhysicsRigidBodyAPI", "PhysicsMassAPI", "PhysicsCollisionAPI"
BASE = Material(name="base", law="corotated", density=900.0, youngs_modulus=1e5, poissons_ratio=0.3)


@pytest.fixture
def read_physics(write: Write) -> Callable[..., StagePhysics]:
    """What a stage says of its meshes, named by their paths."""

    def read_physics(
        *prims: str, bodies: tuple[str, ...] = ("/Duck",), layer: str = head(), **options
    ):
        return physics_of(write(layer + "".join(prims)), *bodies, **options)

    return read_physics


def only(physics: StagePhysics) -> BodyPhysics:
    (body,) = physics.bodies
    return body


def test_a_mesh_without_physics_has_no_notes(read_physics) -> None:
    body = only(read_physics(mesh("Duck")))
    assert body == BodyPhysics(path="/Duck")
    assert body.resolve(BASE) is not None
    assert body.resolve(BASE) == BASE
    assert body.initial_velocities(np.zeros((2, 3)), np.zeros(3)) is None


def test_mass_and_density_are_in_si(read_physics) -> None:
    lines = ["float physics:mass = 3", "float physics:density = 2"]
    body = only(
        read_physics(mesh("Duck", *lines, apis=[MASS]), layer=head(0.1, "Z", kilograms=0.001))
    )
    assert (body.mass, body.mass_of) == (pytest.approx(0.003, rel=REL), "/Duck")
    assert body.density == pytest.approx(2 * 0.001 / 0.1**3, rel=REL)
    assert body.resolve(BASE).density == body.density
    assert body.resolve(BASE).youngs_modulus == BASE.youngs_modulus


@pytest.mark.parametrize("line", ["float physics:mass = 0", "float physics:density = 0"])
def test_zero_is_no_statement(read_physics, line: str) -> None:
    body = only(read_physics(mesh("Duck", line, apis=[MASS])))
    assert (body.mass, body.density) == (None, None)


def test_the_mass_above_goes_first_and_the_density_below(read_physics) -> None:
    inside = mesh(
        "Look", "float physics:mass = 1\nfloat physics:density = 5", apis=[MASS, COLLISION]
    )
    body = prim(
        "Xform",
        "Duck",
        "float physics:mass = 9\nfloat physics:density = 7",
        inside,
        mesh("Eye"),
        apis=[RIGID, MASS],
    )
    look, eye = read_physics(body, bodies=("/Duck/Look", "/Duck/Eye")).bodies
    assert (look.mass, look.mass_of, look.owner) == (9.0, "/Duck", "/Duck")
    assert (eye.mass, eye.mass_of, eye.role) == (9.0, "/Duck", "dynamic")
    assert (look.density, eye.density) == (5.0, 7.0)
    # without the mass above, the collider's own counts, and the eye has none
    light = body.replace("physics:mass = 9", "physics:mass = 0")
    look, eye = read_physics(light, bodies=("/Duck/Look", "/Duck/Eye")).bodies
    assert (look.mass, look.mass_of, eye.mass) == (1.0, "/Duck/Look", None)


@pytest.mark.parametrize(
    ("apis", "line"),
    [
        ([COLLISION, MASS], "bool physics:collisionEnabled = false"),
        ([RIGID, MASS], "bool physics:rigidBodyEnabled = false"),
        ([], ""),
    ],
)
def test_the_mass_of_what_is_switched_off_or_has_no_mass_is_not_read(
    read_physics, apis: list[str], line: str
) -> None:
    assert only(read_physics(mesh("Duck", "float physics:mass = 3", line, apis=apis))).mass is None
    on = line.replace("false", "true")
    expected = 3.0 if apis else None
    assert (
        only(read_physics(mesh("Duck", "float physics:mass = 3", on, apis=apis))).mass == expected
    )


def test_a_mass_above_without_a_body_is_not_read_and_this_is_said(read_physics) -> None:
    found = read_physics(
        prim("Xform", "Pond", "float physics:mass = 3", mesh("Duck"), apis=[MASS]),
        bodies=("/Pond/Duck",),
    )
    assert only(found).mass is None
    assert found.notes == ("</Pond>: states a mass but is not a body: ignored",)


def test_omniverse_states_the_mass_of_a_soft_body_in_its_own_words(read_physics) -> None:
    api = "OmniPhysicsDeformableBodyAPI"
    body = only(read_physics(mesh("Duck", "float omniphysics:mass = 3", apis=[api])))
    assert (body.mass, body.role, body.owner) == (3.0, "dynamic", "/Duck")


def test_a_collision_of_its_own_that_is_off(read_physics) -> None:
    off = "bool physics:collisionEnabled = false"
    assert not only(read_physics(mesh("Duck", off, apis=[COLLISION]))).collides
    assert only(read_physics(mesh("Duck", apis=[COLLISION]))).collides


def test_velocities_are_of_the_body_s_own_frame(read_physics) -> None:
    turned = """
        double xformOp:rotateZ = 90
        double3 xformOp:scale = (3, 3, 3)
        uniform token[] xformOpOrder = ["xformOp:rotateZ", "xformOp:scale"]
    """
    lines = [
        turned,
        "vector3f physics:velocity = (100, 0, 0)",
        "vector3f physics:angularVelocity = (180, 0, 0)",
    ]
    body = only(read_physics(mesh("Duck", *lines, apis=[RIGID]), layer=head(0.01)))
    # a quarter turn about Z carries X to Y; the scale has no part in it
    assert body.velocity == pytest.approx((0, 1, 0), abs=1e-6)
    assert body.angular_velocity == pytest.approx((0, np.pi, 0), abs=1e-6)
    center = np.array([1.0, 2.0, 3.0])
    v = body.initial_velocities(np.array([center, center + [0, 0, 2.0]]), center)
    assert v is not None
    # omega x arm = (0, pi, 0) x (0, 0, 2) = (2 pi, 0, 0)
    np.testing.assert_allclose(v, [[0, 1, 0], [2 * np.pi, 1, 0]], atol=1e-6)


def test_in_a_mirror_a_velocity_turns_about_and_a_spin_the_other_way(read_physics) -> None:
    mirror = 'double3 xformOp:scale = (-1, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    lines = [
        mirror,
        "vector3f physics:velocity = (1, 2, 0)",
        "vector3f physics:angularVelocity = (180, 90, 0)",
    ]
    body = only(read_physics(mesh("Duck", *lines, apis=[RIGID])))
    assert body.velocity == pytest.approx((-1, 2, 0))
    # v = omega x arm mirrored: the component along the mirrored axis stays, the others turn
    assert body.angular_velocity == pytest.approx((np.pi, -np.pi / 2, 0))


@pytest.mark.parametrize(
    ("apis", "line"),
    [
        ([], ""),
        ([RIGID], "bool physics:rigidBodyEnabled = false"),
        ([RIGID], "bool physics:kinematicEnabled = true"),
        ([RIGID], "vector3f physics:velocity = (0, 0, 0)"),
    ],
)
def test_no_velocity_without_a_body_that_forces_move(
    read_physics, apis: list[str], line: str
) -> None:
    speed = "" if "velocity" in line else "vector3f physics:velocity = (1, 0, 0)"
    assert only(read_physics(mesh("Duck", speed, line, apis=apis))).velocity is None
    moving = mesh("Duck", "vector3f physics:velocity = (1, 0, 0)", apis=[RIGID])
    assert only(read_physics(moving)).velocity == (1.0, 0.0, 0.0)


def test_an_authored_center_of_mass(read_physics) -> None:
    place = """
        double3 xformOp:translate = (10, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    """
    center = "point3f physics:centerOfMass = ({})"
    lines = [place, center.format("1, 2, 3"), "vector3f physics:velocity = (1, 0, 0)"]
    body = only(read_physics(mesh("Duck", *lines, apis=[RIGID, MASS]), layer=head(0.1)))
    assert body.center == pytest.approx((1.1, 0.2, 0.3))
    lines[1] = center.format("-inf, -inf, -inf")
    assert only(read_physics(mesh("Duck", *lines, apis=[RIGID, MASS]))).center is None
    lines[1] = center.format("-inf, 0, 0")
    with pytest.raises(InputError, match="</Duck>: physics:centerOfMass is"):
        read_physics(mesh("Duck", *lines, apis=[RIGID, MASS]))


FALL = """
    double3 xformOp:translate.timeSamples = { 0: (0, 6, 0), 10: (0, 1, 0), 12: (4, 1, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
"""


def test_the_animation_before_the_start_gives_the_first_velocity(read_physics) -> None:
    layer = head(0.1, extra="timeCodesPerSecond = 30\nstartTimeCode = 10")
    found = read_physics(mesh("Duck", FALL), layer=layer)
    moving = only(found).moving
    assert moving is not None
    # half a unit of a tenth of a meter down each frame, 30 frames per second
    np.testing.assert_allclose(moving, np.tile([0, -1.5, 0], (8, 1)), atol=1e-6)
    assert found.notes == ("</Duck>: starts with the velocity of its animation",)
    # two time codes a frame: the same
    again = only(read_physics(mesh("Duck", FALL), layer=layer, times=(10.0, 12.0))).moving
    assert again is not None
    np.testing.assert_allclose(again, moving, atol=1e-6)


@pytest.mark.parametrize("rest", [0.0, 20.0])
def test_an_animation_that_has_not_begun_or_is_over_gives_none(read_physics, rest: float) -> None:
    found = read_physics(mesh("Duck", FALL), layer=head(extra="timeCodesPerSecond = 24"), rest=rest)
    assert (only(found).moving, found.notes) == (None, ())


def test_without_a_start_the_first_frame_is_at_1(read_physics) -> None:
    moving = only(read_physics(mesh("Duck", FALL))).moving
    # five units in ten frames of 1/24 s, and nothing moves before 0
    np.testing.assert_allclose(moving, np.tile([0.0, -12.0, 0.0], (8, 1)), atol=1e-9)
    assert only(read_physics(mesh("Duck", FALL), rest=0.0)).moving is None


def test_points_that_are_animated_have_a_velocity_each(read_physics) -> None:
    alive = BOX.replace("points = ", "points.timeSamples = { 1: ").rstrip()
    alive += ", 2: " + BOX.split("points = ")[1].strip().replace(",1)", ",3)") + " }"
    layer = head(extra="timeCodesPerSecond = 24")
    moving = only(read_physics(prim("Mesh", "Duck", alive), layer=layer, rest=2.0)).moving
    assert moving is not None
    np.testing.assert_allclose(moving[:4], 0.0)
    np.testing.assert_allclose(moving[4:], np.tile([0, 0, 48.0], (4, 1)))


def test_authored_point_velocities_move_a_mesh_that_stands_still(read_physics) -> None:
    turned = """
        double xformOp:rotateZ = 90
        uniform token[] xformOpOrder = ["xformOp:rotateZ"]
    """
    velocities = "vector3f[] velocities = [" + ", ".join(["(2, 0, 0)"] * 8) + "]"
    layer = head(0.5, extra="startTimeCode = 1")
    found = read_physics(mesh("Duck", turned, velocities), layer=layer)
    moving = only(found).moving
    assert moving is not None
    np.testing.assert_allclose(moving, np.tile([0, 1, 0], (8, 1)), atol=1e-6)
    assert found.notes == ("</Duck>: starts with its authored velocities",)
    few = "vector3f[] velocities = [(2, 0, 0)]"
    found = read_physics(mesh("Duck", few), layer=layer)
    assert only(found).moving is None
    assert found.notes == (
        "</Duck>: its 1 velocities are not one finite vector for each point: ignored",
    )


@pytest.mark.parametrize(
    "line",
    [
        "float physics:mass = -3",
        "float physics:mass = inf",
        "float physics:density = nan",
        "vector3f physics:velocity = (nan, 0, 0)",
    ],
)
def test_numbers_that_make_no_sense_are_refused_with_prim_and_hint(read_physics, line: str) -> None:
    with pytest.raises(InputError) as caught:
        read_physics(mesh("Duck", line, apis=[RIGID, MASS]))
    name = line.split()[1]
    assert f"</Duck>: {name} is " in caught.value.message
    assert caught.value.hint.startswith("author ")

"""Which meshes of a stage are a body, what bodies meet, and how they move at the start."""

from __future__ import annotations

import re

import numpy as np
import pytest
from physics_stages import head, mesh, prim
from planned import at, cubes, noted, plan_fixture  # noqa: F401

from gf_usd.core.errors import UsageError

COLLISION, RIGID, MASS = "PhysicsCollisionAPI", "PhysicsRigidBodyAPI", "PhysicsMassAPI"


@pytest.mark.slow
def test_what_lies_apart_is_a_body_each(plan) -> None:
    seen = plan(cubes())
    assert seen.bodies.surfaces == (("/One",), ("/Two",))
    assert seen.bodies.embedded == {"/One": 0, "/Two": 1}
    # Of a cube of 1 m^3; 2 %: the strata of 200 particles.
    np.testing.assert_allclose(seen.bodies.radius, np.cbrt(0.75 / np.pi), rtol=0.02)
    np.testing.assert_array_equal(seen.particles.body, (seen.particles.X[:, 0] > 2).astype(int))
    assert noted(seen, "2 bodies, which collide: </One>, </Two>; --combine")
    one = plan(cubes(), combine=True)
    assert (one.bodies.count, one.particles.body) == (1, None)
    # One body of two lumps meets itself.
    assert one.contact_setup.self_contact == {0}
    assert not plan(cubes(), combine=True, self_contact=False).contact_setup.any


def test_what_one_rigid_body_holds_is_one(plan) -> None:
    seen = plan(prim("Xform", "Car", cubes(), apis=[RIGID]), mesh("Three", at(6.0)))
    assert seen.bodies.surfaces == (("/Car/One", "/Car/Two"), ("/Three",))


def test_a_sheet_moves_with_a_body_of_its_component(plan) -> None:
    """A label in front of the foot of a chess piece is nearer to the board."""
    sheet = (
        "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]\n"
        "point3f[] points = [(1.2, 1.05, 0), (1.4, 1.05, 0), (1.4, 1.05, 1), (1.2, 1.05, 1)]"
    )
    size = "float3 xformOp:scale = (3, 1, 1)\nuniform token[] xformOpOrder = ['xformOp:scale']"
    kind = 'kind = "component"'
    piece = mesh("Foot", at(0.0, 1.0)), prim("Mesh", "Label", sheet)
    seen = plan(
        prim("Xform", "Board", mesh("Top", size.replace("'", '"')), meta=kind),
        prim("Xform", "Piece", *piece, meta=kind),
    )
    assert seen.bodies.surfaces == (("/Board/Top",), ("/Piece/Foot",))
    assert seen.bodies.embedded["/Piece/Label"] == 1


def crumb(x: float, y: float, *lines: str, apis: tuple[str, ...] = ()) -> str:
    """/Crumb, a cube of a fifth of a meter of the lowest corner (x, y, 0)."""
    placed = (
        f"double3 xformOp:translate = ({x}, {y}, 0)",
        "double3 xformOp:scale = (0.2, 0.2, 0.2)",
        'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]',
    )
    return mesh("Crumb", *placed, *lines, apis=apis)


def test_a_crumb_is_one_body_with_what_is_next_to_it(plan) -> None:
    seen = plan(cubes(), crumb(3.4, 1.1))
    assert seen.bodies.surfaces == (("/One",), ("/Two", "/Crumb"))
    assert noted(
        seen, "</Crumb> has 8 particles, too few for a body of its own, and is one body with </Two>"
    )
    assert not noted(seen, "that touch")


def test_a_crumb_far_from_all_others_is_a_body_that_collides(plan) -> None:
    """One that had no node in common with its body fell through it."""
    seen = plan(cubes(), crumb(3.4, 2.0))
    assert seen.bodies.surfaces == (("/One",), ("/Two",), ("/Crumb",))
    assert noted(seen, "</Crumb> has only 8 particles, too few to bend: give more")
    assert not noted(seen, "merged")
    assert len(seen.contact_setup.skins) == 3


def test_a_crumb_is_not_merged_with_another_physics_body(plan) -> None:
    seen = plan(cubes(apis=(RIGID,)), crumb(0.4, 1.1, apis=(RIGID,)))
    assert seen.bodies.surfaces == (("/One",), ("/Two",), ("/Crumb",))


def test_meshes_that_touch_are_one_body_with_a_note(plan) -> None:
    seen = plan(mesh("One"), mesh("Two", at(1.0)), mesh("Far", at(5.0)))
    (note,) = (note for note in seen.notes if "meshes that touch or overlap" in note)
    # the page of an inspection has meters, the asset stage units
    assert re.search(r"move them more than [\d.]+ (cm|mm|m) \([\d.]+ stage units\) apart, or", note)
    assert seen.bodies.surfaces == (("/One", "/Two"), ("/Far",))
    assert noted(
        seen, "2 meshes that touch or overlap are one body: </One>, </Two>; to keep them apart"
    )
    pairs = [mesh(f"M{k}", at(k + k // 2)) for k in range(4)]
    assert noted(
        plan(*pairs), "4 meshes that touch or overlap are 2 bodies: </M0>, </M1>; </M2>, </M3>; to"
    )
    row = [mesh(f"M{k}", at(k)) for k in range(4)]
    assert noted(plan(*row), "are one body: </M0>, </M1> and 2 more; to keep them apart")


def test_what_is_meant_to_be_one_body_has_no_note(plan) -> None:
    both = mesh("One") + mesh("Two", at(1.0))
    assert not noted(plan(both, combine=True), "that touch")
    assert not noted(plan(prim("Xform", "Car", both, apis=[RIGID])), "that touch")


@pytest.mark.slow
def test_rigid_bodies_that_touch_stay_apart(plan) -> None:
    seen = plan(mesh("One", apis=[RIGID]), mesh("Two", at(1.0), apis=[RIGID]))
    assert seen.bodies.surfaces == (("/One",), ("/Two",))
    assert not noted(seen, "that touch")
    assert not noted(seen, "overlap")
    seen = plan(mesh("One", apis=[RIGID]), mesh("Two", at(0.8), apis=[RIGID]))
    assert seen.bodies.count == 2
    assert noted(seen, "</One> and </Two> are different physics bodies that overlap")
    seen = plan(mesh("One", apis=[RIGID]), mesh("Two", apis=[RIGID]))
    assert noted(seen, "</One> and </Two> are different physics bodies that overlap")


def test_skins_are_seen_from_outside(plan) -> None:
    from gf_usd.core.mesh.measures import signed_volume

    inside_out = 'uniform token orientation = "leftHanded"'
    seen = plan(cubes(inside_out))
    volumes = [signed_volume(s.points, s.triangles) for s in seen.contact_setup.skins]
    np.testing.assert_allclose(volumes, 1.0)


def test_filters_and_switched_off_collisions_let_bodies_pass(plan) -> None:
    floor = mesh("Floor", at(0.0, -3.0), apis=[COLLISION])
    assert plan(cubes(), floor).contact_setup.through == frozenset()
    filtered = "rel physics:filteredPairs = [</Two>, </Floor>]"
    seen = plan(cubes(filtered, apis=("PhysicsFilteredPairsAPI",)), floor).contact_setup
    assert {frozenset(pair) for pair in seen.through} == {frozenset({0, 1})}
    assert seen.through_colliders == {(0, 0)}
    off = "bool physics:collisionEnabled = false"
    seen = plan(cubes(off, apis=(COLLISION,)), floor).contact_setup
    assert {(0, 1)} <= seen.through
    assert seen.through_colliders == {(0, 0)}


def test_bodies_that_can_meet_themselves_do(plan) -> None:
    assert plan(cubes()).contact_setup.self_contact == frozenset(), "a cube cannot"
    assert plan(cubes(), self_contact=True).contact_setup.self_contact == {0, 1}
    assert plan(cubes(), self_contact=False).contact_setup.self_contact == frozenset()


def test_the_paper_and_updated_lagrangian_bodies_do_not_meet_themselves(plan) -> None:
    for options in ({"preset": "paper"}, {"solver": "ul"}):
        assert not plan(cubes(), **options).contact_setup.self_contact
        with pytest.raises(UsageError, match="--self-contact"):
            plan(cubes(), self_contact=True, **options)


def test_bodies_that_are_filtered_do_not_meet_themselves(plan) -> None:
    off = "bool physics:collisionEnabled = false"
    seen = plan(cubes(off, apis=(COLLISION,)), self_contact=True).contact_setup
    assert seen.self_contact == {1}


def test_rigid_velocities_of_one_body_only(plan) -> None:
    velocities = (
        "vector3f physics:velocity = (2, 0, 0)",
        "vector3f physics:angularVelocity = (0, 90, 0)",
    )
    one, two = plan(cubes(*velocities, apis=(RIGID,))).velocity
    X = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 1.5]])  # the middle, and a meter along z
    np.testing.assert_allclose(one(X), [[2, 0, 0], [2 + np.pi / 2, 0, 0]], atol=1e-6)
    assert two == (0.0, 0.0, 0.0)


def test_the_animation_before_the_start_moves_the_body_on(plan) -> None:
    fall = """
        double3 xformOp:translate.timeSamples = { 0: (0, 8, 0), 10: (0, 3, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    """
    layer = head(extra="timeCodesPerSecond = 24\nstartTimeCode = 10")
    one, two = plan(mesh("One", fall), mesh("Two", at(3.0)), layer=layer).velocity
    X = np.random.default_rng(0).random((5, 3))
    # Half a meter a frame, 24 frames per second.
    np.testing.assert_allclose(one(X), np.tile([0.0, -12.0, 0.0], (5, 1)), atol=1e-6)
    assert two == (0.0, 0.0, 0.0)
    # Played at half the speed, the same motion takes twice as long on the clock of the simulation.
    slow, _ = plan(
        mesh("One", fall), mesh("Two", at(3.0)), layer=layer, time_scale="2"
    ).velocity  # fmt: skip
    np.testing.assert_allclose(slow(X)[:, 1], -6.0, atol=1e-6)


@pytest.mark.parametrize("options", [{"skin": "idw"}, {"wls": True}, {"procrustes": 0.5}])
def test_options_that_know_one_body_refuse_two(plan, options) -> None:
    with pytest.raises(UsageError, match="supports one body, but there are 2"):
        plan(cubes(), **options)
    assert plan(cubes(), combine=True, **options).bodies.count == 1

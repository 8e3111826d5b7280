"""Obstacles: which prims, of what shape and friction."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from physics_stages import BOX, SLIDE, beside_a_body, bound, head, mesh, only, prim, volume

from gf_usd.core.errors import InputError
from gf_usd.core.stage import Collider, StagePhysics

Write = Callable[..., Path]

COLLISION = "PhysicsCollisionAPI"
HULL = ("PhysicsCollisionAPI", "PhysicsMeshCollisionAPI")
# Float32 points and matrices of size 1.
CLOSE = 1e-6
MIRROR = """
    double3 xformOp:scale = (-2, 1, 1)
    uniform token[] xformOpOrder = ["xformOp:scale"]
"""


@pytest.fixture
def read_physics(write: Write) -> Callable[..., StagePhysics]:
    """what a stage says besides the body that is baked."""
    return beside_a_body(write)


def normals(collider: Collider) -> np.ndarray:
    a, b, c = (collider.positions(0)[collider.triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def test_a_mesh_with_the_api_is_an_obstacle_in_meters(read_physics) -> None:
    floor = only(read_physics(mesh("Floor", MIRROR, apis=[COLLISION]), layer=head(0.01, "Z")))
    assert (floor.path, floor.shape, floor.role) == ("/Floor", "mesh", "static")
    np.testing.assert_allclose(floor.points.max(0), [0.0, 0.01, 0.01], atol=CLOSE)
    np.testing.assert_allclose(floor.points.min(0), [-0.02, 0.0, 0.0], atol=CLOSE)
    # outward although the scale turns it inside out
    assert volume(floor) == pytest.approx(2e-6, rel=1e-5)
    assert (floor.frames, floor.moves, floor.rigid) == (1, False, True)
    np.testing.assert_array_equal(floor.positions(2), floor.points)


@pytest.mark.parametrize(
    "other",
    [
        mesh("Plain"),
        mesh("Off", "bool physics:collisionEnabled = false", apis=[COLLISION]),
        prim("Scope", "Group", mesh("Off", apis=[COLLISION], meta="active = false")),
        f'class Mesh "Class" (prepend apiSchemas = ["{COLLISION}"]) {{\n{BOX}\n}}\n',
    ],
)
def test_what_does_not_collide(read_physics, other: str) -> None:
    assert read_physics(other).colliders == ()


@pytest.mark.parametrize(
    "line", ['token visibility = "invisible"', 'uniform token purpose = "guide"']
)
def test_what_is_not_seen_collides_all_the_same(read_physics, line: str) -> None:
    assert only(read_physics(mesh("Proxy", line, apis=[COLLISION]))).path == "/Proxy"


def test_the_baked_body_and_its_own_colliders_are_no_obstacles(read_physics) -> None:
    duck = prim(
        "Xform",
        "Duck",
        mesh("Look", apis=[COLLISION]),
        mesh("Proxy", 'uniform token purpose = "guide"', apis=[COLLISION]),
        apis=["PhysicsRigidBodyAPI"],
    )
    found = read_physics(duck, mesh("Floor", apis=[COLLISION]), bodies=("/Duck/Look",))
    assert only(found).path == "/Floor"
    assert found.notes == (
        "</Duck/Proxy> is the collider of a baked body: the surface of the body collides instead",
    )
    # and where the body is another one, both are in the way
    assert [c.path for c in read_physics(duck).colliders] == ["/Duck/Look", "/Duck/Proxy"]
    # without a rigid body above, the proxy is an obstacle of its own
    loose = duck.replace("PhysicsRigidBodyAPI", "PhysicsMassAPI")
    assert only(read_physics(loose, bodies=("/Duck/Look",))).path == "/Duck/Proxy"


def test_a_collider_under_a_baked_prim_is_no_obstacle(read_physics) -> None:
    duck = mesh("Duck", mesh("Proxy", 'uniform token purpose = "guide"', apis=[COLLISION]))
    assert read_physics(duck, bodies=("/Duck",)).colliders == ()
    assert only(read_physics(duck)).path == "/Duck/Proxy"


def test_the_colliders_of_copies_that_follow_a_baked_body_are_no_obstacles(read_physics) -> None:
    """Clones of a robot inherit from the first one, and follow what is baked of it."""
    guide = 'uniform token purpose = "guide"'
    robot = prim(
        "Xform", "Robot", mesh("Look"), mesh("Proxy", guide, apis=[COLLISION]),
        apis=["PhysicsRigidBodyAPI"],
    )  # fmt: skip
    clone = prim("Xform", "Clone", meta="inherits = </Robot>")
    stand = mesh("Stand", apis=[COLLISION])
    found = read_physics(robot, clone, stand, bodies=("/Robot/Look",))
    assert only(found).path == "/Stand"
    assert (
        "</Clone/Proxy> is a collider of a copy, by inherits, that follows a baked body: it does"
        " not collide"
    ) in found.notes
    # of a copy of what is not baked it is an obstacle
    apart = read_physics(robot, clone, stand, mesh("Ball"), bodies=("/Ball",))
    assert [c.path for c in apart.colliders] == ["/Robot/Proxy", "/Clone/Proxy", "/Stand"]


def test_an_obstacle_that_shares_the_shape_of_a_collider_is_no_copy_of_its_body(
    read_physics,
) -> None:
    """It follows nothing: only its points come from the collider of the baked body."""
    guide = 'uniform token purpose = "guide"'
    body = prim(
        "Xform", "A", mesh("Look"), mesh("Proxy", guide, apis=[COLLISION]),
        apis=["PhysicsRigidBodyAPI"],
    )  # fmt: skip
    shown = 'uniform token purpose = "default"'
    wall = prim("Mesh", "Wall", shown, meta="inherits = </A/Proxy>")
    found = read_physics(body, prim("Xform", "Step", wall), bodies=("/A/Look",))
    assert only(found).path == "/Step/Wall"
    assert not [note for note in found.notes if "/Step/Wall" in note]
    # nor is one of another body, which the baked one does not move
    other = prim("Xform", "Step", wall, apis=["PhysicsRigidBodyAPI"])
    assert only(read_physics(body, other, bodies=("/A/Look",))).path == "/Step/Wall"
    # a copy of the body has both
    copy = prim("Xform", "Copy", wall, meta="inherits = </A>")
    assert read_physics(body, copy, bodies=("/A/Look",)).colliders == ()


def test_a_collider_that_inherits_from_a_baked_mesh_follows_it(read_physics) -> None:
    duck = mesh("Duck", mesh("Proxy", 'uniform token purpose = "guide"', apis=[COLLISION]),
                apis=[COLLISION])  # fmt: skip
    copy = prim("Mesh", "Copy", meta="inherits = </Duck>")
    assert read_physics(duck, copy, bodies=("/Duck",)).colliders == ()


def test_a_soft_body_of_the_neighbors_owns_its_colliders(read_physics) -> None:
    jelly = prim(
        "Xform",
        "Jelly",
        mesh("Look"),
        mesh("Proxy", apis=[COLLISION]),
        apis=["OmniPhysicsDeformableBodyAPI"],
    )
    assert read_physics(jelly, bodies=("/Jelly/Look",)).colliders == ()


def test_a_rigid_body_that_is_not_baked_stays_and_this_is_said(read_physics) -> None:
    found = read_physics(mesh("Ball", apis=[COLLISION, "PhysicsRigidBodyAPI"]))
    assert only(found).role == "dynamic"
    assert found.notes == (
        "</Ball> is a rigid body, and rigid bodies are not simulated: it moves only if it is "
        "animated",
    )
    driven = mesh(
        "Ball", "bool physics:kinematicEnabled = true", apis=[COLLISION, "PhysicsRigidBodyAPI"]
    )
    assert (only(read_physics(driven)).role, read_physics(driven).notes) == ("kinematic", ())


@pytest.mark.parametrize(
    ("kind", "line", "size"),
    [
        ("Sphere", "double radius = 2", 4 / 3 * np.pi * 8),
        ("Cube", "double size = 2", 8.0),
        ("Capsule", "double radius = 1\ndouble height = 2", 10 / 3 * np.pi),
        ("Cylinder", "double radius = 1\ndouble height = 2", 2 * np.pi),
        ("Cone", "double radius = 1\ndouble height = 3", np.pi),
    ],
)
def test_implicit_shapes_collide(read_physics, kind: str, line: str, size: float) -> None:
    shape = only(read_physics(prim(kind, "Shape", line, apis=[COLLISION])))
    # the chords of 72 segments lose 0.13 % of a circle, in two directions of a ball
    assert volume(shape) == pytest.approx(size, rel=0.01)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize("mirror", ["", MIRROR])
def test_a_plane_is_the_half_space_behind_its_axis(read_physics, axis: str, mirror: str) -> None:
    lines = [f'uniform token axis = "{axis}"', "double width = 4", "double length = 6", mirror]
    plane = only(read_physics(prim("Plane", "Ground", *lines, apis=[COLLISION]), layer=head(0.5)))
    assert plane.shape == "plane"
    expected = np.eye(3)["XYZ".index(axis)]
    if mirror and axis == "X":
        expected = -expected  # the mirror turns this axis
    np.testing.assert_allclose(normals(plane), [expected, expected], atol=CLOSE)
    # UsdGeomPlane: width along X, or along Z where the axis is X; length along Y, or Z
    sizes = {"X": (0, 6, 4), "Y": (4, 0, 6), "Z": (4, 6, 0)}[axis]
    stretch = [2.0 if mirror else 1.0, 1.0, 1.0]
    np.testing.assert_allclose(np.ptp(plane.points, axis=0), 0.5 * np.array(sizes) * stretch)


def test_a_plane_without_an_axis_of_space_is_refused(read_physics) -> None:
    lines = ['uniform token axis = "W"', "double width = 0"]
    with pytest.raises(InputError, match="</Ground>: axis is 'W'"):
        read_physics(prim("Plane", "Ground", *lines, apis=[COLLISION]))
    plane = only(read_physics(prim("Plane", "Ground", lines[1], apis=[COLLISION])))
    np.testing.assert_allclose(normals(plane)[0], [0, 0, 1])


def test_hull_box_and_ball_stand_for_a_mesh(read_physics) -> None:
    # a cube with one corner pushed to its middle: hull 1 - 1/6 (the corner's tetrahedron)
    dented = BOX.replace("(1,1,1)]", "(0.5,0.5,0.5)]")

    def approximated(kind: str, *lines: str) -> Collider:
        token = f'uniform token physics:approximation = "{kind}"'
        return only(read_physics(prim("Mesh", "Rock", dented, token, *lines, apis=HULL)))

    assert volume(approximated("none")) < 0.8
    hull = approximated("convexHull")
    assert volume(hull) == pytest.approx(1 - 1 / 6, rel=1e-6)
    assert len(hull.points) == 7
    box = approximated("boundingCube", MIRROR)
    assert volume(box) == pytest.approx(2.0, rel=1e-6)
    assert (len(box.triangles), box.approximation) == (12, "boundingCube")
    ball = approximated("boundingSphere")
    center = ball.points.mean(0)
    np.testing.assert_allclose(center, [0.5, 0.5, 0.5], atol=CLOSE)
    np.testing.assert_allclose(np.linalg.norm(ball.points - center, axis=1), 0.75**0.5, rtol=1e-6)
    assert volume(ball) > 0


def test_an_approximation_that_is_left_out_is_said(read_physics) -> None:
    token = 'uniform token physics:approximation = "convexDecomposition"'
    found = read_physics(mesh("Rock", token, apis=HULL))
    assert volume(only(found)) == pytest.approx(1.0)
    assert found.notes == (
        "</Rock>: approximation convexDecomposition: its own triangles, which are finer, are used",
    )
    flat = prim(
        "Mesh",
        "Sheet",
        "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]",
        "point3f[] points = [(0,0,0), (1,0,0), (1,0,1), (0,0,1)]",
        'uniform token physics:approximation = "convexHull"',
        apis=HULL,
    )
    found = read_physics(flat)
    assert len(only(found).triangles) == 2
    assert found.notes[0].startswith("</Sheet> is flat: its own triangles are used")


def test_approximations_of_omniverse_are_the_own_triangles(read_physics) -> None:
    def found(kind: str) -> StagePhysics:
        token = f'uniform token physics:approximation = "{kind}"'
        return read_physics(mesh("Rock", token, apis=HULL))

    field, spheres = found("sdf"), found("sphereFill")
    assert (volume(only(field)), volume(only(spheres))) == pytest.approx((1.0, 1.0))
    assert field.notes == ()  # a distance field is that of the triangles
    assert spheres.notes == (
        "</Rock>: approximation sphereFill: its own triangles, which are finer, are used",
    )


def test_an_approximation_that_is_none_is_refused(read_physics) -> None:
    token = 'uniform token physics:approximation = "blob"'
    with pytest.raises(InputError) as caught:
        read_physics(mesh("Rock", token, apis=HULL))
    assert "</Rock>: physics:approximation is 'blob'" in caught.value.message
    assert "convexHull" in caught.value.hint


def test_colliders_in_instances_are_found(read_physics) -> None:
    asset = prim("Xform", "Proto", mesh("Floor", apis=[COLLISION]))
    place = "\n    ".join(["instanceable = true", "prepend references = </Proto>"])
    one = prim("Xform", "One", SLIDE, meta=place)
    paths = {c.path: c for c in read_physics(asset, one).colliders}
    assert set(paths) == {"/Proto/Floor", "/One/Floor"}
    assert paths["/One/Floor"].positions(2)[0, 0] == pytest.approx(4.0)


def test_what_a_point_instancer_repeats_is_left_out_and_this_is_said(read_physics) -> None:
    rocks = prim(
        "PointInstancer",
        "Rocks",
        "int[] protoIndices = [0, 0]\npoint3f[] positions = [(0, 0, 0), (1, 0, 0)]",
        "rel prototypes = </Rocks/Rock>",
        mesh("Rock", apis=[COLLISION]),
    )
    found = read_physics(rocks)
    assert found.colliders == ()
    assert found.notes == ("</Rocks>: PointInstancer: the colliders it repeats are left out",)
    assert read_physics(rocks.replace(COLLISION, "")).notes == ()


def test_colliders_without_a_surface_are_left_out_and_this_is_said(read_physics) -> None:
    squash = MIRROR.replace("(-2, 1, 1)", "(1, 0, 1)")
    found = read_physics(
        prim("Xform", "Empty", apis=[COLLISION]), mesh("Flat", squash, apis=[COLLISION])
    )
    assert found.colliders == ()
    assert found.notes[0] == "</Empty>: only meshes and implicit shapes collide, not Xform"
    assert found.notes[1].startswith("</Flat>: does not collide: its transform flattens it")


def test_a_broken_mesh_is_refused(read_physics) -> None:
    broken = BOX.replace("0,2,3,1", "0,2,3,99")
    with pytest.raises(
        InputError, match="</Rock>: 1 faceVertexIndices do not refer to any of its 8 points"
    ):
        read_physics(prim("Mesh", "Rock", broken, apis=[COLLISION]))


def test_friction_and_restitution_come_from_the_bound_material(read_physics) -> None:
    material = prim(
        "Material",
        "Ice",
        "float physics:staticFriction = 0.25\nfloat physics:dynamicFriction = 0.125",
        "float physics:restitution = 0.5",
        apis=["PhysicsMaterialAPI"],
    )

    def ground(*lines: str) -> Collider:
        apis = [COLLISION, "MaterialBindingAPI"]
        return only(read_physics(material, prim("Cube", "Ground", *lines, apis=apis)))

    for purpose in ("physics", ""):
        spec = ground(bound("/Ice", purpose)).spec
        assert (spec.static_friction, spec.dynamic_friction) == (0.25, 0.125)
        assert (spec.path, spec.restitution, spec.friction) == ("/Ice", 0.5, 0.125)
    spec = ground().spec
    assert (spec.path, spec.friction, spec.restitution) == ("", None, None)

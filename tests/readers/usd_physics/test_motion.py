"""Where obstacles are at each frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from physics_stages import BOX, SLIDE, beside_a_body, head, mesh, only, prim, volume

from gf_usd.core.errors import InputError
from gf_usd.core.stage import StagePhysics

COLLISION = "PhysicsCollisionAPI"
HULL = ("PhysicsCollisionAPI", "PhysicsMeshCollisionAPI")
CLOSE = 1e-6  # float32 points of size 1


@pytest.fixture
def read_physics(write: Callable[..., Path]) -> Callable[..., StagePhysics]:
    """what a stage says besides the body that is baked."""
    return beside_a_body(write)


def test_a_collider_moves_with_the_transforms_above_it(read_physics) -> None:
    layer = head(0.5, extra="timeCodesPerSecond = 24\nstartTimeCode = 1")
    turning = """
        double xformOp:rotateY.timeSamples = { 1: 0, 3: 180 }
        uniform token[] xformOpOrder = ["xformOp:rotateY"]
    """
    moving = prim("Xform", "Arm", SLIDE, mesh("Hand", turning, apis=[COLLISION]))
    hand = only(read_physics(moving, layer=layer))
    assert (hand.frames, hand.moves, hand.rigid) == (3, True, True)
    # the corner (1, 0, 0): half way it has turned to -Z and slid by two units of half a meter
    corner = [hand.positions(k)[1] for k in range(3)]
    np.testing.assert_allclose(corner, [[0.5, 0, 0], [1, 0, -0.5], [1.5, 0, 0]], atol=CLOSE)
    np.testing.assert_allclose(hand.positions(0), hand.points, atol=CLOSE)


def test_a_growing_collider_is_not_rigid(read_physics) -> None:
    grow = SLIDE.replace("translate", "scale").replace("(0, 0, 0)", "(1, 1, 1)")
    collider = only(read_physics(mesh("Balloon", grow, apis=[COLLISION])))
    assert (collider.moves, collider.rigid) == (True, False)


TURNS = SLIDE.replace("translate", "scale").replace("(4, 0, 0)", "(-1, 1, 1)")


@pytest.mark.parametrize("above", [False, True])
def test_a_collider_that_is_mirrored_on_its_way_is_refused(read_physics, above: bool) -> None:
    """Its faces turned inward in the middle of the bake."""
    turns = TURNS.replace("(0, 0, 0)", "(1, 1, 1)")
    shape = mesh("Hand", "" if above else turns, apis=[COLLISION])
    with pytest.raises(InputError) as error:
        read_physics(prim("Xform", "Arm", turns, shape) if above else shape)
    assert "Hand> is a mirror image of its rest pose at time code 3: its scale" in str(error.value)


def test_a_collider_that_is_always_mirrored_faces_outward(read_physics) -> None:
    always = TURNS.replace("(0, 0, 0)", "(-2, 1, 1)")
    hand = only(read_physics(mesh("Hand", always, apis=[COLLISION])))
    assert [volume(hand, k) for k in range(3)] == pytest.approx([2.0, 1.5, 1.0])


def test_points_that_move_by_themselves_are_given_outright(read_physics) -> None:
    points = BOX.split("points = ")[1]
    lifted = points.replace(",1)", ",3)")
    alive = BOX.replace("points = ", "points.timeSamples = { 1: ").rstrip()
    alive += f", 3: {lifted.strip()} }}"
    blob = only(read_physics(prim("Mesh", "Blob", alive, apis=[COLLISION])))
    assert blob.deformed is not None
    assert (blob.frames, blob.rigid) == (3, False)
    np.testing.assert_allclose([blob.positions(k)[7, 2] for k in range(3)], [1, 2, 3])


def test_a_hull_follows_the_points_of_its_mesh_and_a_box_its_transform(read_physics) -> None:
    alive = BOX.replace("points = ", "points.timeSamples = { 1: ").rstrip()
    alive += ", 3: " + BOX.split("points = ")[1].strip().replace(",1)", ",3)") + " }"
    token = 'uniform token physics:approximation = "{}"'
    hull = only(read_physics(prim("Mesh", "B", alive, token.format("convexHull"), apis=HULL)))
    assert [volume(hull, k) for k in range(3)] == pytest.approx([1, 2, 3])
    found = read_physics(prim("Mesh", "B", alive, SLIDE, token.format("boundingCube"), apis=HULL))
    box = only(found)
    assert [volume(box, k) for k in range(3)] == pytest.approx([1, 1, 1])
    assert box.positions(2).min(0)[0] == pytest.approx(4.0)
    assert found.notes == ("</B>: deforms, but its approximation only follows its transform",)


def test_points_that_change_in_number_are_held_and_this_is_said(read_physics) -> None:
    alive = BOX.replace("points = ", "points.timeSamples = { 1: ").rstrip()
    alive += ", 3: [(0,0,0),(1,0,0),(0,1,0),(1,1,0),(0,0,1),(1,0,1),(0,1,1),(1,1,1),(2,2,2)] }"
    found = read_physics(prim("Mesh", "Blob", alive, apis=[COLLISION]))
    assert only(found).deformed is None
    assert found.notes == (
        "</Blob> has 9 points at time code 3 but 8 at rest: it only follows its transform",
    )


def test_a_skeleton_moves_the_points(read_physics) -> None:
    skeleton = """
    def Skeleton "Skel" (
        prepend apiSchemas = ["SkelBindingAPI"]
    )
    {
        uniform token[] joints = ["hip"]
        uniform matrix4d[] bindTransforms = [((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1))]
        uniform matrix4d[] restTransforms = [((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1))]
        rel skel:animationSource = </Rig/Skel/Walk>
        def SkelAnimation "Walk"
        {
            uniform token[] joints = ["hip"]
            float3[] translations.timeSamples = { 1: [(0, 0, 0)], 3: [(0, 4, 0)] }
            quatf[] rotations = [(1, 0, 0, 0)]
            half3[] scales = [(1, 1, 1)]
        }
    }
    """
    weights = "\n".join(
        f"{kind}[] primvars:skel:{name} = [{value}] (\n"
        'elementSize = 1\ninterpolation = "constant"\n)'
        for kind, name, value in (("int", "jointIndices", 0), ("float", "jointWeights", 1))
    )
    skin = mesh(
        "Skin",
        weights,
        "rel skel:skeleton = </Rig/Skel>",
        apis=[COLLISION, "SkelBindingAPI"],
    )
    collider = only(read_physics(prim("SkelRoot", "Rig", skeleton, skin)))
    assert collider.deformed is not None
    np.testing.assert_allclose(
        [collider.positions(k)[0, 1] for k in range(3)], [0, 2, 4], atol=CLOSE
    )
    still = skeleton.replace("3: [(0, 4, 0)]", "3: [(0, 0, 0)]")
    collider = only(read_physics(prim("SkelRoot", "Rig", still, skin)))
    assert (collider.deformed, collider.moves, collider.rigid) == (None, False, True)
    # the transform of a skinned mesh has no part in where its points are
    skated = skin.replace("rel skel:skeleton", SLIDE + "\nrel skel:skeleton")
    collider = only(read_physics(prim("SkelRoot", "Rig", still, skated)))
    assert not collider.moves

"""Gravity of a stage, and refusals that concern all of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from physics_stages import head, mesh, physics_of, prim

from gf_usd.core.errors import InputError

Write = Callable[..., Path]

ASSET = mesh("Asset")


def scene(*lines: str, name: str = "Scene") -> str:
    return prim("PhysicsScene", name, *lines)


def test_a_stage_without_a_scene_has_no_gravity(write: Write) -> None:
    physics = physics_of(write(ASSET))
    assert (physics.gravity, physics.scene) == (None, "")
    assert physics.colliders == physics.bodies == physics.ignored == physics.notes == ()


@pytest.mark.parametrize(
    ("layer", "lines", "expected"),
    [
        (head(), [], (0, -9.81, 0)),
        (head(up="Z"), [], (0, 0, -9.81)),
        # earth's gravity is what it is in any unit
        (head(0.01), ["float physics:gravityMagnitude = -inf"], (0, -9.81, 0)),
        (head(0.01), ["float physics:gravityMagnitude = -1"], (0, -9.81, 0)),
        (head(0.01), ["float physics:gravityMagnitude = 981"], (0, -9.81, 0)),
        (head(0.01), ["float physics:gravityMagnitude = 0"], (0, 0, 0)),
        (head(), ["vector3f physics:gravityDirection = (0, 0, 0)"], (0, -9.81, 0)),
        (
            head(0.5),
            [
                "vector3f physics:gravityDirection = (3, 0, -4)",
                "float physics:gravityMagnitude = 10",
            ],
            (3, 0, -4),
        ),
    ],
)
def test_gravity_is_that_of_usd_physics_in_si(
    write: Write, layer: str, lines: list[str], expected: tuple[float, ...]
) -> None:
    physics = physics_of(write(layer + ASSET + scene(*lines)))
    assert physics.gravity is not None
    np.testing.assert_allclose(physics.gravity, expected, rtol=1e-6)  # float32 in the file
    assert physics.scene == "/Scene"


def test_of_several_scenes_the_first_counts_and_this_is_said(write: Write) -> None:
    moon = scene("float physics:gravityMagnitude = 1.62", name="Moon")
    physics = physics_of(write(ASSET + moon + scene()))
    assert physics.gravity == pytest.approx((0, -1.62, 0), rel=1e-6)
    assert physics.notes == ("</Scene> is a second PhysicsScene: only </Moon> is used",)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("float physics:gravityMagnitude = nan", "physics:gravityMagnitude is nan"),
        ("float physics:gravityMagnitude = inf", "physics:gravityMagnitude is inf"),
        ("float physics:gravityMagnitude = 1e30", "physics:gravityMagnitude is 1e+30"),
        ("vector3f physics:gravityDirection = (nan, 0, 0)", "physics:gravityDirection is"),
    ],
)
def test_gravity_that_is_no_number_is_refused(write: Write, line: str, message: str) -> None:
    path = write(ASSET + scene(line))
    with pytest.raises(InputError) as caught:
        physics_of(path)
    assert caught.value.message.startswith(f"{path}: </Scene>: {message}")
    assert "author" in caught.value.hint


JOINT = "is a joint"


def joint(kind: str, name: str, *lines: str, one: str = "", two: str = "") -> str:
    ends = [f"rel physics:body{k} = <{path}>" for k, path in enumerate((one, two)) if path]
    return prim(kind, name, *ends, *lines)


@pytest.mark.parametrize(
    "kind", ["PhysicsFixedJoint", "PhysicsRevoluteJoint", "PhysicsSphericalJoint", "PhysicsJoint"]
)
def test_a_joint_of_what_is_baked_is_named_as_not_simulated(write: Write, kind: str) -> None:
    rig = prim("Xform", "Rig", mesh("Asset"), apis=["PhysicsRigidBodyAPI"])
    physics = physics_of(write(head() + rig + joint(kind, "Weld", one="/Rig")), "/Rig/Asset")
    (note,) = physics.notes
    assert note.startswith(f"</Weld> {JOINT}")
    assert "--pin" in note
    assert "--combine" in note


def test_a_joint_connects_the_rigid_body_that_its_frame_is_in(write: Write) -> None:
    """The frame may be a prim in the body; an Xform above all that is no body is the world's."""
    rig = prim("Xform", "Rig", mesh("Asset") + prim("Xform", "Frame"), apis=["PhysicsRigidBodyAPI"])
    held = joint("PhysicsFixedJoint", "Held", one="/World/Rig/Frame")
    far = mesh("Far") + joint("PhysicsFixedJoint", "Door", one="/World", two="/World/Far")
    physics = physics_of(
        write(head() + prim("Xform", "World", rig + held + far)), "/World/Rig/Asset"
    )
    (note,) = [one for one in physics.notes if JOINT in one]
    assert note.startswith("</World/Held> is ")


@pytest.mark.parametrize(
    "other",
    [
        joint("PhysicsFixedJoint", "Off", "bool physics:jointEnabled = 0", two="/Asset"),
        mesh("Far") + joint("PhysicsFixedJoint", "Elsewhere", one="/Far"),
        joint("PhysicsFixedJoint", "Loose"),
    ],
    ids=["switched off", "of others", "of nothing"],
)
def test_joints_of_nothing_that_is_baked_are_no_matter(write: Write, other: str) -> None:
    physics = physics_of(write(head() + mesh("Asset") + other), "/Asset", facts_from="/Asset")
    assert physics.notes == ()


def test_a_body_that_is_no_prim_is_refused(write: Write) -> None:
    with pytest.raises(InputError, match="there is no prim /Aset"):
        physics_of(write(ASSET), "/Aset")

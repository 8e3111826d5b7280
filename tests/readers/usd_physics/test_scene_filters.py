"""Pairs that pass through each other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from physics_stages import head, mesh, physics_of, prim

Write = Callable[..., Path]

COLLISION, FILTER = "PhysicsCollisionAPI", "PhysicsFilteredPairsAPI"
BODIES = ("/One", "/Two")
OBSTACLES = prim("Xform", "Room", mesh("Floor", apis=[COLLISION]), mesh("Wall", apis=[COLLISION]))


@pytest.fixture
def ignored(write: Write) -> Callable[..., set[tuple[str, str]]]:
    """The pairs of bodies /One and /Two, /Room/Floor and /Room/Wall."""

    def ignored(*prims: str, bodies: tuple[str, ...] = BODIES) -> set[tuple[str, str]]:
        path = write(head() + "".join(prims))
        physics = physics_of(path, *bodies)
        assert len(set(physics.ignored)) == len(physics.ignored)
        return set(physics.ignored)

    return ignored


def filtered(*targets: str) -> str:
    return f"rel physics:filteredPairs = [{', '.join(f'<{target}>' for target in targets)}]"


def group(name: str, *members: str, lines: str = "") -> str:
    includes = ", ".join(f"<{member}>" for member in members)
    return prim(
        "PhysicsCollisionGroup", name, f"rel collection:colliders:includes = [{includes}]", lines
    )


def test_all_bodies_collide_unless_filtered(ignored) -> None:
    assert ignored(mesh("One"), mesh("Two"), OBSTACLES) == set()
    # the relationship without its API says nothing
    assert ignored(mesh("One", filtered("/Two")), mesh("Two"), OBSTACLES) == set()


def test_filtered_pairs_work_both_ways(ignored) -> None:
    one = mesh("One", filtered("/Room/Floor"), apis=[FILTER])
    assert ignored(one, mesh("Two"), OBSTACLES) == {("/One", "/Room/Floor")}
    room = OBSTACLES.replace(
        'def Mesh "Wall" (\nprepend apiSchemas = ["PhysicsCollisionAPI"]\n\n)\n{',
        f'def Mesh "Wall" (\nprepend apiSchemas = ["{COLLISION}", "{FILTER}"]\n)\n{{\n'
        + filtered("/Two"),
    )
    assert ignored(mesh("One"), mesh("Two"), room) == {("/Two", "/Room/Wall")}


def test_a_filter_names_all_below_its_target_and_bodies_too(ignored) -> None:
    one = mesh("One", filtered("/Room", "/Two"), apis=[FILTER])
    assert ignored(one, mesh("Two"), OBSTACLES) == {
        ("/One", "/Two"),
        ("/One", "/Room/Floor"),
        ("/One", "/Room/Wall"),
    }


def test_a_baked_body_is_meant_by_its_own_colliders(ignored) -> None:
    duck = prim(
        "Xform",
        "Duck",
        mesh("Look"),
        mesh("Proxy", filtered("/Room/Wall"), apis=[COLLISION, FILTER]),
        apis=["PhysicsRigidBodyAPI"],
    )
    pairs = ignored(mesh("Two"), duck, OBSTACLES, bodies=("/Duck/Look", "/Two"))
    assert pairs == {("/Duck/Look", "/Room/Wall")}


def test_collision_groups_keep_apart(ignored) -> None:
    stage = [mesh("One"), mesh("Two"), OBSTACLES]
    soft = group("Soft", "/One", "/Two", lines="rel physics:filteredGroups = </Hard>")
    hard = group("Hard", "/Room/Wall")
    assert ignored(*stage, soft, hard) == {("/One", "/Room/Wall"), ("/Two", "/Room/Wall")}
    assert ignored(*stage, soft.replace("</Hard>", "</Soft>"), hard) == {("/One", "/Two")}
    # inverted: everything but the group that is named
    inverted = soft.replace(
        "rel physics:filtered", "bool physics:invertFilteredGroups = true\nrel physics:filtered"
    )
    assert ignored(*stage, inverted, hard) == {("/One", "/Two")}
    assert ignored(*stage, group("Soft", "/One"), hard) == set()

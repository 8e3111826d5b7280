"""Surfaces that overlap or touch are one body; what lies apart is not."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from solids import cube, solid, sphere

from gf_usd.core.asset import Surface
from gf_usd.geometry.connected.bodies import find_bodies, overlapping


def found(*surfaces, spacing: float = 0.1, **more) -> list[int]:
    return find_bodies(solid(*surfaces), spacing, **more).tolist()


@pytest.mark.slow
def test_a_nose_in_a_head_and_a_hat_on_it_fall_as_one() -> None:
    head = sphere(1.0, path="/Head")
    nose = sphere(0.2, center=(1.0, 0.0, 0.0), path="/Nose")
    hat = cube((-0.5, 1.0, -0.5), 1.0, path="/Hat")  # touches the top vertex
    assert found(head, nose, hat) == [0, 0, 0]


def test_what_lies_apart_does_not() -> None:
    left, right = cube(path="/Left"), cube((1.1, 0.0, 0.0), path="/Right")
    assert found(left, right) == [0, 1]  # a spacing apart
    assert found(left, right, spacing=1.0) == [0, 0]  # a tenth of a spacing
    assert found(left, right, combine=True) == [0, 0]


def test_a_chain_is_one_body_and_numbers_follow_the_surfaces() -> None:
    far = cube((9.0, 0.0, 0.0), path="/Far")
    links = [cube((float(k), 0.0, 0.0), (1.0, 0.2, 0.2), path=f"/L{k}") for k in range(3)]
    assert found(links[0], far, links[1], links[2]) == [0, 1, 0, 0]


def test_a_thing_inside_another_is_a_part_of_it() -> None:
    assert found(cube((-2, -2, -2), 4.0, path="/Box"), cube(path="/In")) == [0, 0]


def test_faces_that_cross_far_from_any_vertex_are_seen() -> None:
    """Two crossed bars: no vertex of one is near the other."""
    along = cube((-5, -0.1, -0.1), (10, 0.2, 0.2), path="/A")
    across = cube((-0.1, -0.1, -5), (0.2, 0.2, 10), path="/B")
    assert found(along, across) == [0, 0]


def test_what_one_owner_holds_is_one_body() -> None:
    three = [cube((3.0 * k, 0.0, 0.0), path=f"/C{k}") for k in range(3)]
    assert found(*three, owners=["/Car", "", "/Car"]) == [0, 1, 0]
    assert found(*three, owners=["", "", ""]) == [0, 1, 2]


def test_what_two_owners_hold_is_never_one_body() -> None:
    """A stack of rigid bodies that touch, and of two with a cushion of no owner between them."""
    stack = [cube((0.0, float(k), 0.0), path=f"/C{k}") for k in range(3)]
    assert found(*stack, owners=["/A", "/B", "/C"]) == [0, 1, 2]
    assert found(*stack, owners=["/A", "", "/C"]) == [0, 0, 1]
    assert found(*stack, owners=["/A", "/B", "/A"]) == [0, 1, 0]


def part(component: str, low: float, height: float = 1.0) -> Surface:
    made = cube(
        (0.0, low, 0.0), (1.0, height, 1.0), path=f"{component}/Mesh_{low:g}".replace(".", "_")
    )
    return replace(made, component=component)


@pytest.mark.slow
def test_components_that_touch_are_separate_and_those_that_overlap_are_not() -> None:
    assert found(part("/Board", 0.0), part("/Piece", 1.0)) == [0, 1]
    assert found(part("/Board", 0.0), part("/Piece", 0.99)) == [0, 1]  # a tenth of a spacing deep
    assert found(part("/Board", 0.0), part("/Piece", 0.9)) == [0, 0]
    assert found(part("/Board", 0.0), part("/Board", 1.0)) == [0, 0]  # parts of one component
    assert found(part("/Board", 0.0), part("", 1.0)) == [0, 0]
    assert found(part("/Board", 0.0), part("/Piece", 1.0), combine=True) == [0, 0]


def of(component: str, surface: Surface, name: str) -> Surface:
    return replace(surface, component=component, path=f"{component}/{name}")


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [0.1, 0.5])
def test_thin_components_that_overlap_are_one(spacing: float) -> None:
    """No point of a plate thinner than half a spacing is a quarter of a spacing deep."""
    flat = of("/A", cube((0.0, 0.0, 0.0), (1.0, 0.04, 1.0)), "M")
    across = of("/B", cube((0.5, -0.5, 0.0), (0.04, 1.0, 1.0)), "M")
    beside = of("/B", cube((0.5, 0.0, 0.0), (1.0, 0.04, 1.0)), "M")
    above = of("/B", cube((0.0, 0.04, 0.0), (1.0, 0.04, 1.0)), "M")
    rod = of("/B", cube((-20.0, 0.0, 0.0), (40.0, 0.1, 0.1)), "M")
    assert found(flat, across, spacing=spacing) == [0, 0]
    assert found(flat, beside, spacing=spacing) == [0, 0]
    assert found(flat, above, spacing=spacing) == [0, 1]
    assert found(of("/A", cube((0.0, -0.5, -0.5)), "M"), rod, spacing=spacing) == [0, 0]


@pytest.mark.slow
def test_components_at_the_same_place_are_one() -> None:
    """No point of one surface is inside the other one."""
    assert found(of("/A", cube(), "M"), of("/B", cube(), "M")) == [0, 0]
    assert found(of("/A", sphere(), "M"), of("/B", sphere(), "M")) == [0, 0]


@pytest.mark.slow
def test_bodies_of_components_do_not_depend_on_the_order() -> None:
    """a and a2 are of A, b and b2 of B; a touches a2 and b, and a2 overlaps b2."""
    a = of("/A", cube((0.0, 0.0, 0.0)), "a")
    a2 = of("/A", cube((1.0, 0.0, 0.0)), "a2")
    b = of("/B", cube((0.0, 1.0, 0.0)), "b")
    b2 = of("/B", cube((1.5, 0.2, 0.2), (1.0, 0.5, 0.5)), "b2")
    assert all(found(*order) == [0, 0, 0, 0] for order in permutations((a, a2, b, b2)))


def test_what_belongs_to_no_component_joins_no_two() -> None:
    cloth = part("", 1.0, 0.5)
    assert found(part("/Table", 0.0), cloth, part("/Cup", 1.5)) == [0, 0, 1]
    assert found(part("/Table", 0.0), cloth, part("/Cup", 1.2)) == [0, 1, 1]  # deep in the cloth


def test_a_physics_body_may_hold_components() -> None:
    stack = [part("/A", 0.0), part("/B", 1.0), part("/C", 2.0)]
    assert found(*stack, owners=["/Rigid", "/Rigid", ""]) == [0, 0, 1]


def test_an_owner_of_two_kinds_holds_a_body_of_each() -> None:
    three = [cube((float(k), 0.0, 0.0), path=f"/C{k}") for k in range(3)]
    assert found(*three, owners=["/Car"] * 3, kinds=np.array([0, 1, 0])) == [0, 1, 0]


def test_owners_that_overlap_are_found_and_those_that_touch_are_not() -> None:
    bodies = [cube((0.9 * k, 0.0, 0.0), path=f"/C{k}") for k in range(2)]
    bodies += [cube((1.9, 0.0, 0.0), path="/C2"), cube((1.9, 0.5, 0.0), path="/C3")]
    seen = solid(*bodies)
    of, owners = np.arange(4), ["/A", "/B", "/C", ""]
    assert overlapping(seen, 0.1, of, owners) == [(0, 1)]
    assert overlapping(seen, 0.1, np.zeros(4, int), owners) == []
    assert overlapping(seen, 0.1, of, ["", "/B", "", ""]) == []


def test_a_copy_at_the_same_place_overlaps() -> None:
    """No point of its surface is inside the other one, but those inside it are."""
    seen = solid(*(cube((float(x), 0.0, 0.0), path=f"/C{k}") for k, x in enumerate((0, 0, 1))))
    # a neighbor shares a face, and has no point inside
    inner = [surface.points.mean(0)[None] for surface in seen.surfaces]
    of, owners = np.arange(3), ["/A", "/B", "/C"]
    assert overlapping(seen, 0.1, of, owners, inner) == [(0, 1)]

"""How many particles a bake has where nobody says: by the thickness of thin parts."""

from __future__ import annotations

from typing import Any

import pytest
from physics_stages import mesh, prim
from planned import at, noted, plan_fixture  # noqa: F401

from gf_usd.core.stage import StageSpec
from gf_usd.geometry.connected import bodies
from gf_usd.geometry.thin.thickness import Thickness
from gf_usd.prepare.settings import by_thickness, resolution


def thick(thin: float) -> Thickness:
    return Thickness(thin=thin, median=1.0)


def test_a_body_without_thin_parts_keeps_the_default() -> None:
    # 8000 in 1 m^3 are 5 cm apart: 15 cm hold three
    for one in (thick(0.151), thick(1.0), None):
        made = by_thickness(1.0, one)
        assert (made.particles, made.spacing, made.note) == (8000, None, "")


def test_thin_parts_take_three_across() -> None:
    made = by_thickness(1.0, thick(0.12))
    assert made.particles == pytest.approx((3.0 / 0.12) ** 3, abs=1)
    assert (1.0 / made.particles) ** (1.0 / 3.0) == pytest.approx(0.04)
    assert made.note == (
        "5 % of the surface is at most 12 cm thick: 15625 particles put 3 across it and take"
        " up to 2.4 times as long as 8000"
    )


def test_the_budget_ends_it_and_says_so() -> None:
    made = by_thickness(1.0, thick(0.05))
    assert made.particles == 32000
    assert (
        "32000 particles, the most by default, put 1.6 across it and take up to 6.3 times"
        in made.note
    )
    # (1 / 32000)^(1/3) = .0315 m: 1.6 of them; (3 / .05)^3 = 216000
    assert made.note.endswith(
        "as long as 8000; --particles 220000 would put 3 across and take up to 13 times as long"
    )


def test_numbers_that_differ_by_nothing_are_not_reported() -> None:
    # 8101 particles would take "1.0 times as long"
    made = by_thickness(1.0, thick(3.0 / 8101 ** (1.0 / 3.0)))
    assert made.particles in (8101, 8102)
    assert made.note == ""
    # 32000 put 2.98 across it: that 33000 would put 3 is no advice
    made = by_thickness(1.0, thick(3.0 / 32600 ** (1.0 / 3.0)))
    assert made.particles == 32000
    assert made.note.endswith(
        "32000 particles put 3 across it and take up to 6.3 times as long as 8000"
    )


def test_what_no_sensible_number_fills_gets_no_advice() -> None:
    made = by_thickness(1.0, thick(0.01))
    assert made.note.endswith("; 3 across would need more than 2000000 particles")


@pytest.mark.parametrize(
    ("particles", "spacing", "paper"), [(500, None, False), (None, 0.1, False), (None, None, True)]
)
def test_what_was_asked_for_wins_and_nothing_is_measured(particles, spacing, paper) -> None:
    def never():
        raise AssertionError("evaluated in vain")

    made = resolution(particles, spacing, StageSpec(), dict, never, paper=paper)
    assert made.spacing == spacing
    assert made.particles == (particles or (120 if paper else 8000))


def test_where_nobody_says_anything_the_thickness_is_asked() -> None:
    made = resolution(None, None, StageSpec(), dict, lambda: (1.0, thick(0.12)), paper=False)
    assert made.particles == 15625
    assert resolution(None, None, StageSpec(), dict, None, paper=False).particles == 8000


def test_thin_walls_that_take_more_particles_than_asked_for_are_reported(plan) -> None:
    """A plate of a tenth of a cell has eight particles in each cell, whatever its volume."""
    scaled = 'float3 xformOp:scale = (1, 0.01, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    thin = plan(mesh("Plate", scaled), particles=200)
    assert len(thin.particles) > 400
    assert noted(thin, f"there are {len(thin.particles)} particles instead of 200")
    assert noted(thin, "for fewer, give a larger --spacing in place of --particles")
    assert not noted(thin, "at least 16")
    tiny = plan(mesh("Plate", scaled), particles=2)
    assert noted(tiny, f"there are {len(tiny.particles)} particles instead of 2: a bake needs at")
    assert not noted(plan(mesh("Block"), particles=200), "instead of")
    # a spacing requires no number
    assert not noted(plan(mesh("Plate", scaled), particles=None, spacing=0.05), "instead")


def test_sheets_have_as_many_particles_as_asked_for_or_a_note_says_so(plan) -> None:
    quad = (
        "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]\n"
        "point3f[] points = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)]"
    )
    # one layer of n^2 cells with eight particles each: n = 5
    seen = plan(prim("Mesh", "Flag", quad), particles=200, repair=True)
    assert len(seen.particles) == 200
    assert not noted(seen, "instead of")
    # n = 1 are 8, n = 2 are 32
    seen = plan(prim("Mesh", "Flag", quad), particles=20, repair=True)
    assert noted(seen, f"{len(seen.particles)} particles instead of 20: --spacing")


RIGID = ("PhysicsRigidBodyAPI",)


@pytest.mark.parametrize(("thin", "searches"), [(False, 1), (True, 2)])
def test_bodies_are_searched_once_for_each_spacing(
    plan, monkeypatch: pytest.MonkeyPatch, thin: bool, searches: int
) -> None:
    """For the thickness at the default spacing, and again where thin parts take a finer one."""
    found: list[float] = []
    find_bodies = bodies.find_bodies

    def counted(solid: Any, spacing: float, **options: Any) -> Any:
        found.append(spacing)
        return find_bodies(solid, spacing, **options)

    monkeypatch.setattr(bodies, "find_bodies", counted)
    flat = 'float3 xformOp:scale = (1, 0.14, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    one, two = mesh("One", *([flat] if thin else []), apis=RIGID), mesh("Two", at(3.0), apis=RIGID)
    seen = plan(one, two, particles=None)
    assert seen.bodies is not None
    assert seen.bodies.count == 2
    assert len(found) == len(set(found)) == searches


@pytest.mark.parametrize("kind", ["physics bodies", "components"])
def test_a_plate_that_is_a_body_is_filled_by_its_own_thickness(plan, kind: str) -> None:
    """Rays through it continued through the body that it lies on."""
    lies = (
        "double3 xformOp:translate = (0, 1, 0)\nfloat3 xformOp:scale = (1, 0.14, 1)\n"
        'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]'
    )
    if kind == "components":
        model = 'def Xform "%s" (kind = "component")\n{\n%s\n}\n'
        stage = model % ("A", mesh("Box")) + model % ("B", mesh("Plate", lies))
    else:
        stage = mesh("Box", apis=RIGID) + mesh("Plate", lies, apis=RIGID)
    seen = plan(stage, particles=None)
    assert seen.bodies is not None
    assert seen.bodies.count == 2
    # three across 0.14 m of 1.14 m^3; 8,000 without it
    assert len(seen.particles) == pytest.approx(1.14 * (3.0 / 0.14) ** 3, rel=0.1)

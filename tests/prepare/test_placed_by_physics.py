"""Where bodies begin that a stage with UsdPhysics has placed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import gf_usd

BALL = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.5
    upAxis = "Y"
)
def Xform "World"
{
    %s
    def Sphere "Ball"
    {
        double3 xformOp:translate = (0, %g, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
PHYSICS = 'def PhysicsScene "Physics"\n    {\n    }'


@pytest.mark.parametrize(
    ("middle", "options", "lift"),
    [
        (3.0, {}, 0.0),
        (3.0, {"floor": 1.5}, 0.0),
        (0.25, {}, 0.375),
        (0.25, {"floor": -0.75}, 0.0),
        (3.0, {"drop": 0}, -1.0),
    ],
    ids=["above", "above a floor", "below", "on a floor", "asked for"],
)
def test_it_falls_from_where_the_stage_has_it(
    tmp_path: Path, middle: float, options: dict[str, Any], lift: float
) -> None:
    """It was moved down to the floor. What begins below the floor is moved up onto it."""
    path = tmp_path / "ball.usda"
    path.write_text(BALL % (PHYSICS, middle))
    seen = gf_usd.inspect(path, particles=300, **options)
    assert seen.plan is not None
    assert seen.plan.settings.lift == pytest.approx((0.0, lift, 0.0), abs=1e-6)
    told = [note for note in seen.plan.notes if "moved up onto it" in note]
    assert told == (
        [
            "the asset begins 37.5 cm below the floor and is moved up onto it: floor=-0.75 keeps it"
            " where it is, with a floor there"
        ]
        if lift > 0.0
        else []
    )


@pytest.mark.parametrize(
    ("middle", "away", "moved"),
    [(1.0 - 1e-7, 0.0, False), (1.0 - 1e-5, 0.0, True), (0.9999, 2e4, False), (0.99, 2e4, True)],
    ids=["rounding", "below", "rounding far away", "below far away"],
)
def test_what_is_below_by_rounding_stands_on_the_floor(
    tmp_path: Path, middle: float, away: float, moved: bool
) -> None:
    """A note said that the asset begins 1.22e-12 µm below the floor and is moved up onto it."""
    path = tmp_path / "ball.usda"
    path.write_text((BALL % (PHYSICS, 7.0)).replace("(0, 7, 0)", f"({away!r}, {middle!r}, 0)"))
    plan = gf_usd.inspect(path, particles=300).plan
    assert plan is not None
    assert (plan.settings.lift[1] > 0.0) == moved
    assert any("moved up onto it" in note for note in plan.notes) == moved


def test_without_physics_a_body_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "ball.usda"
    path.write_text(BALL % ("", 3.0))
    seen = gf_usd.inspect(path, particles=300)
    assert seen.plan is not None
    assert seen.plan.settings.lift[1] == pytest.approx(3.0 * 0.5 - 1.0, rel=0.02)

"""Pins of bodies that flow are refused before anything is simulated, by `inspect` as by `bake`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from physics_stages import head
from planned import FEW, cubes

from gf_usd.core.errors import GfUsdError, InputError
from gf_usd.pipeline.inspect import inspect
from gf_usd.pipeline.prepared import draw
from gf_usd.prepare.prepare import prepare

FLOWS = {"material_boxes": ["honey:2,-1,-1,5,2,2"]}  # all of /Two
OF_FLOW = "the pin {} is part of a body that flows, which cannot be pinned"


@pytest.fixture
def two(tmp_path: Path) -> Path:
    path = tmp_path / "two.usda"
    path.write_text(head() + cubes(), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"material": "honey", "pins": ["/One"]}, OF_FLOW.format("/One")),
        ({"pins": ["/Two"], **FLOWS}, OF_FLOW.format("/Two")),
        ({"pins": [BOX := "box:2.5,-1,-1,5,2,2"], **FLOWS}, OF_FLOW.format(BOX)),
        ({"pins": ["/Two"], "conversions": ["honey@time:2"]}, "--conversion does not support pins"),
    ],
)
def test_a_pin_of_what_flows_is_refused(two: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(GfUsdError) as caught:
        prepare(two, draw=draw, **FEW, **options)
    assert message in caught.value.message
    assert "leave" in caught.value.hint
    try:
        refusal = inspect(two, **FEW, **options).refusal
    except GfUsdError as refused:
        refusal = refused
    assert refusal is not None
    assert (refusal.message, refusal.hint) == (caught.value.message, caught.value.hint)


@pytest.mark.parametrize("pin", ["/One", "box:-1,-1,-1,5,2,0.5"])
def test_a_pin_of_solid_bodies_next_to_it_is_not(two: Path, pin: str) -> None:
    plan, _ = prepare(two, draw=draw, pins=[pin], **FEW, **FLOWS)
    assert [one.name for one in plan.pins] == [pin]


def test_a_moving_pin_next_to_what_flows_is_a_refusal(tmp_path: Path) -> None:
    path = tmp_path / "two.usda"
    moving = "double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (0, 1, 0) }"
    order = 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    path.write_text(head() + cubes(moving, order), encoding="utf-8")
    message = f"{path}: the pin /One moves, which a bake with both flowing and solid bodies"
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        prepare(path, draw=draw, pins=["/One"], **FEW, **FLOWS)
    refusal = inspect(path, pins=["/One"], **FEW, **FLOWS).refusal
    assert refusal is not None
    assert (refusal.message, refusal.hint) == (caught.value.message, caught.value.hint)
    prepare(path, draw=draw, pins=["/One"], **FEW)  # of solid bodies alone it may move

"""Plans of small stages with physics: cubes of a meter, and no simulation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physics_stages import head, mesh

from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.plan import Plan

FEW = {"particles": 200, "frames": 3}
SOFT = """
    float physics:youngsModulus = 2e5
    float physics:poissonsRatio = 0.3
    float physics:density = 900
"""


def at(x: float, y: float = 0.0) -> str:
    """A line that moves a prim."""
    return (
        f"double3 xformOp:translate = ({x}, {y}, 0)\n"
        'uniform token[] xformOpOrder = ["xformOp:translate"]'
    )


def cubes(*lines: str, apis: tuple[str, ...] = ()) -> str:
    """/One at the origin, which says `lines`, and /Two two meters next to it."""
    return mesh("One", *lines, apis=apis) + mesh("Two", at(3.0))


def planner(tmp_path: Path) -> Callable[..., Plan]:
    """Plans a stage that holds these prims."""

    def plan(*prims: str, layer: str = head(), **options: Any) -> Plan:
        path = tmp_path / "asset.usda"
        path.write_text(layer + "".join(prims), encoding="utf-8")
        request = {"output": tmp_path / "out.usda", "overwrite": True, **FEW, **options}
        return prepare(path, **request).plan

    return plan


def table(plan: Plan) -> Any:
    """The materials of the first variant."""
    return plan.variants[0].table


def mass(plan: Plan, body: int) -> float:
    """[kg] of a body."""
    density = np.array([m.density for m in table(plan)])[plan.particles.material]
    mine = np.ones(len(plan.particles), bool)
    if plan.particles.body is not None:
        mine = plan.particles.body == body
    return float((density * plan.particles.V0)[mine].sum())


def noted(plan: Plan, text: str) -> bool:
    """Whether a note has this text."""
    return any(text in note for note in plan.notes)


@pytest.fixture(name="plan")
def plan_fixture(tmp_path: Path) -> Callable[..., Plan]:
    """See `planner`."""
    return planner(tmp_path)

"""Sand: which solver takes it, what is written of it, and what it does not go with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

import gf_usd
from gf_usd.core.errors import UsageError

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
SAND: dict[str, Any] = {"material": "dry-sand", "particles": 300}


def test_granular_presets_choose_the_solver_and_what_is_written() -> None:
    plan = gf_usd.inspect(SPHERE, **SAND).plan
    assert plan.settings.solver == "ul"
    assert plan.choices.shapes == ("gaussians", "points")
    assert len(plan.samples.X) == len(plan.particles), "every particle feels the floor"
    assert any("dry-sand: flows without end" in note and "hidden" in note for note in plan.notes)
    asked = gf_usd.inspect(SPHERE, only="mesh,points", **SAND).plan
    assert asked.choices.shapes == ("mesh", "points")
    assert not any("hidden" in note for note in asked.notes)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"solver": "tl"}, "does not go with dry-sand"),
        ({"material": ["rubber", "dry-sand"]}, "some of these flow without end"),
        ({"pins": "box:-9,-9,-9,9,-0.5,9"}, "does not know --pin|pins"),
    ],
)
def test_what_sand_does_not_go_with_is_refused_in_words(more: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        gf_usd.inspect(SPHERE, **(SAND | more))


@pytest.mark.slow
def test_a_ball_of_sand_becomes_a_heap_that_stands(tmp_path: Path) -> None:
    done = gf_usd.bake(
        SPHERE, output=tmp_path / "s.usda", frames=60, drop=0, internal=True, **SAND
    )  # fmt: skip
    (bake,) = done.bakes
    last = bake.per_frame[-1]
    assert last["kinetic"] < 1e-3 * bake.health["energy_scale_J"]
    assert bake.health["plastic_dissipation_J"] > 0.0
    assert not done.findings
    stage = Usd.Stage.Open(str(done.root))
    points = UsdGeom.Points(stage.GetPrimAtPath("/Sphere/GaussianFlesh/Points"))
    first, end = (np.asarray(points.GetPointsAttr().Get(t)) for t in (1.0, 60.0))
    assert len(end) == len(first) == done.particles
    wide = np.ptp(end, axis=0)
    # A cone of the volume of a ball of 1 m with a slope of at most 0.6: its height is at most
    # (4 * 0.36)^(1/3) = 1.13 m, where the ball was 2 m high.
    assert wide[1] < 1.13 + 0.2
    assert min(wide[0], wide[2]) > 2.5
    gaussians = stage.GetPrimAtPath("/Sphere/GaussianFlesh/Gaussians")
    loose = gaussians.GetAttribute("gaussianFlesh:loosening").Get(60.0)
    assert np.min(loose) >= 0.0
    again = gf_usd.bake(
        SPHERE, output=tmp_path / "t.usda", frames=60, drop=0, internal=True, **SAND
    )  # fmt: skip
    assert again.bakes[0].cache.read_bytes() == bake.cache.read_bytes()

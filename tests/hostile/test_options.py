"""Any combination of options ends in a plan, or in an error with a hint."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from hostile_options import OPTIONS, asset, planned
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from slow_parameters import longest_but

FLESH = (
    *("flesh", "bone_radius", "preroll", "loop"),
    *("goal_frequency", "goal_damping", "squish", "stretch"),
)
COMBINED = st.fixed_dictionaries(
    {}, optional={name: st.sampled_from(values) for name, values in OPTIONS.items()}
)


@pytest.fixture(scope="module", autouse=True)
def _sample_volumes_coarsely(coarse_volumes: None) -> None:
    """The box and the ball overlap; a plan is only made or refused here: see `coarse_volumes`."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return asset(tmp_path)


@pytest.mark.slow
@given(options=COMBINED)
@settings(
    max_examples=120, deadline=timedelta(seconds=60), derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
def test_options_together(here: Path, options: dict[str, Any]) -> None:
    planned(here, options)
    assert [path.name for path in here.parent.iterdir()] == [here.name], "a plan writes nothing"


@pytest.mark.slow
@pytest.mark.parametrize("name", longest_but(OPTIONS, *list(OPTIONS)[::3]))
def test_each_value_alone(here: Path, name: str) -> None:
    """The first value of each is one that is right."""
    found = [planned(here, {name: value}) for value in OPTIONS[name]]
    # The box has no such label and no skeleton, with all of it pinned nothing is left to move, no
    # other file is there, samples are left out by the error of --precision, and only what flows is
    # given a surface.
    alone = ("material_labels", "pins", "colliders", "adaptive_samples", "surface", *FLESH)
    assert found[0] or name in alone
    assert [path.name for path in here.parent.iterdir()] == [here.name]

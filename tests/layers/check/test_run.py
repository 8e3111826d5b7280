"""Every rule of the check has files that break it, and a good file breaks none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from checked_stages import (
    ALSO,
    CASES,
    GAUSSIANS,
    Break,
    floats,
    good_stage,
    late_samples,
    no_extent,
    put,
)

from gf_usd.layers.check.base import RULES
from gf_usd.layers.check.run import CheckResult, check_file, check_stage


def rules_of(result: CheckResult) -> set[str]:
    return {finding.rule for finding in result.findings}


def test_a_good_file_has_no_findings(tmp_path: Path) -> None:
    path = tmp_path / "good.usda"
    good_stage(path).Save()
    result = check_file(path)
    assert result.findings == ()
    assert result.skipped == ()
    assert result.ok
    assert (result.rules, result.prims, result.layers) == (len(RULES), 6, 2)


def test_every_rule_has_a_file_that_breaks_it() -> None:
    assert set(CASES) == set(RULES)


@pytest.mark.parametrize(
    ("rule", "case", "damage", "text"),
    [
        pytest.param(rule, name, damage, text, id=f"{rule}: {name}")
        for rule, cases in CASES.items()
        for name, damage, text in cases
    ],
)
def test_a_broken_file_is_found(
    tmp_path: Path, rule: str, case: str, damage: Break, text: str
) -> None:
    """The rule speaks with the numbers, names a prim and a fix, and no other rule joins in."""
    path = tmp_path / "broken.usda"
    stage = good_stage(path)
    damage(stage)
    stage.GetRootLayer().Save()
    result = check_file(path)
    found = [finding for finding in result.findings if finding.rule == rule]
    assert text in " ".join(finding.message for finding in found)
    assert all(finding.fix for finding in found)
    assert all(stage.GetPrimAtPath(finding.prim_path) for finding in found)
    assert rules_of(result) - {rule} == ALSO.get((rule, case), set())
    assert result.ok == all(finding.severity == "warning" for finding in found)


def test_severity_tells_what_usd_forgives(tmp_path: Path) -> None:
    stage = good_stage(tmp_path / "mild.usda")
    late_samples(stage)
    no_extent(stage)
    put(GAUSSIANS, "opacities", floats(np.ones(30)))(stage)
    result = check_stage(stage)
    assert {finding.severity for finding in result.findings} == {"warning"}
    assert rules_of(result) == {"time-range", "extent", "point-lengths"}
    assert result.ok

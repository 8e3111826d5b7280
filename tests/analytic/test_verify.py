"""The quick set of `gf-usd verify`: every figure within its bound."""

from __future__ import annotations

import pytest

from gf_usd.verify.case import Case
from gf_usd.verify.registry import CASES, run_case

# Double precision last, so that Taichi starts anew once.
ORDERED = sorted(CASES, key=lambda case: case.f64)
LONG = {  # more than half of the time of all
    "hertz", "lamb", "penetration", "collisions", "slope", "solvers", "expansion", "law-crushable",
    "law-neoHookean", "law-vonMises", "law-druckerPrager", "patch", "patch-f64", "spin-apic",
    "slump", "rigid-end", "taylor-f64",
    "goals", "law-corotated", "rim", "membrane", "uniaxial", "tumble", "column",
    "taylor", "arms", "law-paste", "manufactured-finite", "driven", "hollow",
    "incline", "burst", "law-fluid", "manufactured", "limbs", "bar", "drop", "locking",
    "hydrostatic", "dam", "puddle", "drop-of-both",
}  # fmt: skip
LONGEST = {  # which `gf-usd verify` of the acceptance has
    "hydrostatic", "puddle", "taylor", "arms", "column", "incline", "law-crushable", "law-paste",
    "expansion", "rim", "penetration", "dam", "collisions", "slope", "law-vonMises",
    "law-druckerPrager", "patch", "drop-of-both", "solvers", "taylor-f64", "rigid-end", "slump",
    "burst", "law-fluid", "law-corotated", "uniaxial", "hertz", "goals", "lamb",
}  # fmt: skip


def marks(name: str) -> list[pytest.MarkDecorator]:
    """Of a case, by how long it takes."""
    longest = [pytest.mark.acceptance] if name in LONGEST else []
    return [pytest.mark.slow, *longest] if name in LONG else []


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=marks(c.name)) for c in ORDERED],
    ids=lambda case: case.name,
)
def test_every_figure_is_within_its_bound(case: Case) -> None:
    result = run_case(case)
    assert result.measures
    off = [f"{m.name}: {m.value} for {m.target}" for m in result.measures if not m.passed]
    assert off == []

"""NVIDIA's usd-validation finds in no form of a bake what it does not find in the asset."""

from __future__ import annotations

from pathlib import Path

import pytest
from client_runs import findings, needs

import gf_usd

pytestmark = [pytest.mark.clients, needs("validation")]

DUCK = Path(__file__).parents[2] / "samples" / "duck.usda"
FORMS = {
    "package": ("duck.usdz", {}),
    "flat": ("duck.usdc", {"flatten": True}),
    "clips": ("duck.usda", {"clip_frames": 2, "samples_per_frame": 2, "handles": 1}),
    "half": ("duck.usda", {"half": True}),
    "small": ("duck.usda", {"precision": "5%", "adaptive_samples": True, "time_scale": 0.2}),
    "mesh": ("duck.usda", {"only": "mesh"}),
    "particles": ("duck.usda", {"only": "gaussians,points"}),
}


@pytest.mark.parametrize("form", FORMS)
def test_no_form_adds_a_finding(form: str, tmp_path: Path) -> None:
    name, options = FORMS[form]
    out = tmp_path / "out"
    out.mkdir()
    result = gf_usd.bake(DUCK, output=out / name, particles=300, frames=6, **options)
    found = findings(result.root, out)
    assert {severity for severity, _, _ in found} <= {"FAILURE"}
    assert found <= findings(DUCK, tmp_path)

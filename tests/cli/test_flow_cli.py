"""Bakes of materials that flow: painted values, checkpoints, layers and what is seen of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from resumed import require_same

PAINTED = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "World"
{
    def Mesh "Bar"
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0,2,3,1, 4,5,7,6, 0,1,5,4, 2,6,7,3, 0,4,6,2, 1,3,7,5]
        point3f[] points = [(0,0,0),(30,0,0),(0,8,0),(30,8,0),(0,0,8),(30,0,8),(0,8,8),(30,8,8)]
        float[] primvars:gaussianFlesh:yieldStress = [2, 2000, 2, 2000, 2, 2000, 2, 2000] (
            interpolation = "vertex"
        )
    }
}
"""  # from x = 0 to x = 30: 200 Pa to 200 kPa
SMALL = (
    "--particles",
    "600",
    "--frames",
    "9",
    "--drop",
    "0.1r",
    "--internal",
    "--clip-frames",
    "3",
)


@pytest.fixture
def bar(tmp_path: Path) -> Path:
    path = tmp_path / "bar.usda"
    path.write_text(PAINTED)
    return path


def attribute(stage: Usd.Stage, name: str) -> Usd.Attribute:
    """The one of that name of the particles, Gaussians or points."""
    return next(
        p.GetAttribute(f"gaussianFlesh:{name}") for p in stage.TraverseAll()
        if p.GetAttribute(f"gaussianFlesh:{name}").HasAuthoredValue()
        and p.HasAPI("GaussianFleshParticlesAPI")
    )  # fmt: skip


@pytest.mark.slow
def test_a_painted_yield_stress_through_filling_checkpoint_and_layers(
    gf_usd, here: Path, bar: Path
) -> None:
    arguments = ("bake", bar, *SMALL, "-q")
    assert gf_usd(*arguments, "-o", "one/").status == 0
    assert gf_usd(*arguments, "-o", "two/", "--slice", "1").status == 5
    assert gf_usd(*arguments, "-o", "two/", "--slice", "1", "--resume").status == 5
    assert gf_usd(*arguments, "-o", "two/", "--resume").status == 0
    require_same(here / "one", here / "two")

    (root,) = (here / "one").glob("*.usda")
    stage = Usd.Stage.Open(str(root))
    painted = np.array(attribute(stage, "yieldStress").Get())  # in units of the stage, 100 Pa
    x = np.array(attribute(stage, "restPositions").Get())[:, 0]
    sides = (x > 4.0) & (x < 26.0)  # nearer to them than to the ends
    assert painted[sides] == pytest.approx(2.0 + (2000.0 - 2.0) * x[sides] / 30.0, rel=1e-4)
    strain = np.array(attribute(stage, "plasticStrain").Get(stage.GetEndTimeCode()))
    soft, hard = strain[x < 6.0], strain[x > 24.0]
    assert soft.mean() > 0.02
    assert hard.max() < 1e-3
    report = json.loads(next((here / "one").glob("*.report.json")).read_text())
    assert any("a yield stress is painted: the law is vonMises" in n for n in report["notes"])

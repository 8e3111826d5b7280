"""--flesh with thick clothes of several joints, which have no bone of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from arm import arm, write

from gf_usd.prepare.prepare import prepare


def draped(folder: Path) -> Path:
    """The arm with a block of 1.2 m below its middle, /Arm/Drape, bound to both joints."""
    box = trimesh.creation.box((0.4, 1.2, 0.3)).subdivide_to_size(0.15)
    points = (np.array(box.vertices) + (1.0, -0.79, 0.0)).tolist()
    listed = ", ".join(str(tuple(p)) for p in points)
    drape = f"""
    def Mesh "Drape" ( prepend apiSchemas = ["SkelBindingAPI"] )
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points = [{listed}]
        int[] faceVertexCounts = {[3] * len(box.faces)}
        int[] faceVertexIndices = {box.faces.ravel().tolist()}
        rel skel:skeleton = </Arm/Skel>
        int[] primvars:skel:jointIndices = {[0, 1] * len(points)} (
            elementSize = 2
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = {[0.5] * 2 * len(points)} (
            elementSize = 2
            interpolation = "vertex"
        )
    }}
}}
"""
    return write(folder, arm().rstrip().removesuffix("}") + drape)


def test_thick_clothes_that_would_hang_have_springs(tmp_path: Path) -> None:
    """A coat of jelly hung to twice its length, without a note."""
    options = {"flesh": True, "material": "jelly", "particles": 2000, "preroll": 12, "draw": None}
    plan, _ = prepare(draped(tmp_path), output=tmp_path / "out.usda", **options)
    notes = " ".join(plan.notes)
    assert "</Arm/Drape> follows several joints, and only " in notes
    assert "springs of 4 Hz pull it to its skinned pose" in notes
    assert plan.goals is not None
    below, beside = plan.goals.rate(np.array([[1.0, -1.2, 0.0], [0.1, 0.0, 0.0]]))
    assert below == pytest.approx(2.0 * np.pi * 4.0)
    assert beside < 0.1 * below

"""Bakes of a TetMesh and of Points: all of their points fall as one in free flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_stages import world_points
from pxr import Usd

import gf_usd

G = 9.81
FPS = 24.0
CORNERS = [(x, y + 5, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
KUHN = [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]
LATTICE = [
    (3 + 0.25 * i, 5 + 0.25 * j, 0.25 * k) for i in range(4) for j in range(4) for k in range(4)
]
STAGE = f"""#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    defaultPrim = "Two"
)
def Xform "Two"
{{
    def TetMesh "Tets"
    {{
        point3f[] points = {CORNERS}
        int4[] tetVertexIndices = {KUHN}
    }}
    def Points "Cloud"
    {{
        point3f[] points = {LATTICE}
        float[] widths = [0.25] (interpolation = "constant")
    }}
}}
"""


@pytest.mark.slow
def test_the_points_of_both_fall_as_one(tmp_path: Path) -> None:
    source = tmp_path / "two.usda"
    source.write_text(STAGE)
    gf_usd.bake(
        source,
        output=tmp_path / "two.rubber.usda",
        material="rubber",
        particles=300,
        frames=5,
    )
    stage = Usd.Stage.Open(str(tmp_path / "two.rubber.usda"))
    for path, count in (("/Two/Tets", 8), ("/Two/Cloud", 64)):
        start, end = (world_points(stage, path, time) for time in (1.0, 5.0))
        assert len(start) == count
        fallen = (end - start).mean(axis=0)
        t = 4 / FPS  # of playback, which shows large bodies falling slower
        assert fallen[1] < -0.01
        assert abs(fallen[[0, 2]]).max() < 1e-4
        np.testing.assert_allclose(end - start, np.tile(fallen, (count, 1)), atol=1e-4)
        assert -fallen[1] < 0.5 * G * t * t * 1.01
    # points are not delivered, and a note says so
    done = gf_usd.deliver(tmp_path / "two.rubber.usda", tmp_path / "two.glb")
    assert [body.meshes for body in done.bodies] == [("/Two/Tets",)]
    assert "</Two/Cloud>: its points move and are left out" in done.notes

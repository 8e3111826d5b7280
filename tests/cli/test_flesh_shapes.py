"""--flesh with blend shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from arm import FIRST, LAST, drawn, shaped, write
from pxr import Usd

import gf_usd

FEW = {"particles": 400, "preroll": 12, "flesh": True, "material": "rubber", "progress": None}


@pytest.mark.slow
@pytest.mark.parametrize("skin", ["embed", "idw"])
def test_the_surface_follows_its_blend_shapes_on_top_of_the_flesh(
    tmp_path: Path, skin: Literal["embed", "idw"]
) -> None:
    """An animated belly stayed flat."""
    poses, notes = [], []
    for weight in (0.0, 1.0):
        folder = tmp_path / f"{weight}"
        folder.mkdir()
        out = folder / "out.usda"
        result = gf_usd.bake(write(folder, shaped(0.0, weight)), output=out, skin=skin, **FEW)
        stage = Usd.Stage.Open(str(out))
        codes = (FIRST, 0.5 * (FIRST + LAST), LAST)
        poses.append(np.array([drawn(stage, code) for code in codes]))
        notes.append(" ".join(result.notes))
    offset = poses[1] - poses[0]
    np.testing.assert_array_equal(offset[0], 0.0)
    np.testing.assert_array_equal(np.flatnonzero(np.abs(offset[2]).max(1)), [16, 17, 18, 19])
    # The middle of the arm bends about z, along which the shape moves it.
    np.testing.assert_allclose(offset[1][16:20], [(0.0, 0.0, 0.1)] * 4, atol=0.02)
    np.testing.assert_allclose(offset[2][16:20], [(0.0, 0.0, 0.2)] * 4, atol=0.04)
    assert "blend shape" not in notes[0]
    assert "the blend shape Bulge of </Arm/Skin> changes: the surface follows" in notes[1]

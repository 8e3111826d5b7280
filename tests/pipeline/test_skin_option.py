"""The skin of a bake: chosen, noted, written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from gf_usd.api.bake import bake
from gf_usd.pipeline.prepared import prepare

SPHERE = Path(__file__).resolve().parents[2] / "samples" / "sphere.usda"


@pytest.mark.parametrize(
    ("options", "skin"),
    [
        ({}, "embed"),
        ({"skin": "idw"}, "idw"),
        ({"skin": "paper"}, "paper"),
        ({"preset": "paper"}, "paper"),
        ({"preset": "paper", "skin": "embed"}, "embed"),
    ],
)
def test_choice(options: dict[str, Any], skin: str, tmp_path: Path) -> None:
    prepared = prepare(SPHERE, particles=120, output=f"{tmp_path}/", **options)
    plan = prepared.plan
    assert plan.settings.skin == skin
    assert ("--skin" in plan.command) == ("skin" in options), "the command has the given options"
    # What is wrong with the paper's skin is noted in every bake that has it.
    assert any(note.startswith("skin paper: ") for note in plan.notes) == (skin == "paper")
    embedded = prepared.solvers.take(plan.variants[0]).body.embedded
    assert list(embedded) == ([s.path for s in plan.asset.surfaces] if skin == "embed" else [])


@pytest.mark.slow
def test_skins_are_written(tmp_path: Path) -> None:
    found = {}
    for skin in ("embed", "idw", "paper"):
        result = bake(
            SPHERE, skin=skin, output=f"{tmp_path}/{skin}/", particles=500, frames=16, drop="0.5r"
        )
        found[skin] = mesh_points(result.root)
        assert result.findings == ()
    rest = mesh_points(SPHERE)[0]
    embed = found["embed"]
    for points in found.values():
        assert points.shape == embed.shape
        # Only lifted at the first frame: the cache holds float32.
        lifted = points[0] - rest
        np.testing.assert_allclose(lifted, np.broadcast_to(lifted[0], lifted.shape), atol=1e-6)
    idw, paper = (np.linalg.norm(found[s] - embed, axis=2) for s in ("idw", "paper"))
    # Both carry a vertex by an offset times F: the offset is at most a spacing on the nearest
    # particles, and F varies by less than 1 over it.  On the full cloud it is half a radius.
    spacing = (4.0 * np.pi / 3.0 / 500) ** (1.0 / 3.0)
    assert 1e-4 < idw.max() < spacing
    assert idw.mean() < paper.mean() < 0.5


def mesh_points(path: Path) -> np.ndarray:
    """Points (T, V, 3) of the only mesh of a stage, as authored."""
    stage = Usd.Stage.Open(str(path))
    (mesh,) = [UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    attribute = mesh.GetPointsAttr()
    times = attribute.GetTimeSamples() or [Usd.TimeCode.Default()]
    return np.array([attribute.Get(t) for t in times], float)

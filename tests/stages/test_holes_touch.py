"""Bodies with holes rest on what fills these, as bodies without holes rest on their faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gf_usd

HEAD = '#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n'
# the faces of a cube from 0 to 1, the lower one last
FACES = [[4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [3, 2, 1, 0]]
CORNERS = [(0, 0, 1), (1, 0, 1), (1, 0, 0), (0, 0, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0), (0, 1, 0)]
OPTIONS = {"material": "jelly", "particles": 600, "threads": 1, "overwrite": True}


def box(name: str, faces: list[list[int]], low: tuple[float, ...], corners=CORNERS) -> str:
    """A cube at a place, with some of its faces."""
    points = [tuple(a + b for a, b in zip(corner, low)) for corner in corners]
    counts, indices = [4] * len(faces), [k for face in faces for k in face]
    return f"""
def Mesh "{name}" {{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = {counts}
    int[] faceVertexIndices = {indices}
    point3f[] points = {points}
}}
"""


def positions(path: Path, **options: object) -> tuple[np.ndarray, float]:
    """Particles (F, n, 3) [m] of a bake, and their spacing [m]."""
    result = gf_usd.bake(path, output=f"{path.parent}/", **OPTIONS, **options)
    baked = gf_usd.read(result.root)
    X = np.stack([frame.positions for frame in baked])
    return X, float(baked.report["spacing_m"])


@pytest.mark.slow
def test_the_filling_of_a_hole_rests_on_the_floor(tmp_path: Path) -> None:
    """It flowed out below the floor by half the height of the box."""
    seen = []
    for name, faces in (("whole", FACES), ("bottomless", FACES[:-1])):
        path = tmp_path / f"{name}.usda"
        path.write_text(HEAD + box("Box", faces, (0.0, 0.0, 0.0)))
        seen.append(positions(path, frames=24, drop="0.5"))
    (whole, spacing), (bottomless, _) = seen
    # springs stop an impact within a quarter of a spacing or harden beyond it
    assert whole[..., 1].min() > -0.75 * spacing
    lowest = [X[..., 1].min(1) for X in (whole, bottomless)]
    assert np.abs(lowest[0] - lowest[1]).max() < 0.1 * spacing
    apart = np.abs(whole.mean(1) - bottomless.mean(1)).max()
    assert apart < 0.1 * spacing


@pytest.mark.slow
def test_a_body_rests_on_the_filling_of_a_hole(tmp_path: Path) -> None:
    """A box falls onto one whose upper face is missing, far from its walls."""
    seen = []
    for name, faces in (("whole", FACES), ("topless", FACES[1:])):
        path = tmp_path / f"{name}.usda"
        small = [tuple(0.5 * x for x in corner) for corner in CORNERS]
        body = box("Base", faces, (0.0, 0.0, 0.0)) + box("Top", FACES, (0.25, 1.1, 0.25), small)
        path.write_text(HEAD + body)
        X, spacing = positions(path, frames=16, drop="0")
        upper = X[0, :, 1] > 1.05
        assert 0 < upper.sum() < len(upper)
        seen.append(X[:, upper].mean(1)[:, 1])
    assert seen[0].min() < seen[0][0] - 0.05, "it has fallen onto the other"
    assert np.abs(seen[0] - seen[1]).max() < 0.1 * spacing

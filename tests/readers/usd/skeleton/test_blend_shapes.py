"""Blend shapes of characters: the rest shape, and offsets against UsdSkel's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm import FIRST, LAST, points, shaped, write

from gf_usd.readers import read_asset
from gf_usd.readers.usd.skeleton.blend_shapes import read_blend_shapes
from gf_usd.readers.usd.skeleton.bones import animation_range

BULGE = 0.2  # [m] of the shape at weight 1


def test_the_rest_shape_has_the_blend_shapes_of_the_first_frame(tmp_path: Path) -> None:
    """They were left out of it: a character with a constant shape, such as Fat, was thin."""
    surface = read_asset(write(tmp_path, shaped(0.5, 0.5)), bind_pose=True).surfaces[0]
    moved = np.zeros_like(points())
    moved[16:20, 2] = 0.5 * BULGE
    np.testing.assert_allclose(surface.points, points() + moved, atol=1e-6)


@pytest.mark.parametrize("code", [FIRST - 3.0, FIRST, 4.0, LAST])
def test_offsets_are_those_that_the_animation_adds_to_the_rest_shape(
    tmp_path: Path, code: float
) -> None:
    path = write(tmp_path, shaped(0.25, 1.0))
    facts = read_asset(path).facts
    found = read_blend_shapes(path, ["/Arm/Skin"], facts, first=FIRST, times=[FIRST, code, LAST])
    shapes = found["/Arm/Skin"]
    assert shapes.names == ("Bulge",)
    offsets = (shapes.offsets @ shapes.weights[1]).reshape(-1, 3)
    share = max(code - FIRST, 0.0) / (LAST - FIRST)
    expected = np.zeros_like(points())
    expected[16:20, 2] = share * (1.0 - 0.25) * BULGE
    np.testing.assert_allclose(offsets, expected, atol=1e-6)
    np.testing.assert_array_equal(shapes.weights[0], 0.0)


@pytest.mark.parametrize("change", ["constant", "no target of it", "indices"])
def test_shapes_that_do_not_change_the_points_are_left_out(tmp_path: Path, change: str) -> None:
    text = shaped(0.5, 0.5) if change == "constant" else shaped(0.0, 1.0)
    if change == "no target of it":
        text = text.replace('skel:blendShapes = ["Bulge"]', 'skel:blendShapes = ["Other"]')
    if change == "indices":
        text = text.replace("pointIndices = [16,", "pointIndices = [99,")
    path = write(tmp_path, text)
    facts = read_asset(path).facts
    times = [FIRST, LAST]
    assert read_blend_shapes(path, ["/Arm/Skin"], facts, first=FIRST, times=times) == {}


def test_the_range_includes_the_samples_of_the_weights(tmp_path: Path) -> None:
    text = shaped(0.0, 1.0).replace(f"{LAST}: [1.0]", f"{LAST + 5}: [1.0]")
    text = text.replace(f"startTimeCode = {FIRST}\n", "").replace(f"endTimeCode = {LAST}\n", "")
    path = write(tmp_path, text)
    assert animation_range(path, ["/Arm/Skin"], read_asset(path).facts) == (FIRST, LAST + 5)


def test_inbetweens_and_other_spaces_are_followed(tmp_path: Path) -> None:
    """At half its weight the shape is at its in-between, and the mesh has a bind transform."""
    between = """uniform vector3f[] inbetweens:Half = [(0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 1, 0)] (
                weight = 0.5
            )
"""
    text = shaped(0.0, 1.0).replace("uniform int[] pointIndices", between + " " * 12
                                    + "uniform int[] pointIndices")  # fmt: skip
    turned = (
        "matrix4d primvars:skel:geomBindTransform = "
        "( (0, 2, 0, 0), (-2, 0, 0, 0), (0, 0, 2, 0), (0, 0, 0, 1) )"
    )
    text = text.replace("uniform token subdivisionScheme", turned + "\n        "
                        + "uniform token subdivisionScheme", 1)  # fmt: skip
    path = write(tmp_path, text)
    facts = read_asset(path).facts
    times = [0.5 * (FIRST + LAST)]
    shapes = read_blend_shapes(path, ["/Arm/Skin"], facts, first=FIRST, times=times)["/Arm/Skin"]
    offsets = (shapes.offsets @ shapes.weights[0]).reshape(-1, 3)
    np.testing.assert_allclose(offsets[16:20], [(-2.0, 0.0, 0.0)] * 4, atol=1e-6)

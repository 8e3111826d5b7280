"""Tracked points out of curves and out of points with time samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gf_usd.core.errors import InputError
from gf_usd.readers.tracks import read_tracks

HEAD = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Z"
    startTimeCode = 11
    endTimeCode = 14
    timeCodesPerSecond = 48
)
"""
CURVES = """
def Xform "Film"
{
    double3 xformOp:translate = (0, 0, 100)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def BasisCurves "Tracks"
    {
        uniform token type = "linear"
        int[] curveVertexCounts = [3, 2]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 5, 0), (0, 6, 0)]
        %s
    }
}
"""
POINTS = """
def Points "Tracks"
{
    point3f[] points.timeSamples = {
        11: [(0, 0, 0), (0, 5, 0)],
        12.5: [(1, 0, 0), (0, 6, 0)%s],
    }
}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "tracks.usda"
    path.write_text(HEAD + text)
    return path


def test_curves_begin_with_the_stage(tmp_path: Path) -> None:
    found = read_tracks(written(tmp_path, CURVES % ""))
    assert found is not None
    assert found.time_codes.tolist() == [11.0, 12.0, 13.0]
    assert (found.time_codes_per_second, found.up) == (48.0, (0.0, 0.0, 1.0))
    # centimeters, 1 m above the origin
    assert found.x[1] == pytest.approx(np.array([[0.01, 0.0, 1.0], [0.0, 0.06, 1.0]]))
    assert np.isnan(found.x[2, 1]).all()  # the second curve is shorter


def test_curves_may_say_their_time_codes(tmp_path: Path) -> None:
    authored = 'float[] primvars:timeCode = [11, 12, 14, 12, 14] ( interpolation = "vertex" )'
    found = read_tracks(written(tmp_path, CURVES % authored))
    assert found is not None
    assert found.time_codes.tolist() == [11.0, 12.0, 14.0]
    assert np.isnan(found.x[0, 1]).all()
    assert found.x[2, 1] == pytest.approx([0.0, 0.06, 1.0])


def test_points_are_tracks(tmp_path: Path) -> None:
    found = read_tracks(written(tmp_path, POINTS % ""))
    assert found is not None
    assert found.time_codes.tolist() == [11.0, 12.5]
    assert found.x[1] == pytest.approx(np.array([[0.01, 0.0, 0.0], [0.0, 0.06, 0.0]]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CURVES.replace("[3, 2]", "[3, 3]") % "", "has 5 points for curves of 6"),
        (CURVES % 'float[] primvars:timeCode = [11] ( interpolation = "vertex" )', "timeCode"),
        (POINTS % ", (0, 0, 0)", "has a changing number of points"),
    ],
)
def test_what_does_not_fit_together_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as refused:
        read_tracks(written(tmp_path, text))
    assert message in str(refused.value)


def test_a_file_without_tracks_has_none(tmp_path: Path) -> None:
    assert read_tracks(written(tmp_path, 'def Xform "Empty" {}')) is None

"""Targets out of files, without a simulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gf_usd.core.errors import InputError
from gf_usd.core.materials.presets import find_preset
from gf_usd.fitting.observation import Scene
from gf_usd.fitting.read_targets import read_motion
from gf_usd.fitting.targets import parse

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
LIFT = np.array([0.0, 2.0, 0.0])
MESH = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "%s"
    timeCodesPerSecond = 24
)
def Mesh "%s"
{
    int[] faceVertexCounts = [3, 3, 3, 3]
    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
    point3f[] points.timeSamples = {
        0: [(0, 2, 0), (1, 2, 0), (0, 3, 0), (0, 2, 1)],
        5: [(0, 2, 0), (1, 2, 0), (0, 3, 0), (0, 2, 1)],
        17: [(0, 1, 0), (1, 1, 0), (0, 2, 0), (0, 1, 1)],
    }
}
"""
CURVES = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    startTimeCode = 5
    timeCodesPerSecond = 24
)
def BasisCurves "Tracks"
{
    uniform token type = "linear"
    int[] curveVertexCounts = [3, 3, 2]
    point3f[] points = [(0.25, 2.25, 0), (0.25, 2, 0), (0.25, 1.5, 0),
        (%s, 9, 9), (9, 9, 9), (9, 9, 9), (0.5, 2.0, 0.5), (0.5, 1.5, 0.5)]
}
"""


def scene() -> Scene:
    return Scene(
        material=find_preset("rubber").material(0.5), radius=0.5, particles=100, fps=24.0,
        frames=20, start=5.0, time_codes_per_second=24.0, unit=1.0, up=np.array([0.0, 1.0, 0.0]),
        floor=0.0, surfaces={"/World/Tet": CORNERS + LIFT}, triangles={"/World/Tet": FACES},
        lift=LIFT, notes=(), identity="",
    )  # fmt: skip


def written(folder: Path, text: str) -> str:
    (folder / "film.usda").write_text(text)
    return str(folder / "film.usda")


def test_keyed_poses_are_times_of_the_playback(tmp_path: Path) -> None:
    file = written(tmp_path, MESH % ("Y", "Tet"))
    found, notes = read_motion(parse(f"{file}+-1%"), scene())
    assert found.seconds == pytest.approx([0.0, 0.5])  # time code 0 is before the first frame
    assert found.x[1] == pytest.approx(CORNERS + [0.0, 1.0, 0.0])
    assert (found.sigma, found.stated) == (0.005, True)
    assert "is compared with </World/Tet>" in notes[0]


def test_another_up_axis_is_turned(tmp_path: Path) -> None:
    found, notes = read_motion(parse(written(tmp_path, MESH % ("Z", "Tet"))), scene())
    assert found.x[0, 0] == pytest.approx([0.0, 0.0, -2.0])  # y of a stage with Z up is -z
    assert "another up axis" in notes[-1]


def test_tracks_lie_on_the_surface_at_the_first_frame(tmp_path: Path) -> None:
    found, notes = read_motion(parse(written(tmp_path, CURVES % "9")), scene())
    (tracked,) = found.tracked
    assert tracked.of(CORNERS + LIFT) == pytest.approx(found.x[0])
    assert found.x[:, 0, 1] == pytest.approx([2.25, 2.0, 1.5])
    assert np.isnan(found.x[2, 1]).all()
    assert notes == ("film.usda: 1 track off the surface: left out",)


def test_what_shows_nothing_of_the_asset_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path, MESH % ("Y", "Tet"))
    other = replace(scene(), surfaces={"/World/Box": np.zeros((8, 3))})
    with pytest.raises(InputError, match="contains no mesh of the asset"):
        read_motion(parse(file), other)
    with pytest.raises(InputError, match="are not after the first frame"):
        read_motion(parse(file), replace(scene(), start=17.0))
    far = replace(scene(), surfaces={"/World/Tet": CORNERS + 50.0})
    with pytest.raises(InputError, match="none of 3 tracks is on the asset"):
        read_motion(parse(written(tmp_path, CURVES % "9")), far)
    with pytest.raises(InputError, match="does not exist"):
        read_motion(parse(str(tmp_path / "none.usda")), scene())
    with pytest.raises(InputError, match="nothing in this file moves"):
        read_motion(parse(written(tmp_path, '#usda 1.0\ndef Xform "A" {}\n')), scene())

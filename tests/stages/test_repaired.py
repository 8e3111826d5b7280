"""Meshes that enclose too little or too much: the whole command, with and without --repair."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

import gf_usd
from gf_usd.core.errors import InputError

CORNERS = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
BOX = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
Mesh = tuple[np.ndarray, list[list[int]]]


def box(low=(0.0, 0.0, 0.0), edge=(1.0, 1.0, 1.0)) -> Mesh:
    return np.asarray(low) + np.asarray(edge) * CORNERS, BOX


def back(mesh: Mesh) -> Mesh:
    """The same from behind, begun at other corners: its squares may be cut the other way."""
    return mesh[0], [[*f[::-1][1:], f[-1]] for f in mesh[1]]


def joined(*meshes: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(points) for points, _ in meshes)])
    faces = [[int(i + o) for i in f] for (_, part), o in zip(meshes, first) for f in part]
    return np.concatenate([points for points, _ in meshes]), faces


def two_sides() -> Mesh:
    return joined(box(), back(box()))


def rooms() -> Mesh:
    return joined(box(), box((1.0, 0.0, 0.0)))


def crossed() -> Mesh:
    return joined(box((-2.0, 0.0, 0.0), (5.0, 1.0, 1.0)), box((0.0, -2.0, 0.0), (1.0, 5.0, 1.0)))


def nested() -> Mesh:
    return joined(box(), box((0.25, 0.25, 0.25), (0.5, 0.5, 0.5)))


def hollow() -> Mesh:
    return joined(box(), back(box((0.2, 0.2, 0.2), (0.6, 0.6, 0.6))))


def plane() -> Mesh:
    return np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], float), [[0, 1, 2, 3]]


def plate() -> Mesh:
    return box(edge=(1.0, 0.004, 1.0))


@pytest.fixture
def bake(tmp_path: Path) -> Callable[..., tuple[Path, dict]]:
    """Bake a mesh: the root layer, and the report."""
    path = tmp_path / "odd.usda"

    def run(mesh: Mesh, *, repair: bool) -> tuple[Path, dict]:
        points, faces = mesh
        stage = Usd.Stage.CreateNew(str(path)) if not path.exists() else Usd.Stage.Open(str(path))
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.SetStageUpAxis(stage, "Y")
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
        skin = UsdGeom.Mesh.Define(stage, "/Root/Skin")
        skin.GetPointsAttr().Set(points.tolist())
        skin.GetFaceVertexCountsAttr().Set([len(f) for f in faces])
        skin.GetFaceVertexIndicesAttr().Set([i for f in faces for i in f])
        stage.Save()
        result = gf_usd.bake(
            path, output=f"{tmp_path}/{repair}/", particles=200, frames=2, repair=repair
        )
        assert result.findings == ()
        return result.root, json.loads(result.report.read_text())

    return run


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mesh", "volume", "alone", "note", "cells"),
    [
        (two_sides, 1.0, False, "12 on the second side of double-sided surfaces", 3**3),
        (rooms, 2.0, True, "4 back-to-back in walls without thickness", 5 * 3 * 3),
        (crossed, 9.0, True, "2 parts that overlap others", 2 * 8 * 2 * 2 - 2**3),
        (nested, 1.0, True, "dropped 1 part inside others", 3**3),
        (hollow, 1.0 - 0.216, True, "left 1 part that lie inside others and face inward", 4**3),
    ],
    ids=["two sides", "rooms", "crossed", "nested", "hollow"],
)
def test_flesh_counts_once(bake, mesh, volume: float, alone: bool, note: str, cells: int) -> None:
    """alone : so it does without --repair; cells : of the grid, that the solid reaches.

    The edge of a cell is 2 (volume / 200)^(1/3), and as few as hold the box are centered on it.  A
    cell has eight particles at most, which thin walls that fill little of theirs have too.
    """
    report = bake(mesh(), repair=True)[1]
    # volumes of several shells are counted on a lattice of 200,000 places
    assert report["volume_m3"] == pytest.approx(volume, rel=0.03)
    # A cell that the surface cuts has four at least, but for a sliver that goes to its neighbor.
    assert 0.65 * 200 <= report["particles"] <= 8 * cells
    assert note in " ".join(report["notes"])
    if alone:
        as_it_is = bake(mesh(), repair=False)[1]
        assert as_it_is["volume_m3"] == pytest.approx(volume, rel=0.03)
        assert note not in " ".join(as_it_is["notes"])
    else:
        with pytest.raises(InputError):
            bake(mesh(), repair=False)


def test_a_plane_is_refused_with_a_hint_and_baked_with_repair(bake) -> None:
    with pytest.raises(InputError, match="the surface is open: 4 boundary edges") as refused:
        bake(plane(), repair=False)
    assert "repair=True" in refused.value.hint
    root, report = bake(plane(), repair=True)
    assert "made 1 thin part" in " ".join(report["notes"])
    assert report["particles"] == 200  # of 5 x 5 cells
    assert report["volume_m3"] == pytest.approx(1.0 * 0.97 * report["spacing_m"], rel=1e-6)
    stage = Usd.Stage.Open(str(root))
    skin = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Skin"))
    assert list(skin.GetFaceVertexIndicesAttr().Get()) == [0, 1, 2, 3]
    first = np.array(skin.GetPointsAttr().Get(skin.GetPointsAttr().GetTimeSamples()[0]))
    drawn = first - first[0]
    np.testing.assert_allclose(drawn, plane()[0], atol=1e-6)  # float32 points about 1 m across


def test_a_plate_is_drawn_as_thin_as_it_was(bake) -> None:
    root, report = bake(plate(), repair=True)
    assert "made 1 thin part" in " ".join(report["notes"])
    assert report["volume_m3"] > 10 * 0.004
    stage = Usd.Stage.Open(str(root))
    skin = UsdGeom.Mesh(stage.GetPrimAtPath("/Root/Skin"))
    first = np.array(skin.GetPointsAttr().Get(skin.GetPointsAttr().GetTimeSamples()[0]))
    assert np.ptp(first, axis=0) == pytest.approx([1.0, 0.004, 1.0], abs=1e-6)

"""A coarse cage is far from the surface that renderers draw of it, which a note says."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Gf, Usd, UsdGeom

from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.bodies.cages import cage_notes

POINTS = [Gf.Vec3f(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
FACES = [0, 2, 3, 1, 4, 5, 7, 6, 0, 1, 5, 4, 2, 6, 7, 3, 0, 4, 6, 2, 1, 3, 7, 5]


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    """A cube of 2 m whose corners are sqrt(3) / 2 m from its limit surface."""
    path = tmp_path / "cube.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    mesh = UsdGeom.Mesh.Define(stage, "/Cube")
    mesh.CreatePointsAttr(POINTS)
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(FACES)
    stage.Save()
    return path


def cage_note(path: Path, **options) -> list[str]:
    plan = prepare(path, particles=1000, **options).plan
    return [note for note in plan.notes if "is the cage" in note]


def test_a_coarse_cage_is_reported(cube: Path):
    (note,) = cage_note(cube)
    assert note.startswith("</Cube> is the cage of a subdivision surface")
    assert "up to 0.866 m (4.3 spacings) away from them" in note, "spacing 2 m / 10"


def test_a_refined_cage_is_not(cube: Path):
    assert cage_note(cube, max_edge_length="auto") == []


@pytest.mark.parametrize("more", [{}, {"surface": True}])
def test_a_cage_that_particles_stand_for_is_not(cube: Path, more):
    assert cage_note(cube, material="honey", **more) == []


def test_polygons_are_not(cube: Path):
    stage = Usd.Stage.Open(str(cube))
    UsdGeom.Mesh(stage.GetPrimAtPath("/Cube")).GetSubdivisionSchemeAttr().Set("none")
    stage.Save()
    assert cage_note(cube) == []


@pytest.mark.parametrize(("spacing", "notes"), [(0.865, 1), (0.867, 0)])
def test_a_cage_within_a_spacing_of_its_surface_is_not(cube: Path, spacing: float, notes: int):
    surfaces = prepare(cube, particles=100).plan.asset.surfaces
    assert len(cage_notes(surfaces, spacing, refined=False)) == notes, "sqrt(3) / 2 m"

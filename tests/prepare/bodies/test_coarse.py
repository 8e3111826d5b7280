"""Notes on coarse meshes: cages far from the surface that renderers draw, and long faces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import solids
from pxr import Gf, Usd, UsdGeom

from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.bodies.coarse import (
    cage_notes,
    coarse_meshes,
    coarse_note,
    mesh_names,
)

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
    assert "up to 86.6 cm (4.3 spacings) away from them" in note, "spacing 2 m / 10"


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


APART = 0.1  # [m]


def test_meshes_with_long_faces_are_named():
    box, ball = (
        solids.cube((0.0, 0.0, 0.0), path="/Box"),
        solids.sphere(subdivisions=4, path="/Ball"),
    )
    assert coarse_meshes([ball], APART) == {}
    assert coarse_meshes([box], 0.5) == {}, "its diagonals are less than four spacings long"
    found = coarse_meshes([ball, box], APART)
    assert found == {"/Box": pytest.approx(2.0**0.5)}
    assert mesh_names(found, APART) == "</Box> (edges up to 14 spacings of 10 cm)"
    assert mesh_names({**found, "/Other": 1.0}, APART).startswith("</Box> and 1 more ")


def test_a_mesh_with_few_long_faces_is_fine_enough():
    """A cap of long triangles on one of many, as primitives have them."""
    ball = solids.sphere(subdivisions=4, path="/Ball")
    long = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 1.0, 0.0]])
    points = np.concatenate([ball.points, long])
    triangles = np.concatenate([ball.triangles, [[0, 1, 2]] + np.array(len(ball.points))])
    both = replace(ball, points=points, triangles=triangles)
    assert coarse_meshes([both], APART) == {}


def test_long_faces_are_noted_before_the_bake(cube: Path):
    """Only a warning after the bake said so."""
    polygons = Usd.Stage.Open(str(cube))
    UsdGeom.Mesh(polygons.GetPrimAtPath("/Cube")).GetSubdivisionSchemeAttr().Set("none")
    polygons.Save()
    plan = prepare(cube, particles=1000).plan
    (note,) = (note for note in plan.notes if "stay flat" in note)
    assert note.startswith("faces of </Cube> (edges up to 14 spacings of 20 cm) stay flat")
    assert "--max-edge-length auto" in note
    assert plan.coarse == ("/Cube",)
    assert prepare(cube, particles=1000, max_edge_length="auto").plan.coarse == ()
    assert prepare(cube, particles=1000, material="honey").plan.coarse == (), "no mesh is shown"


def test_a_cage_has_one_note(cube: Path):
    plan = prepare(cube, particles=1000).plan
    assert plan.coarse == ()
    none = coarse_note(plan.asset.surfaces, 2.0, refined=False)
    assert none == ("", ()), "its edges are short"

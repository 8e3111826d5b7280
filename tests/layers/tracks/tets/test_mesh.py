"""A TetMesh in the cache: tokens of the deformable APIs, rest shape, masses, and its motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade
from small_sources import PLAIN
from small_stages import info_of, particles_of

from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import MeshPose
from gf_usd.core.frames.particles import TetLattice
from gf_usd.layers.materials import write_materials
from gf_usd.layers.tracks.tets.mesh import TetTrack, point_shares

CUBE = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
KUHN = np.array(
    [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]
)
TETS = TetLattice(body=0, X=CUBE, tets=KUHN)


def test_shares_add_up_and_follow_the_tetrahedra() -> None:
    shares = point_shares(TETS)
    assert shares.sum() == pytest.approx(1.0)
    # The ends of the diagonal are corners of all six tetrahedra, the others of two.
    np.testing.assert_allclose(shares[[0, 7]], 6 / 24)
    np.testing.assert_allclose(shares[1:7], 2 / 24)


def test_the_prim_says_rest_shape_masses_and_motion(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    particles, info = particles_of(asset), info_of(asset)
    units = asset.facts.units
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.Scope.Define(stage, "/S")
    materials = write_materials(
        stage, stage.GetPrimAtPath("/S").GetPath().AppendChild("M"), info.materials, "rubber", units
    )
    path = stage.GetPrimAtPath("/S").GetPath().AppendChild("Tets")
    track = TetTrack(stage, path, TETS, particles, info, units, np.zeros(3), materials, still=True)
    for time in (1.0, 2.0):
        track.write(MeshPose(points=CUBE * time, velocities=CUBE), time)
    prim = stage.GetPrimAtPath(path)
    mesh = UsdGeom.TetMesh(prim)
    apis = set(prim.GetPrimTypeInfo().GetAppliedAPISchemas())
    assert apis >= {
        "PhysicsDeformableBodyAPI",
        "PhysicsVolumeDeformableSimAPI",
        "OmniPhysicsDeformableBodyAPI",
        "OmniPhysicsVolumeDeformableSimAPI",
        "PhysicsCollisionAPI",
    }
    rest = np.array(prim.GetAttribute("physics:restShapePoints").Get())
    np.testing.assert_allclose(rest * units.length, CUBE, atol=1e-6)
    np.testing.assert_array_equal(mesh.GetTetVertexIndicesAttr().Get(), KUHN)
    # USD's own finder of the surface agrees.
    surface = UsdGeom.TetMesh.ComputeSurfaceFaces(mesh, Usd.TimeCode.Default())
    assert {frozenset(face) for face in surface} == {
        frozenset(face) for face in mesh.GetSurfaceFaceVertexIndicesAttr().Get()
    }
    mass = float((particles.V0 * info.materials[0].density).sum()) / units.mass
    assert sum(prim.GetAttribute("physics:masses").Get()) == pytest.approx(mass, rel=1e-6)
    moved = np.array(mesh.GetPointsAttr().Get(2.0)) * units.length
    np.testing.assert_allclose(moved, 2 * CUBE, atol=1e-6)
    assert prim.GetAttribute("velocities").GetNumTimeSamples() == 2
    low, high = np.array(prim.GetAttribute("extent").Get(2.0)) * units.length
    np.testing.assert_allclose([low, high], [(0, 0, 0), (2, 2, 2)], atol=1e-6)
    assert mesh.GetPurposeAttr().Get() == UsdGeom.Tokens.guide
    bound, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    assert bound.GetPath() == materials[0]


def test_tetrahedra_need_the_scope_of_the_particles() -> None:
    assert not Choices(shapes=("mesh",)).particles
    assert Choices(shapes=("mesh",), tets=True).particles

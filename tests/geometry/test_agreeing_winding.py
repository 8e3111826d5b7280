"""Triangles wound opposite to their neighbors are turned before anything is filled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from solids import CUBE_TRIANGLES, asset, cube, sphere, surface

import gf_usd
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.geometry.repair import consistently_oriented_asset
from gf_usd.geometry.solid import build_solid

BALL = sphere(subdivisions=3, path="/Ball")
MIDDLE = BALL.points[BALL.triangles].mean(1)
FLIPS = {
    "a cap": MIDDLE[:, 0] > 0.3,
    "a third": np.arange(len(MIDDLE)) % 3 == 0,
    "any quarter": np.random.default_rng(1).random(len(MIDDLE)) < 0.25,
    "one": np.arange(len(MIDDLE)) == 7,
}


def flipped(which):
    triangles = np.where(which[:, None], BALL.triangles[:, ::-1], BALL.triangles)
    return surface(BALL.points, triangles, path="/Ball")


@pytest.mark.parametrize("which", FLIPS.values(), ids=FLIPS)
def test_a_ball_with_flipped_faces_is_the_ball(which):
    body, notes = consistently_oriented_asset(asset(flipped(which)))
    (made,) = body.surfaces
    assert signed_volume(made.points, made.triangles) == pytest.approx(
        signed_volume(BALL.points, BALL.triangles), rel=1e-12
    )
    assert build_solid(body).volume == pytest.approx(build_solid(asset(BALL)).volume, rel=1e-9)
    count = int(which.sum())
    verb = (
        "triangle facing the other way is" if count == 1 else "triangles facing the other way are"
    )
    assert notes == (
        f"</Ball>: {count} {verb} turned for the fill; the mesh itself does not change",
    )
    # what hangs on corners stays with them
    assert (made.face_indices[made.triangle_corners] == made.triangles).all()


def test_what_agrees_stays_as_it_is():
    """Parts inside out as a whole, too: they may be hollows."""
    inner = sphere(subdivisions=2)
    hollow = surface(0.5 * inner.points, inner.triangles[:, ::-1], path="/Hollow")
    whole = asset(BALL, hollow)
    body, notes = consistently_oriented_asset(whole)
    assert body is whole
    assert notes == ()


@pytest.mark.slow
def test_a_lid_of_a_box(tmp_path: Path, monkeypatch):
    """Two of twelve triangles: it did not fill, and its nodes were no numbers any more."""
    monkeypatch.chdir(tmp_path)
    box = cube((0.0, 0.0, 0.0))
    top = np.flatnonzero((box.points[CUBE_TRIANGLES][:, :, 1] == 1.0).all(1))
    triangles = CUBE_TRIANGLES.copy()
    triangles[top] = triangles[top][:, ::-1]
    found = {}
    for name, faces in (("sound", CUBE_TRIANGLES), ("lid", triangles)):
        stage = Usd.Stage.CreateNew(f"{name}.usda")
        mesh = UsdGeom.Mesh.Define(stage, "/World/Box")
        mesh.CreatePointsAttr(box.points.tolist())
        mesh.CreateFaceVertexCountsAttr([3] * 12)
        mesh.CreateFaceVertexIndicesAttr(faces.ravel().tolist())
        mesh.CreateSubdivisionSchemeAttr("none")
        stage.SetDefaultPrim(stage.GetPrimAtPath("/World"))
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        stage.Save()
        found[name] = gf_usd.bake(f"{name}.usda", material="rubber", particles=400, frames=12)
    assert found["lid"].particles == found["sound"].particles
    assert found["lid"].health["inverted_particle_frames"] == 0
    assert any("2 triangles facing the other way are turned" in n for n in found["lid"].notes)
    stage = Usd.Stage.Open("lid.rubber.usda")
    made = UsdGeom.Mesh(stage.GetPrimAtPath("/World/Box"))
    authored = list(made.GetFaceVertexIndicesAttr().Get())
    assert authored == triangles.ravel().tolist(), "the mesh is as it was"

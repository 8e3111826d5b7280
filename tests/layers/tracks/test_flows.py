"""A surface whose faces change from frame to frame, as a Mesh of the cache."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from small_sources import PLAIN
from small_stages import frames_of, info_of, particles_of

from gf_usd.core.asset import SurfaceMaterial, Texture
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import SurfacePose
from gf_usd.layers.cache import CacheWriter
from gf_usd.layers.check.run import review
from gf_usd.layers.root import write_root
from gf_usd.layers.tracks.flows import FlowTrack, flow_shading
from gf_usd.layers.variants import BakedVariant
from gf_usd.system.atomic_files import publish

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])


def pose(more: int = 0, faces: np.ndarray = FACES) -> SurfacePose:
    """A tetrahedron, with so many points that no face has."""
    points = np.concatenate([CORNERS, np.full((more, 3), 0.5)])
    return SurfacePose(
        points=points,
        velocities=0.5 * points,
        normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        colors=np.full((len(points), 3), 0.25),
        triangles=faces,
    )


@pytest.fixture
def stage() -> Usd.Stage:
    return Usd.Stage.CreateInMemory()


def track(stage: Usd.Stage, **options: Any) -> tuple[FlowTrack, UsdGeom.Mesh]:
    made = FlowTrack(stage, Sdf.Path("/Surface"), 0.01, np.zeros(3), **options)
    return made, UsdGeom.Mesh(made.prim)


def test_all_that_a_renderer_wants_is_there_at_every_sample(stage: Usd.Stage) -> None:
    made, mesh = track(stage)
    for time, one in ((1.0, pose()), (2.0, pose(more=3))):
        made.write(one, time)
        count = len(one.points)
        points = np.array(mesh.GetPointsAttr().Get(time))
        np.testing.assert_allclose(points, 100.0 * one.points, rtol=1e-6)
        np.testing.assert_allclose(mesh.GetVelocitiesAttr().Get(time), 50.0 * one.points, rtol=1e-6)
        assert len(mesh.GetNormalsAttr().Get(time)) == count
        assert len(mesh.GetDisplayColorAttr().Get(time)) == count
        np.testing.assert_array_equal(mesh.GetFaceVertexIndicesAttr().Get(time), FACES.ravel())
        assert list(mesh.GetFaceVertexCountsAttr().Get(time)) == [3, 3, 3, 3]
        np.testing.assert_allclose(
            mesh.GetExtentAttr().Get(time), [points.min(0), points.max(0)], rtol=1e-6
        )
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetNormalsInterpolation() == "vertex"
    assert UsdGeom.Primvar(mesh.GetDisplayColorAttr()).GetInterpolation() == "vertex"


def test_points_of_other_faces_are_not_interpolated(stage: Usd.Stage) -> None:
    made, mesh = track(stage)
    turned = FACES[[1, 0, 2, 3]]
    for time, faces in ((1.0, FACES), (2.0, FACES), (3.0, turned), (4.0, turned), (5.0, FACES)):
        made.write(pose(faces=faces), time)
    lengths = [len(mesh.GetPointsAttr().Get(t)) for t in (1.0, 2.0, 3.0, 4.0, 5.0)]
    assert lengths == [4, 4, 5, 5, 4], "equal only where the faces are"
    # USD holds what it cannot interpolate
    assert len(mesh.GetPointsAttr().Get(2.5)) == 4
    assert max(mesh.GetFaceVertexIndicesAttr().Get(3.0)) == 3, "the point is of no face"
    for name in ("velocities", "normals", "primvars:displayColor"):
        assert len(made.prim.GetAttribute(name).Get(3.0)) == 5


def test_a_track_that_continues_writes_what_one_would(stage: Usd.Stage) -> None:
    made, _ = track(stage)
    made.write(pose(), 1.0)
    other, mesh = track(stage)
    other.restore(json.loads(json.dumps(made.state())))
    other.write(pose(faces=FACES[::-1].copy()), 2.0)
    assert len(mesh.GetPointsAttr().Get(2.0)) == 5


def test_without_velocities_none_are_written_but_counted(stage: Usd.Stage) -> None:
    made, mesh = track(stage, velocities=False)
    made.write(pose(), 1.0)
    assert not mesh.GetVelocitiesAttr().HasAuthoredValue()
    assert made.saved.bytes == 4 * 12


def test_numbers_that_are_not_finite_are_refused(stage: Usd.Stage) -> None:
    made, _ = track(stage)
    with pytest.raises(BakeError, match="velocities of </Surface>"):
        made.write(replace(pose(), velocities=np.full((4, 3), np.nan)), 1.0)


def test_a_material_without_texture_is_bound(tmp_path: Path, stage: Usd.Stage) -> None:
    asset = PLAIN.asset(tmp_path)
    paths = [s.path for s in asset.surfaces]
    root = Sdf.Path(paths[0]).GetPrefixes()[0]
    plain = SurfaceMaterial(path=f"{root}/Looks/Blue", color=(0, 0, 1))
    image = Texture(pixels=np.zeros((1, 1, 3), np.uint8), srgb=True)

    def of(*materials: SurfaceMaterial) -> Sdf.Path | None:
        surfaces = tuple(replace(s, materials=materials) for s in asset.surfaces)
        return flow_shading(replace(asset, surfaces=surfaces), paths, root)

    assert of(plain) == Sdf.Path(plain.path)
    assert of() is None
    assert of(plain, replace(plain, path=f"{root}/Looks/Red")) is None, "which of them?"
    assert of(replace(plain, texture=image)) is None, "it would read coordinates"
    assert of(replace(plain, path="/Elsewhere/Blue")) is None, "a payload cannot refer to it"
    _, mesh = track(stage, shading=Sdf.Path("/Looks/Blue"))
    assert mesh.GetPrim().GetRelationship("material:binding").GetTargets() == ["/Looks/Blue"]


@pytest.mark.parametrize("clips", [0, 2])
def test_the_surface_is_shown_in_place_of_the_mesh(tmp_path: Path, clips: int) -> None:
    asset = PLAIN.asset(tmp_path)
    replaced = tuple(s.path for s in asset.surfaces)
    choices = Choices(flows=(0,), flowing=replaced, clip_frames=clips)
    particles, info = particles_of(asset), info_of(asset)
    cache = tmp_path / "c.cache.usdc"
    with CacheWriter(cache, asset, particles, info, choices=choices) as writer:
        for number, frame in enumerate(frames_of(asset, particles, info, choices)):
            writer.write(replace(frame, meshes={}, flows={0: pose(more=number % 3)}))
    publish(cache)
    look = BakedVariant(name=info.look, cache=cache, info=info)
    root = write_root(tmp_path / "root.usda", asset, [look], choices=choices)
    assert not review(root.path, asset.facts.path)
    stage = Usd.Stage.Open(str(root.path))
    scope = next(p for p in stage.Traverse() if p.GetName().endswith("GaussianFlesh")).GetPath()
    switch = stage.GetPrimAtPath(root.switches[0]).GetVariantSets()
    for display, shown in (("mesh", "Surface"), ("gaussians", "Gaussians"), ("points", "Points")):
        switch.SetSelection(root.display_set, display)
        visible = {
            name
            for name in ("Surface", "Gaussians", "Points")
            if UsdGeom.Imageable(stage.GetPrimAtPath(scope.AppendChild(name))).ComputeVisibility()
            != UsdGeom.Tokens.invisible
        }
        assert visible == {shown}
        for path in replaced:
            image = UsdGeom.Imageable(stage.GetPrimAtPath(path))
            assert image.ComputeVisibility() == UsdGeom.Tokens.invisible
    prim = stage.GetPrimAtPath(scope.AppendChild("Surface"))
    times = UsdGeom.Mesh(prim).GetPointsAttr().GetTimeSamples()
    assert len(times) == info.settings.frames
    assert len({len(UsdGeom.Mesh(prim).GetPointsAttr().Get(t)) for t in times}) > 1

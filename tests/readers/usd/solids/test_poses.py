"""Bind poses of deformable bodies: where a graphics mesh enters a bake."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gf_usd.core.errors import InputError
from gf_usd.readers import read_asset

POINTS = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
MOVED = [(x + 0.25, y, z) for x, y, z in POINTS]
AOUSD = ("PhysicsDeformablePoseAPI", "physics:deformablePose:rest:{}")
OMNI = ("OmniPhysicsDeformablePoseAPI", "deformablePose:rest:omniphysics:{}")


def pose(names: tuple[str, str], points: list, purpose: str = "bindPose") -> tuple[str, str]:
    """The API's name and the attributes of a pose."""
    api, template = names
    authored = f"""uniform token[] {template.format("purposes")} = ["{purpose}"]
        point3f[] {template.format("points")} = {points}"""
    return f'"{api}:rest"', authored


def stage(folder: Path, skin: tuple[str, str], solid: tuple[str, str] = ("", "")) -> Path:
    """A body of a simulation mesh, a tetrahedron, and a mesh for graphics of the same shape."""
    path = folder / "body.usda"
    comma = ", " if solid[0] else ""
    path.write_text(f"""#usda 1.0
( metersPerUnit = 1
  upAxis = "Y" )
def Xform "Body" ( prepend apiSchemas = ["PhysicsDeformableBodyAPI"] )
{{
    def TetMesh "Solid" ( prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI"{comma}{solid[0]}] )
    {{
        point3f[] points = {POINTS}
        int4[] tetVertexIndices = [(0, 1, 2, 3)]
        int3[] surfaceFaceVertexIndices = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
        {solid[1]}
    }}
    def Mesh "Skin" ( prepend apiSchemas = [{skin[0]}] )
    {{
        point3f[] points = {MOVED}
        int[] faceVertexCounts = [3, 3, 3, 3]
        int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
        {skin[1]}
    }}
}}
""")
    return path


def skin_of(path: Path) -> tuple[np.ndarray, str]:
    """Where the graphics mesh begins, and the notes."""
    asset = read_asset(path)
    (skin,) = [s for s in asset.surfaces if s.path == "/Body/Skin"]
    return skin.points, "\n".join(asset.facts.notes)


@pytest.mark.parametrize("names", [AOUSD, OMNI])
def test_a_graphics_mesh_begins_in_its_bind_pose(tmp_path: Path, names: tuple[str, str]) -> None:
    points, notes = skin_of(stage(tmp_path, pose(names, POINTS)))
    np.testing.assert_allclose(points, POINTS)
    assert "/Body/Skin" in notes
    assert "starts from its bind pose" in notes


def test_without_one_its_points_are_its_bind_pose(tmp_path: Path) -> None:
    points, notes = skin_of(stage(tmp_path, ('"MaterialBindingAPI"', "")))
    np.testing.assert_allclose(points, MOVED)
    assert "bind pose" not in notes


def test_a_pose_for_another_purpose_is_not_a_bind_pose(tmp_path: Path) -> None:
    points, notes = skin_of(stage(tmp_path, pose(AOUSD, POINTS, "selfCollisionFilterPose")))
    np.testing.assert_allclose(points, MOVED)
    assert "bind pose" not in notes


def test_where_the_simulation_mesh_has_left_its_own_points_stay(tmp_path: Path) -> None:
    path = stage(tmp_path, pose(AOUSD, POINTS), pose(AOUSD, MOVED))
    points, notes = skin_of(path)
    np.testing.assert_allclose(points, MOVED)
    assert "the simulation mesh </Body/Solid> is not in the bind pose" in notes
    assert "starts from its points, not from its bind pose" in notes


def test_a_bind_pose_of_another_mesh_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="</Body/Skin>: its bind pose has 3 points, but the mesh"):
        read_asset(stage(tmp_path, pose(AOUSD, POINTS[:3])))

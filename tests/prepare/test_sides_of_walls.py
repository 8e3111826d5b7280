"""A wall whose two sides are meshes of their own, from the stage to the plan and the bake."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from solids import sphere

import gf_usd
from gf_usd.pipeline.inspect import Inspection, inspect
from gf_usd.pipeline.prepared import prepare

SHELL = 4.0 / 3.0 * np.pi * (1.0 - 0.8**3)  # [m^3]
SPHERES = 0.02  # of its volume, that the flat faces of a sphere lack
RIGID = '(prepend apiSchemas = ["PhysicsRigidBodyAPI"])'


def ball(
    name: str, radius: float, *, inward: bool = False, more: str = "", turned: float = 0.0
) -> str:
    """A Mesh prim as text; turned : share of its faces whose winding is reversed."""
    body = sphere(radius, (0.0, 2.0, 0.0), subdivisions=2)
    chosen = np.random.default_rng(0).random(len(body.triangles)) < turned
    triangles = np.where(chosen[:, None], body.triangles[:, ::-1], body.triangles)
    corners = [int(i) for face in triangles for i in face]
    values = ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in body.points)
    return f"""
    def Mesh "{name}" {more}
    {{
        uniform token orientation = "{"leftHanded" if inward else "rightHanded"}"
        int[] faceVertexCounts = {[3] * len(body.triangles)}
        int[] faceVertexIndices = {corners}
        point3f[] points = [{values}]
        uniform token subdivisionScheme = "none"
    }}
"""


def stage(folder: Path, *prims: str) -> Path:
    path = folder / "egg.usda"
    path.write_text(
        '#usda 1.0\n(\ndefaultPrim = "Root"\nmetersPerUnit = 1\nupAxis = "Y"\n)\n'
        f'def Xform "Root"\n{{{"".join(prims)}}}\n',
        encoding="utf-8",
    )
    return path


def seen_of(folder: Path, *prims: str, **options: Any) -> Inspection:
    return inspect(stage(folder, *prims), spacing=0.2, **options)


def volume(seen: Inspection) -> float:
    assert seen.plan is not None
    return seen.plan.particles.volume


@pytest.mark.slow
@pytest.mark.parametrize("repair", [False, True])
def test_the_wall_of_an_egg_is_filled(tmp_path: Path, repair: bool) -> None:
    """All of it was filled, 4 m^3 in place of 2."""
    seen = seen_of(tmp_path, ball("Outer", 1.0), ball("Inner", 0.8, inward=True), repair=repair)
    assert volume(seen) == pytest.approx(SHELL, rel=5.0 * SPHERES)
    assert seen.fill_of("/Root/Outer") == ("filled", "")
    assert seen.fill_of("/Root/Inner") == (
        "rides along",
        "it faces inward and bounds the wall of </Root/Outer>, which is filled",
    )
    (note,) = (note for note in seen.notes if note.startswith("</Root/Inner>"))
    assert note.startswith("</Root/Inner> faces into </Root/Outer>, as the inner side of a wall")
    assert seen.warnings == ()
    assert seen.plan is not None
    assert [len(s.points) for s in seen.plan.asset.surfaces] == [162, 162]


@pytest.mark.slow
@pytest.mark.parametrize("repair", [False, True])
def test_a_wall_of_mixed_winding_is_found(tmp_path: Path, repair: bool) -> None:
    """With a repair all of it was filled."""
    prims = ball("Outer", 1.0, turned=0.3), ball("Inner", 0.8, inward=True, turned=0.3)
    seen = seen_of(tmp_path, *prims, repair=repair)
    assert volume(seen) == pytest.approx(SHELL, rel=5.0 * SPHERES)
    if repair:
        (one,) = seen.repairs
        assert one.turned > 100


@pytest.mark.slow
def test_the_inner_side_moves_with_its_wall_not_with_what_is_next_to_it(tmp_path: Path) -> None:
    prims = ball("Outer", 1.0), ball("Inner", 0.8, inward=True), ball("Yolk", 0.7)
    seen = seen_of(tmp_path, *prims)
    assert seen.plan is not None
    assert seen.plan.bodies is not None
    assert seen.plan.bodies.embedded == {"/Root/Outer": 0, "/Root/Inner": 0, "/Root/Yolk": 1}


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        RIGID,
        '(kind = "component")',
        '(prepend apiSchemas = ["GaussianFleshBakeAPI"])',
    ],
    ids=["body", "component", "material"],
)
def test_a_mesh_that_the_stage_tells_apart_is_a_body(tmp_path: Path, more: str) -> None:
    inner = ball("Inner", 0.8, inward=True, more=more)
    if "Flesh" in more:
        inner = inner.replace("{\n", '{\n        token gaussianFlesh:material = "jelly"\n', 1)
    seen = seen_of(tmp_path, ball("Outer", 1.0), inner)
    assert volume(seen) > 1.8 * SHELL
    assert not any("as the inner side of a wall" in note for note in seen.notes)


@pytest.mark.slow
def test_two_that_face_outward_are_filled_with_a_hint(tmp_path: Path) -> None:
    seen = seen_of(tmp_path, ball("Outer", 1.0), ball("Inner", 0.8))
    assert volume(seen) == pytest.approx(4.0 / 3.0 * np.pi, rel=2.0 * SPHERES)
    (note,) = (note for note in seen.notes if "the two sides of a wall" in note)
    assert note.endswith(
        "turn the faces of </Root/Outer> outward and those of </Root/Inner> inward"
        " (in USD by the attribute orientation)"
    )


@pytest.mark.slow
def test_a_visible_collider_of_a_body_is_no_wall(tmp_path: Path) -> None:
    """The visible mesh of a robot's link and its collider were called the sides of a wall."""
    collider = '(prepend apiSchemas = ["PhysicsCollisionAPI"])'
    link = ball("Seen", 0.95) + ball("Collider", 1.0, more=collider)
    seen = seen_of(tmp_path, f'def Xform "Link" {RIGID}\n{{\n{link}\n}}\n')
    assert not any("the two sides of a wall" in note for note in seen.notes)
    (note,) = (note for note in seen.notes if "purpose guide" in note)
    assert note.startswith(
        "</Root/Link/Collider> is a collider of the body of </Root/Link/Seen> and about as large"
    )


@pytest.mark.slow
def test_a_coarser_resolution_has_the_wall_too(tmp_path: Path) -> None:
    path = stage(tmp_path, ball("Outer", 1.0), ball("Inner", 0.8, inward=True))
    prepared = prepare(path, spacing=0.1, certify=True, output=tmp_path / "b.usda")
    assert prepared.refill is not None
    coarse = prepared.refill(0.2)
    assert coarse.particles.volume == pytest.approx(SHELL, rel=5.0 * SPHERES)
    assert [s.path for s in coarse.asset.surfaces] == ["/Root/Outer", "/Root/Inner"]


@pytest.mark.slow
def test_a_bake_moves_both_sides(tmp_path: Path) -> None:
    path = stage(tmp_path, ball("Outer", 1.0), ball("Inner", 0.8, inward=True))
    done = gf_usd.bake(path, spacing=0.2, frames=4, drop=2.0, output=tmp_path / "b.usda")
    assert not done.findings
    baked = Usd.Stage.Open(str(done.root))
    for name in ("Outer", "Inner"):
        points = UsdGeom.Mesh(baked.GetPrimAtPath(f"/Root/{name}")).GetPointsAttr()
        first, last = (np.asarray(points.Get(code)) for code in (1.0, 4.0))
        fallen = 0.5 * 9.81 * (3.0 / 24.0) ** 2
        np.testing.assert_allclose(last - first, np.tile([0.0, -fallen, 0.0], (162, 1)), atol=1e-4)


SUBSET = """
    def GeomSubset "Half"
    {
        uniform token elementType = "face"
        uniform token familyName = "pins"
        int[] indices = [0, 1, 2, 3, 4, 5, 6, 7]
    }
"""


@pytest.mark.slow
def test_an_inner_side_can_be_pinned(tmp_path: Path) -> None:
    """It was refused as a mesh that is not filled."""
    inner = ball("Inner", 0.8, inward=True)
    end = inner.rindex("}")
    prims = (ball("Outer", 1.0), inner[:end] + SUBSET + inner[end:])
    seen = seen_of(tmp_path, *prims, pins=["/Root/Inner/Half"])
    assert seen.refusal is None
    assert seen.plan is not None
    assert len(seen.plan.pins) == 1


@pytest.mark.slow
def test_meshes_of_different_advised_materials_are_no_wall(tmp_path: Path) -> None:
    steel, foam = ball("steel_shell", 1.0), ball("foam_core", 0.8, inward=True)
    seen = seen_of(tmp_path, steel, foam, material="auto")
    assert seen.plan is not None
    assert {one.material for one in seen.plan.advice} == {"metal", "foam"}


@pytest.mark.parametrize("repair", [False, True])
def test_a_count_of_the_inner_side_is_that_of_the_wall(tmp_path: Path, repair: bool) -> None:
    """It was ignored, and there were 8000."""
    inner = ball("Inner", 0.8, inward=True)
    inner = inner.replace("uniform", "uniform int gaussianFlesh:particles = 400\nuniform", 1)
    path = stage(tmp_path, ball("Outer", 1.0), inner)
    plan = inspect(path, repair=repair).plan
    assert plan is not None
    spacing = np.cbrt(plan.particles.volume / 400)
    assert plan.particles.spacing == pytest.approx(spacing, rel=0.01)

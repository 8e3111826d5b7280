"""--flesh with meshes that a single joint carries, such as shoes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm import BOOT, BOOT_CORNERS, BOOT_FACES, FIRST, LAST, arm, booted, drawn, write
from pxr import Usd

import gf_usd
from gf_usd.core.errors import InputError
from gf_usd.prepare.prepare import prepare

FEW = {"particles": 400, "preroll": 6, "flesh": True, "material": "jelly"}
MORE = {**FEW, "particles": 3000}  # with which half of the boot's half thickness is a cell


@pytest.mark.slow
def test_a_mesh_of_one_joint_without_a_bone_of_its_own_is_rigid(tmp_path: Path) -> None:
    """Hair hung from its head, and pulled it to a point."""
    path, out = booted(tmp_path), tmp_path / "out.usda"
    plan, _ = prepare(path, **MORE, output=out, draw=None)
    note = "</Arm/Boot> moves with a single joint and has no bone of its own: it is kept rigid"
    assert note in " ".join(plan.notes)
    assert "as soft as the rest; --rigid" not in " ".join(plan.notes)
    *bones, boot = plan.pins
    assert (boot.name, boot.meshes) == ("/Arm/Boot", {"/Arm/Boot"})
    np.testing.assert_array_equal(boot.path, bones[1].path)


@pytest.mark.slow
def test_a_mesh_of_one_joint_that_is_soft_is_named_with_the_way_to_keep_it_rigid(
    tmp_path: Path,
) -> None:
    path, out = booted(tmp_path), tmp_path / "out.usda"
    springs = {**MORE, "goal_frequency": 4.0}
    plan, _ = prepare(path, **springs, output=out, draw=None)
    note = "</Arm/Boot> moves with a single joint and becomes as soft as the rest; --rigid keeps"
    assert note in " ".join(plan.notes)
    kept, _ = prepare(path, **springs, rigid=["/Arm/Boot"], output=out, draw=None)
    assert note not in " ".join(kept.notes)
    *bones, boot = kept.pins
    assert (boot.name, boot.rigid, boot.meshes) == ("/Arm/Boot", False, {"/Arm/Boot"})
    np.testing.assert_array_equal(boot.path, bones[1].path)
    plain, _ = prepare(write(tmp_path, arm()), **MORE, output=out, draw=None)
    assert "single joint" not in " ".join(plain.notes)


def test_a_mesh_of_one_joint_that_no_flesh_holds_is_rigid(tmp_path: Path) -> None:
    """It fell, although it is bound to a joint."""
    body = arm().rstrip().removesuffix("}") + BOOT.replace(
        "rel skel:skeleton", "matrix4d primvars:skel:geomBindTransform = "
        "( (1,0,0,0), (0,1,0,0), (0,0,1,0), (2,0,0,1) )\n        rel skel:skeleton"
    )  # fmt: skip
    plan, _ = prepare(write(tmp_path, body), **FEW, output=tmp_path / "o.usda", draw=None)
    note = "</Arm/Boot> moves with a single joint and touches no flesh: it is kept rigid"
    assert note in " ".join(plan.notes)
    assert "as soft as the rest" not in " ".join(plan.notes)
    *bones, boot = plan.pins
    assert (boot.name, boot.meshes) == ("/Arm/Boot", {"/Arm/Boot"})
    np.testing.assert_array_equal(boot.path, bones[1].path)


def test_a_mesh_of_one_joint_that_is_too_thin_for_the_grid_is_rigid(tmp_path: Path) -> None:
    """A sword in a hand hung down like a noodle."""
    plan, _ = prepare(booted(tmp_path), **FEW, output=tmp_path / "o.usda", draw=None)
    notes = " ".join(plan.notes)
    assert "</Arm/Boot> moves with a single joint and is too thin for the grid, which" in notes
    assert "as soft as the rest" not in notes
    *bones, boot = plan.pins
    assert (boot.name, boot.meshes) == ("/Arm/Boot", {"/Arm/Boot"})
    np.testing.assert_array_equal(boot.path, bones[1].path)


@pytest.mark.slow
def test_a_box_of_a_rigid_region_is_none_that_a_joint_carries(tmp_path: Path) -> None:
    plan, _ = prepare(
        booted(tmp_path), **MORE, rigid=["box:1.6,-1,-1,3,1,1"], goal_frequency=4.0,
        output=tmp_path / "o.usda", draw=None,
    )  # fmt: skip
    assert [pin.rigid for pin in plan.pins] == [False, False, True]


@pytest.mark.slow
def test_a_rigid_boot_moves_with_its_joint(tmp_path: Path) -> None:
    """To single precision; what is soft is bent by more than a millimeter."""
    path = booted(tmp_path)
    for rigid in ([], ["/Arm/Boot"]):
        out = tmp_path / f"out{len(rigid)}.usda"
        gf_usd.bake(
            path, **MORE, goal_frequency=0.5, rigid=rigid, output=out, progress=None
        )  # fmt: skip
        stage = Usd.Stage.Open(str(out))
        for code, angle in ((FIRST, 20.0), (LAST, 60.0)):
            c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
            R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            posed = (BOOT_CORNERS - [1.0, 0.0, 0.0]) @ R.T + [1.0, 0.0, 0.0]
            away = np.abs(drawn(stage, code, "/Arm/Boot") - posed).max()
            assert (away < 1e-5) if rigid else (away > 1e-3)


def cape(height: float) -> str:
    """A box over the middle of the arm that both joints carry, as far above it as given [m]."""
    points = [(x, 0.2 + height + y, z) for x, y, z in (BOOT_CORNERS - (0.9, -0.3, 0.0)).tolist()]
    return f"""
    def Mesh "Cape" ( prepend apiSchemas = ["SkelBindingAPI"] )
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points = {points}
        int[] faceVertexCounts = {[4] * 6}
        int[] faceVertexIndices = {BOOT_FACES}
        rel skel:skeleton = </Arm/Skel>
        int[] primvars:skel:jointIndices = {[0, 1] * len(points)} (
            elementSize = 2
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = {[0.25, 0.75] * len(points)} (
            elementSize = 2
            interpolation = "vertex"
        )
    }}
}}
"""


HELD = (
    "</Arm/Cape> follows several joints and touches no flesh: springs hold it in its skinned pose"
)


@pytest.mark.parametrize(
    ("height", "options", "held"),
    [
        (1.5, {}, True),
        (0.02, {}, False),  # the flesh carries it
        (1.5, {"goal_frequency": 6.0}, False),  # the springs that were asked for do
        (1.5, {"squish": 0.5}, True),
    ],
)
def test_a_mesh_of_several_joints_that_no_flesh_holds_has_springs(
    tmp_path: Path, height: float, options: dict[str, float], held: bool
) -> None:
    body = arm().rstrip().removesuffix("}") + cape(height)
    plan, _ = prepare(
        write(tmp_path, body), **FEW, **options, output=tmp_path / "o.usda", draw=None
    )
    assert (HELD in " ".join(plan.notes)) == held
    if held:
        assert plan.goals is not None
        over, skin = plan.goals.rate(np.array([[1.0, 0.2 + height + 0.3, 0.0], [1.0, 0.0, 0.0]]))
        assert over > 100.0
        assert skin == 0.0


@pytest.mark.slow
def test_a_cape_that_no_flesh_holds_moves_with_its_skin(tmp_path: Path) -> None:
    """It fell, although it is bound to joints."""
    path = write(tmp_path, arm().rstrip().removesuffix("}") + cape(1.5))
    done = gf_usd.bake(path, **FEW, output=tmp_path / "out.usda")
    moved = drawn(Usd.Stage.Open(str(done.root)), LAST, "/Arm/Cape")
    # B turns by 60 degrees about (1, 0, 0)
    a = np.deg2rad(60.0)
    rest = drawn(Usd.Stage.Open(str(path)), FIRST, "/Arm/Cape")
    turn = np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    turned = (rest - (1.0, 0.0, 0.0)) @ turn + (1.0, 0.0, 0.0)
    wanted = 0.25 * rest + 0.75 * turned
    # within the way of a quarter of a frame: it follows with the lag of its springs
    way = np.linalg.norm(wanted - rest, axis=1).max()
    assert np.linalg.norm(moved - wanted, axis=1).max() < 0.25 * way / (LAST - FIRST) + 0.02


def test_a_mesh_that_is_named_is_baked_or_refused(tmp_path: Path) -> None:
    """It was left out with a note, although --prim named it."""
    stool = """
    def Cube "Stool"
    {
        double size = 0.3
        double3 xformOp:translate = (0.5, -2, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
    path = write(tmp_path, arm().rstrip().removesuffix("}") + stool)
    options = {**FEW, "output": tmp_path / "o.usda", "draw": None}
    plan, _ = prepare(path, prims=["/Arm/Skin"], **options)
    assert [s.path for s in plan.asset.surfaces] == ["/Arm/Skin"]
    prepare(path, **options)  # with a note
    with pytest.raises(InputError, match="--prim /Arm/Stool --flesh: it cannot be baked: no") as e:
        prepare(path, prims=["/Arm/Skin", "/Arm/Stool"], **options)
    assert "bind it to the skeleton" in str(e.value.hint)

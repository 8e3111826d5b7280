"""--flesh with skinned meshes that enclose no volume: skirts, hair, clothes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from arm import BOOT_CORNERS, BOOT_FACES, FIRST, LAST, arm_with, bound_mesh, drawn, faces, points
from pxr import Usd

import gf_usd
from gf_usd.core.errors import InputError
from gf_usd.prepare.prepare import prepare

FEW = {"particles": 400, "preroll": 12, "flesh": True, "material": "rubber", "progress": None}
Corners = list[tuple[float, ...]]
AROUND, TURNS = 12, np.arange(12) * np.pi / 6.0


def tube(along: tuple[float, ...], radii: tuple[float, ...]) -> tuple[Corners, Corners]:
    """Points and quads of an open tube around the arm."""
    rings = [
        (x, r * np.cos(turn), r * np.sin(turn)) for x, r in zip(along, radii) for turn in TURNS
    ]
    corners = [
        (k * AROUND + j, k * AROUND + (j + 1) % AROUND,
         (k + 1) * AROUND + (j + 1) % AROUND, (k + 1) * AROUND + j)
        for k in range(len(along) - 1)
        for j in range(AROUND)
    ]  # fmt: skip
    return rings, corners


def skirted(
    folder: Path, along: tuple[float, ...], radii: tuple[float, ...], joint: int, other: int = -1
) -> Path:
    """The arm with an open tube around it, /Arm/Skirt, that is bound to one joint; other : that of
    its last ring, the same by default.
    """
    rings, corners = tube(along, radii)
    bound = [joint] * (len(rings) - AROUND) + [joint if other < 0 else other] * AROUND
    return arm_with(folder, bound_mesh("Skirt", rings, corners, bound))


def posed(X: np.ndarray, code: float) -> np.ndarray:
    """Points (n, 3) [m] that joint B carries; it bends by 20 degrees at first and 60 at last."""
    angle = np.deg2rad(20.0 if code == FIRST else 60.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    out = X.copy()
    out[:, :2] = (X[:, :2] - (1.0, 0.0)) @ turn.T + (1.0, 0.0)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("skin", ["embed", "idw"])
def test_a_skirt_follows_its_joint_and_not_the_flesh_that_is_nearest(
    tmp_path: Path, skin: str
) -> None:
    """The hem of a skirt was torn between the legs that it happened to be near."""
    path = skirted(tmp_path, (1.0, 0.6, 0.2), (0.35, 0.7, 1.1), joint=1)
    out = tmp_path / "out.usda"
    result = gf_usd.bake(path, output=out, skin=skin, **FEW)
    notes = " ".join(result.notes)
    assert "</Arm/Skirt> is not filled: it follows its skinned pose, and the flesh near it" in notes
    assert "becomes as soft" not in notes
    baked = Usd.Stage.Open(str(out))
    X = drawn(Usd.Stage.Open(str(path)), FIRST, "/Arm/Skirt")
    for code in (FIRST, LAST):
        away = np.linalg.norm(drawn(baked, code, "/Arm/Skirt") - posed(X, code), axis=1)
        # at 1.1 m from the arm it is there to single precision; with A it would be 1 m from there
        assert away[-AROUND:].max() < 1e-5, code
        assert away[:AROUND].max() < 0.15, code  # around the joint the flesh bends


@pytest.mark.slow
def test_a_narrow_skirt_is_not_filled_around_the_body(tmp_path: Path) -> None:
    """Its holes are 12 % of its area: with the arm in it, it became a slab."""
    path = skirted(tmp_path, (0.2, 0.5, 0.8, 1.1, 1.4, 1.7), (0.4,) * 6, joint=1)
    result = gf_usd.bake(path, output=tmp_path / "out.usda", **FEW)
    notes = " ".join(result.notes)
    assert re.search(r"</Arm/Skirt> is not filled: .* others pass through its holes", notes)
    assert "filled despite" not in notes


def test_a_sheet_of_one_joint_can_be_rigid_and_one_of_several_cannot(tmp_path: Path) -> None:
    """A skirt in --rigid made the legs in it rigid, and turned flesh inside out."""
    shape = (1.0, 0.6, 0.2), (0.35, 0.7, 1.1)
    options = {"particles": 400, "preroll": 12, "flesh": True, "rigid": ["/Arm/Skirt"]}
    options |= {"output": tmp_path / "out.usda", "draw": None}
    plan, _ = prepare(skirted(tmp_path, *shape, joint=1), **options)
    assert "</Arm/Skirt> is not filled: it moves exactly with its joint" in " ".join(plan.notes)
    assert plan.sheets == {}
    with pytest.raises(InputError, match=r"--rigid /Arm/Skirt --flesh: .* the surface is open: "):
        prepare(skirted(tmp_path, *shape, joint=1, other=0), **options)


def clothed(folder: Path, *clothes: str) -> Path:
    """The arm with meshes under /Arm/Clothes."""
    return arm_with(folder, '    def Xform "Clothes"\n    {\n', *clothes, "    }\n")


FLARED = tube((1.0, 0.6, 0.2), (0.35, 0.7, 1.1))
TWO = [0] * 24 + [1] * 12
SCARCE = {"particles": 200, "flesh": True, "preroll": 6, "draw": None}


def test_a_prim_with_sheets_only_cannot_be_rigid(tmp_path: Path) -> None:
    """With the name of their parent, skirts made the legs in them rigid."""
    skirts = [bound_mesh(name, *FLARED, TWO) for name in ("Skirt", "Apron")]
    options = SCARCE | {"rigid": ["/Arm/Clothes"], "output": tmp_path / "out.usda"}
    with pytest.raises(InputError) as refused:
        prepare(clothed(tmp_path, *skirts), **options)
    assert "--rigid /Arm/Clothes --flesh: </Arm/Clothes/Skirt>" in refused.value.message
    assert "they follow their skinned poses" in refused.value.message
    assert "a mesh that is closed" in refused.value.hint


def solidified() -> str:
    """A closed wall around the arm, 1 cm thick: /Arm/Skirt."""
    made = trimesh.creation.annulus(0.44, 0.45, height=0.6)
    X = np.array(made.vertices)[:, [2, 0, 1]] + (0.5, 0.0, 0.0)
    return bound_mesh("Skirt", X, made.faces, [0, 1] * len(X), [0.5] * 2 * len(X))


def test_repair_leaves_closed_sheets_and_thickens_open_ones(tmp_path: Path) -> None:
    """With --repair a solidified skirt was a slab of jelly again."""
    path = arm_with(tmp_path, solidified(), bound_mesh("Open", *FLARED, TWO))
    plan, _ = prepare(path, **SCARCE, repair=True, output=tmp_path / "out.usda")
    assert list(plan.sheets) == ["/Arm/Skirt"]
    notes = " ".join(plan.notes)
    assert "</Arm/Skirt> is not filled: it follows its skinned pose" in notes
    assert "</Arm/Skirt> repaired" not in notes
    thick = {one.path: one.thickened for one in plan.repairs}
    assert thick == {"/Arm/Skin": 0, "/Arm/Open": 1, "/Arm/Skirt": 0}


def test_a_closed_sheet_that_cannot_be_rigid_is_not_called_open(tmp_path: Path) -> None:
    options = SCARCE | {"rigid": ["/Arm/Skirt"], "output": tmp_path / "out.usda"}
    with pytest.raises(InputError) as refused:
        prepare(arm_with(tmp_path, solidified()), **options)
    assert "mm thick on average, less than" in refused.value.message
    assert "volume" not in refused.value.message
    assert refused.value.hint == "omit it; or use more --particles, or bind it to a single joint"


def test_sheets_are_no_part_of_a_rigid_prim_above_them(tmp_path: Path) -> None:
    boot = np.array(BOOT_FACES).reshape(-1, 4)
    clothes = [
        bound_mesh("Boot", BOOT_CORNERS, boot, [0, 1] * 8, [0.5] * 16),
        bound_mesh("Skirt", *FLARED, TWO),
    ]
    options = SCARCE | {"rigid": ["/Arm/Clothes"], "output": tmp_path / "out.usda"}
    plan, _ = prepare(clothed(tmp_path, *clothes), **options)
    (pin,) = (pin for pin in plan.pins if pin.rigid)
    in_skirt, in_boot = np.array([[0.6, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert pin.inside(np.array([in_boot])).all()
    assert not pin.inside(np.array([in_skirt])).any()
    assert list(plan.sheets) == ["/Arm/Clothes/Skirt"]


@pytest.mark.parametrize("sword", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_flesh_without_a_bone_in_it_is_refused(tmp_path: Path, sword: bool) -> None:
    """There was a traceback; and a sword apart from it would not hold it either."""
    X, corners = points(), faces()
    two = np.concatenate([X + (0.0, 1.0, 0.0), X - (0.0, 1.0, 0.0)])
    both = corners + [[c + len(X) for c in face] for face in corners]
    share = np.clip(two[:, 0] - 0.5, 0.0, 1.0)
    weights = np.stack([1.0 - share, share], 1).ravel().tolist()
    skin = bound_mesh("Skin", two, both, [0, 1] * len(two), weights)
    apart = np.array(BOOT_FACES).reshape(-1, 4)
    more = [bound_mesh("Sword", BOOT_CORNERS + (3.0, 0.0, 0.0), apart, [1] * 8)] if sword else []
    options = {"particles": 200, "flesh": True, "output": tmp_path / "out.usda", "draw": None}
    with pytest.raises(InputError, match="none of 2 bones lies inside the flesh"):
        prepare(arm_with(tmp_path, *more, skin=skin), **options)


def test_points_of_a_sheet_without_weights_are_counted_in_a_note(tmp_path: Path) -> None:
    skirt = bound_mesh("Skirt", *FLARED, TWO, [1.0] * 35 + [0.0])
    plan, _ = prepare(arm_with(tmp_path, skirt), **SCARCE, output=tmp_path / "out.usda")
    assert list(plan.sheets) == ["/Arm/Skirt"]
    notes = " ".join(plan.notes)
    assert "</Arm/Skirt>: 1 of 36 points has no joint weights and takes those" in notes
    assert "</Arm/Skirt> is not filled: it follows its skinned pose" in notes


def test_a_thickened_sheet_has_springs(tmp_path: Path) -> None:
    """It has more points than weights: there was a traceback."""
    path = arm_with(tmp_path, bound_mesh("Open", *FLARED, TWO))
    options = SCARCE | {"repair": True, "goal_frequency": 4.0}
    plan, _ = prepare(path, **options, output=tmp_path / "out.usda")
    assert plan.goals is not None
    X = np.array([[0.2, 1.1, 0.0]])  # at the ring of joint B
    ends = [plan.goals.pose(X)(frame) for frame in (0, LAST - FIRST + 6)]
    assert np.linalg.norm(ends[1] - ends[0]) > 0.5, "it turns about B, 1.4 m from there"

"""Attachments of the AOUSD proposal: what they hold, where it goes, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_bakes import BLOCK

import gf_usd
from gf_usd.core.errors import InputError
from gf_usd.prepare.prepare import prepare

CORNERS = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]
FACES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
HELD = [0, 1, 4, 5]  # y = 0


def stage(folder: Path, authored: str = "", *, held: list[int] = HELD, shift: float = 0.0) -> Path:
    """A cube of 1 m, the points of whose floor hang on a prim that rises by 2 m in 12 frames."""
    places = [CORNERS[k] for k in held]
    coords = ", ".join(str((x + shift, y - 5.0, z)) for x, y, z in places)
    path = folder / "cube.usda"
    path.write_text(f"""#usda 1.0
( metersPerUnit = 1
  upAxis = "Y"
  startTimeCode = 1
  endTimeCode = 13
  timeCodesPerSecond = 24 )
def Mesh "Cube"
{{
    point3f[] points = {CORNERS}
    int[] faceVertexCounts = {[4] * 6}
    int[] faceVertexIndices = {FACES}
}}
def Xform "Lift"
{{
    double3 xformOp:translate.timeSamples = {{ 1: (0, 5, 0), 13: (0, 7, 0) }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
def PhysicsAttachment "Hook"
{{
    rel physics:src0 = </Cube>
    rel physics:src1 = </Lift>
    uniform token physics:type0 = "point"
    uniform token physics:type1 = "xform"
    int[] physics:indices0 = {held}
    vector3f[] physics:coords1 = [{coords}]
    {authored}
}}
""")
    return path


@pytest.mark.parametrize("authored", ["", "float physics:stiffness = inf"])
def test_points_of_a_face_are_held_and_move_as_the_prim(tmp_path: Path, authored: str) -> None:
    options = {"particles": 100, "frames": 13, "output": tmp_path / "out.usda"}
    plan, _ = prepare(stage(tmp_path, authored), draw=None, **options)
    (pin,) = plan.pins
    assert pin.name == "/Hook"
    assert not any(plan.settings.lift)  # what is held stays where it is
    rise = pin.path[:, :, 1] - pin.path[0, :, 1]
    np.testing.assert_allclose(rise, np.linspace(0.0, 2.0, 13)[:, None].repeat(4, 1), atol=1e-6)
    held = pin.inside(np.array([[0.5, 0.0, 0.5], [0.5, -0.1, 0.5], [0.5, 0.5, 0.5]]))
    np.testing.assert_array_equal(held, [True, True, False])
    assert "attachments pin parts of the body: /Hook" in plan.notes


@pytest.mark.parametrize(
    ("authored", "message"),
    [
        ("bool physics:attachmentEnabled = false", ""),
        ("float physics:stiffness = 0", "attachment of stiffness 0"),
        ('uniform token physics:type1 = "face"', "does not attach points of a mesh"),
    ],
)
def test_what_is_no_hard_attachment_of_points_holds_nothing(
    tmp_path: Path, authored: str, message: str
) -> None:
    path = stage(tmp_path)
    text = (
        path.read_text().replace('uniform token physics:type1 = "xform"\n', "")
        if ("type1" in authored)
        else path.read_text()
    )
    path.write_text(
        text.replace("int[] physics:indices0", f"{authored}\n    int[] physics:indices0")
    )
    plan, _ = prepare(path, draw=None, particles=100, output=tmp_path / "out.usda")
    assert not plan.pins
    assert message in " ".join(plan.notes)
    assert ("/Hook" in " ".join(plan.notes)) == bool(message)


def test_a_soft_attachment_is_a_spring_of_each_point(tmp_path: Path) -> None:
    """In grams: k [g/s^2] and c [g/s] are N/m and N s/m by 1e-3; places may lie elsewhere."""
    authored = "float physics:stiffness = 4e5\n    float physics:damping = 300"
    path = stage(tmp_path, authored, held=[0, 1], shift=0.1)
    path.write_text(
        path.read_text().replace(
            "( metersPerUnit = 1", "( metersPerUnit = 1\n  kilogramsPerUnit = 0.001"
        )
    )
    options = {"particles": 100, "frames": 13, "output": tmp_path / "out.usda"}
    plan, _ = prepare(path, draw=None, **options)
    assert not plan.pins
    assert not any(plan.settings.lift)
    assert plan.goals is not None
    springs = plan.goals.attached
    assert springs is not None
    np.testing.assert_allclose(springs.X, [CORNERS[0], CORNERS[1]])
    np.testing.assert_allclose(springs.stiffness, 400.0)
    np.testing.assert_allclose(springs.damping, 0.3)
    rise = np.linspace(0.0, 2.0, 13)[:, None, None] * np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(springs.path, springs.X + [0.1, 0.0, 0.0] + rise, atol=1e-6)
    assert "attachments pull parts of the body with springs: /Hook" in plan.notes


@pytest.mark.parametrize(
    "authored",
    ["float physics:stiffness = -1", "float physics:stiffness = nan",
     "float physics:stiffness = 5\n    float physics:damping = inf",
     'string physics:stiffness = "hard"'],
)  # fmt: skip
def test_a_stiffness_that_is_none_is_refused(tmp_path: Path, authored: str) -> None:
    with pytest.raises(InputError) as caught:
        prepare(stage(tmp_path, authored), draw=None, particles=100, output=tmp_path / "out.usda")
    assert "Hook" in caught.value.message
    assert "author a number of 0 or more" in caught.value.hint


def test_points_away_from_their_places_move_as_the_places_do(tmp_path: Path) -> None:
    options = {"particles": 100, "frames": 2, "output": tmp_path / "out.usda"}
    plan, _ = prepare(stage(tmp_path, shift=0.1), draw=None, **options)
    (pin,) = plan.pins
    np.testing.assert_allclose(pin.path[0], pin.anchors, atol=1e-6)
    assert "up to 10 cm away from the positions they are attached to" in " ".join(plan.notes)


@pytest.mark.parametrize(
    ("held", "drop", "message"),
    [
        ([0, 1], "", "its 2 points do not include all corners of any face"),
        (HELD, "vector3f[] physics:coords1", "has 4 indices0 but 0 coords1"),
    ],
)
def test_arrays_that_make_no_sense_are_refused(
    tmp_path: Path, held: list[int], drop: str, message: str
) -> None:
    path = stage(tmp_path, held=held)
    lines = [line for line in path.read_text().splitlines() if not drop or drop not in line]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError) as caught:
        prepare(path, draw=None, particles=100, output=tmp_path / "out.usda")
    assert message in caught.value.message
    assert "</Hook>" in caught.value.message
    assert caught.value.hint


def test_a_point_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = stage(tmp_path)
    path.write_text(path.read_text().replace("indices0 = [0, 1, 4, 5]", "indices0 = [0, 1, 4, 8]"))
    with pytest.raises(gf_usd.InputError, match="range from 0 to 8, but </Cube> has 8 points"):
        prepare(path, draw=None, particles=100, output=tmp_path / "out.usda")


def test_an_attachment_of_omniverse_holds_as_the_proposals_does(tmp_path: Path) -> None:
    path = stage(tmp_path)
    text = path.read_text().replace("PhysicsAttachment", "OmniPhysicsVtxXformAttachment")
    for ours, theirs in (
        ("physics:src", "omniphysics:src"),
        ("physics:indices0", "omniphysics:vtxIndicesSrc0"),
        ("vector3f[] physics:coords1", "point3f[] omniphysics:localPositionsSrc1"),
    ):
        assert ours in text
        text = text.replace(ours, theirs)
    path.write_text("\n".join(x for x in text.splitlines() if "physics:type" not in x))
    options = {"particles": 100, "frames": 13, "output": tmp_path / "out.usda"}
    plan, _ = prepare(path, draw=None, **options)
    (pin,) = plan.pins
    rise = pin.path[:, :, 1] - pin.path[0, :, 1]
    np.testing.assert_allclose(rise, np.linspace(0.0, 2.0, 13)[:, None].repeat(4, 1), atol=1e-6)


def test_a_stage_without_attachments_has_none(tmp_path: Path) -> None:
    path = tmp_path / "block.usda"
    path.write_text(BLOCK)
    plan, _ = prepare(path, draw=None, particles=100, output=tmp_path / "out.usda")
    assert not plan.pins

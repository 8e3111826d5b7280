"""Several characters in one bake with --flesh: each is a body of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm import FIRST, LAST, WIDTH, arm, drawn, skinned
from pxr import Usd

import gf_usd
from gf_usd.physics.grid.goals import RATE, NodeGoals
from gf_usd.prepare.prepare import prepare

APART = 1.7  # [m] of arms of 2 m, which overlap by 0.3 m where they are straight
FEW = {"particles": 400, "preroll": 12, "flesh": True, "material": "rubber"}
PROP = """
    def Cube "Watch" {
        double size = 0.3
        double3 xformOp:translate = (0.5, 0.2, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""


def stage(
    folder: Path, prop: str = "", bend: tuple[float, float] = (60.0, 60.0), aside: float = 0.0
) -> Path:
    """Two arms, one behind the other, that overlap in the bind pose: /Shot/A/Skin and /Shot/B/Skin.

    A bends up before the first frame, where they are apart.  prop : of A; bend : of `arm`;
    aside : [m] of B from the line of A, in y and z.
    """
    (folder / "a.usda").write_text(arm(bend=bend), encoding="utf-8")
    (folder / "b.usda").write_text(arm(), encoding="utf-8")
    path = folder / "two.usda"
    path.write_text(
        f"""#usda 1.0
( metersPerUnit = 1
  upAxis = "Y"
  defaultPrim = "Shot"
  startTimeCode = {FIRST}
  endTimeCode = {LAST}
  timeCodesPerSecond = 24 )
def Xform "Shot"
{{
    def "A" ( references = @./a.usda@ ) {{ {prop} }}
    def "B" ( references = @./b.usda@ )
    {{
        double3 xformOp:translate = ({APART}, {aside}, {aside})
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
}}
""",
        encoding="utf-8",
    )
    return path


@pytest.mark.slow
def test_each_character_is_a_body_that_only_its_own_bones_hold(tmp_path: Path) -> None:
    options = {**FEW, "goal_frequency": 2.0, "output": tmp_path / "out.usda", "draw": None}
    plan, _ = prepare(stage(tmp_path, prop=PROP), **options)
    assert plan.bodies is not None
    assert plan.bodies.surfaces == (("/Shot/A/Skin", "/Shot/A/Watch"), ("/Shot/B/Skin",))
    assert [(pin.name.split(":")[0], pin.body) for pin in plan.pins] == [
        *[("/Shot/A/Skel", 0)] * 2, *[("/Shot/B/Skel", 1)] * 2,
    ]  # fmt: skip
    assert plan.contact_setup is not None
    assert plan.contact_setup.meet_from == 12 == plan.settings.first
    note = "2 characters, which collide, from the first frame of the animation on: </Shot/A/Skin>"
    assert note in " ".join(plan.notes)
    # a point that is in both goes where the skeleton of each takes it: A's is bent up by 60 degrees
    assert plan.goals is not None
    X = np.array([[1.85, 0.0, 0.0]] * 2)
    nodes = NodeGoals(plan.goals, X, dt=1e-4, body=np.array([0, 1]))
    one, other = nodes.between(plan.settings.first, 1.0).reshape(2, -1)[:, :RATE]
    np.testing.assert_allclose(
        X[0] + one, [1.0 + 0.85 * 0.5, 0.85 * np.sqrt(0.75), 0.0], atol=0.1 * WIDTH
    )
    np.testing.assert_allclose(X[1] + other, X[1], atol=1e-3)


@pytest.mark.slow
def test_skeletons_under_one_skelroot_are_one_character(tmp_path: Path) -> None:
    path = stage(tmp_path)
    text = path.read_text(encoding="utf-8").replace('def Xform "Shot"', 'def SkelRoot "Shot"')
    text = text.replace('def "A"', 'def Xform "A"').replace('def "B"', 'def Xform "B"')
    path.write_text(text, encoding="utf-8")
    plan, _ = prepare(path, **FEW, output=tmp_path / "out.usda", draw=None)
    assert plan.bodies is not None
    assert plan.bodies.count == 1
    note = "2 skeletons under the SkelRoot </Shot> are one character, and one body: </Shot/A/Skel>"
    assert note in " ".join(plan.notes)


@pytest.mark.slow
def test_combine_makes_one_body_of_all_characters(tmp_path: Path) -> None:
    options = {**FEW, "combine": True, "output": tmp_path / "out.usda", "draw": None}
    plan, _ = prepare(stage(tmp_path), **options)
    assert plan.bodies is not None
    assert plan.bodies.count == 1
    assert {pin.body for pin in plan.pins} == {None}


@pytest.mark.slow
@pytest.mark.acceptance
def test_characters_whose_bind_poses_overlap_follow_their_own_skeletons(tmp_path: Path) -> None:
    """As near to the skinned pose as a lone arm is: see `test_flesh_cli`."""
    out = tmp_path / "out.usda"
    result = gf_usd.bake(stage(tmp_path), output=out, progress=None, **FEW)
    assert not result.findings
    baked = Usd.Stage.Open(str(out))
    for name, shift in (("A", 0.0), ("B", APART)):
        source = tmp_path / f"{name.lower()}.usda"
        for code in (FIRST, LAST):
            wanted = skinned(source, code) + [shift, 0.0, 0.0]
            away = drawn(baked, code, f"/Shot/{name}/Skin") - wanted
            assert np.sqrt((away**2).sum(1).mean()) < 0.1 * WIDTH, (name, code)


@pytest.mark.slow
def test_what_overlaps_in_the_first_pose_is_not_pushed_apart(tmp_path: Path) -> None:
    """The hands of two dancers were inside each other and stayed entangled as they came apart."""
    out = tmp_path / "out.usda"
    result = gf_usd.bake(
        stage(tmp_path, bend=(0.0, 60.0), aside=0.1),
        output=out,
        progress=None,
        **{**FEW, "material": "jelly"},
    )
    note = "</Shot/A/Skin> and </Shot/B/Skin> overlap by up to 10 cm where contact begins, at time"
    assert f"{note} code {FIRST}: parts that" in " ".join(result.notes)
    baked = Usd.Stage.Open(str(out))
    away = drawn(baked, LAST, "/Shot/A/Skin") - skinned(tmp_path / "a.usda", LAST)
    # 0.09 m of jelly that hangs from its bones; 1.15 m, almost three widths, where it was held
    assert np.linalg.norm(away, axis=1).max() < 0.5 * WIDTH
    assert result.health["max_stretch"] < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("alone", [True, False], ids=["one character", "two"])
def test_a_prop_that_no_bones_hold_stays(tmp_path: Path, alone: bool) -> None:
    """A bench beside a character fell out of the picture, for flesh has no floor."""
    path = stage(tmp_path, prop=PROP.replace("0.5, 0.2, 0", "0.5, 3, 0"))
    seen = gf_usd.inspect(path, prims=["/Shot/A"] if alone else (), flesh=True, particles=400)
    assert seen.fill_of("/Shot/A/Watch")[0] == "stays"
    assert seen.plan is not None
    assert seen.plan.bodies is not None
    assert [paths[0] for paths in seen.plan.bodies.surfaces] == (
        ["/Shot/A/Skin"] if alone else ["/Shot/A/Skin", "/Shot/B/Skin"]
    )
    (note,) = (note for note in seen.notes if "/Shot/A/Watch" in note)
    assert note.startswith("</Shot/A/Watch> is not baked: no skeleton poses it, and it touches no")

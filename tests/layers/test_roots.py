"""Root prims in the root layer: those that meshes inherit from must not win over the bake."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd
from small_sources import Source
from small_stages import CUBE, bake, open_with, write

INHERITED = """
{kind} Xform "_wing" (
    inherits = </_base>
)
{{
    def Mesh "m"
    {{ {cube}
    }}
}}
class "_base"
{{
    over "m"
    {{
        bool doubleSided = 1
    }}
}}
class "_gaussianFleshSource"
{{
}}
class "_other"
{{
}}
def Xform "duck"
{{
    def Xform "left" (
        inherits = </_wing>
    )
    {{
    }}
    def Xform "right" (
        instanceable = true
        inherits = </_wing>
    )
    {{
    }}
}}
"""


@pytest.mark.parametrize("kind", ["class", "over"])
def test_a_bake_wins_over_an_inherited_shape(tmp_path: Path, kind: str) -> None:
    body = INHERITED.format(kind=kind, cube=CUBE)
    asset = Source(body, 'upAxis = "Y"\n metersPerUnit = 1\n defaultPrim = "duck"').asset(tmp_path)
    assert [s.path for s in asset.surfaces] == ["/duck/left/m", "/duck/right/m"]
    root, _, _ = bake(asset, tmp_path)
    stage = open_with(root.path, "rubber")
    for path in ("/duck/left/m", "/duck/right/m"):
        assert stage.GetAttributeAtPath(f"{path}.points").GetNumTimeSamples() == 5
        assert stage.GetAttributeAtPath(f"{path}.doubleSided").Get() is True
    stage = open_with(root.path, "none")
    assert stage.GetAttributeAtPath("/duck/left/m.points").GetNumTimeSamples() == 0
    assert stage.GetPrimAtPath("/duck/right").IsInstance()
    assert len(stage.GetAttributeAtPath("/_wing/m.points").Get()) == 8
    names = [prim.GetName() for prim in stage.GetPseudoRoot().GetAllChildren()]
    assert set(names) == {
        *("_wing", "_base", "_gaussianFleshSource", "_other", "duck"),
        "_gaussianFleshSource1",
    }


NESTED = f"""
class "_part"
{{
    def Mesh "m"
    {{ {CUBE}
    }}
}}
class "_pair"
{{
    def Xform "inner" (
        instanceable = true
        references = </_part>
    )
    {{
    }}
}}
def Xform "duck"
{{
    def Xform "outer" (
        instanceable = true
        inherits = </_pair>
    )
    {{
    }}
}}
"""


def test_an_instance_in_an_inherited_instance_moves(tmp_path: Path) -> None:
    asset = Source(NESTED, 'upAxis = "Y"\n metersPerUnit = 1\n defaultPrim = "duck"').asset(
        tmp_path
    )
    assert [s.path for s in asset.surfaces] == ["/duck/outer/inner/m"]
    root, _, _ = bake(asset, tmp_path)
    stage = open_with(root.path, "rubber")
    assert not stage.GetPrimAtPath("/duck/outer/inner").IsInstance()
    assert stage.GetAttributeAtPath("/duck/outer/inner/m.points").GetNumTimeSamples() == 5
    stage = open_with(root.path, "none")
    assert stage.GetPrimAtPath("/duck/outer").IsInstance()


def test_a_shot_can_still_say_something_of_the_class(tmp_path: Path) -> None:
    body = INHERITED.format(kind="class", cube=CUBE)
    root, _, _ = bake(Source(body).asset(tmp_path), tmp_path)
    shot = write(
        tmp_path / "shot.usda",
        f'class "_wing"\n{{\n over "m"\n {{\n token purpose = "render"\n }}\n}}\n'
        f'def "hero" (\n references = @./{root.path.name}@</duck>\n)\n{{\n}}\n',
    )
    stage = Usd.Stage.Open(str(shot))
    assert stage.GetAttributeAtPath("/hero/left/m.purpose").Get() == "render"
    assert stage.GetAttributeAtPath("/hero/left/m.points").GetNumTimeSamples() == 5


def test_without_inheritance_no_prim_is_added(tmp_path: Path) -> None:
    body = f'class "_wing"\n{{\n}}\ndef Mesh "m"\n{{ {CUBE}\n}}\n'
    root, _, _ = bake(Source(body).asset(tmp_path), tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    names = [prim.GetName() for prim in stage.GetPseudoRoot().GetAllChildren()]
    assert names == ["_wing", "m", "m_GaussianFlesh"]

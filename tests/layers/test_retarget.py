"""Relationships and connections that leave their root prim survive the reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdShade
from small_sources import BOUND, INSTANCES, PLAIN, SKINNED, Y_M, Source
from small_stages import CUBE, bake, write

VARIANTS = Source(
    f"""
def Xform "root" (
    inherits = </_class>
    prepend variantSets = "color"
    variants = {{
        string color = "red"
    }}
)
{{
    def Mesh "m" (
        {BOUND}
    )
    {{ {CUBE}
        rel mixed = [</root/m>, </_materials/red>, </root>]
        append rel added = </_materials/green>
        rel inside = </root>
    }}
    variantSet "color" = {{
        "red" {{
            over "m"
            {{
                rel material:binding = </_materials/red>
            }}
        }}
        "green" {{
            over "m"
            {{
                rel material:binding = </_materials/green>
            }}
        }}
    }}
}}
class "_class"
{{
    def Scope "prop" (
        prepend apiSchemas = ["CollectionAPI:lit"]
    )
    {{
        rel collection:lit:includes = </_materials>
    }}
}}
def Scope "_materials"
{{
    def Material "red"
    {{
    }}
    def Material "green"
    {{
    }}
}}
"""
)


def quiet(capfd: pytest.CaptureFixture[str]) -> str:
    """What USD printed on the terminal."""
    return capfd.readouterr().err


def test_bindings_and_connections_are_kept(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    root, _, _ = bake(PLAIN.asset(tmp_path), tmp_path)
    assert root.retargeted == 3
    stage = Usd.Stage.Open(str(root.path))
    for path, material in (("body", "red"), ("body/top", "green")):
        prim = stage.GetPrimAtPath(f"/duck/geo/{path}")
        bound, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        assert bound.GetPath() == f"/_materials/{material}"
    output = stage.GetAttributeAtPath("/_materials/red.outputs:surface")
    assert output.GetConnections() == [Sdf.Path("/_shaders/paint.outputs:surface")]
    assert quiet(capfd) == ""


def test_a_targets_strength_among_the_sources_variants_stays(tmp_path: Path) -> None:
    asset = VARIANTS.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    for color in ("red", "green"):
        theirs, ours = (Usd.Stage.Open(str(p)) for p in (asset.facts.path, root.path))
        for stage in (theirs, ours):
            stage.SetEditTarget(stage.GetSessionLayer())
            stage.GetPrimAtPath("/root").GetVariantSet("color").SetVariantSelection(color)
        for path in (
            "/root/m.material:binding",
            "/root/m.mixed",
            "/root/m.added",
            "/root/m.inside",
            "/root/prop.collection:lit:includes",
        ):
            expected = theirs.GetRelationshipAtPath(path).GetTargets()
            assert expected, path
            assert ours.GetRelationshipAtPath(path).GetTargets() == expected, (color, path)
    assert root.notes == ()


def test_a_local_target_still_beats_a_variants(tmp_path: Path) -> None:
    body = VARIANTS.body.replace(
        "rel inside = </root>", "rel inside = </root>\n        rel material:binding = </root/here>"
    )
    root, _, _ = bake(replace(VARIANTS, body=body).asset(tmp_path), tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    rel = stage.GetRelationshipAtPath("/root/m.material:binding")
    assert rel.GetTargets() == [Sdf.Path("/root/here")]


def test_edits_of_sublayers_are_one_list(tmp_path: Path) -> None:
    write(tmp_path / "base.usda", VARIANTS.body)
    body = 'over "root"\n{\n over "m"\n {\n prepend rel mixed = </_materials/green>\n }\n}'
    shot = Source(body, Y_M + "\n subLayers = [@./base.usda@]")
    asset = shot.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stages = [Usd.Stage.Open(str(p)) for p in (asset.facts.path, root.path)]
    targets = [stage.GetRelationshipAtPath("/root/m.mixed").GetTargets() for stage in stages]
    assert targets[0] == targets[1]
    assert targets[0][0] == "/_materials/green"
    assert len(targets[0]) == 4


def test_instances_end_where_their_targets_could_not_be_kept(tmp_path: Path) -> None:
    asset = INSTANCES.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    message = (
        "is no longer an instance: its relationships have targets outside its root prim, "
        "which only an ordinary prim can have"
    )
    assert root.notes == (f"</root/left> {message}", f"</root/right> {message}")
    stage = Usd.Stage.Open(str(root.path))
    for side in ("left", "right"):
        rel = stage.GetRelationshipAtPath(f"/root/{side}/seat.material:binding")
        assert rel.GetTargets() == [Sdf.Path("/_materials/red")]


def test_a_skeletons_targets_do_not_win_over_the_bake(tmp_path: Path) -> None:
    root, _, _ = bake(SKINNED.asset(tmp_path), tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    rel = stage.GetRelationshipAtPath("/root/figure/skin.skel:animationSource")
    assert rel.GetTargets() == []
    stage.GetPrimAtPath("/root").GetVariantSet("gaussianFlesh").SetVariantSelection("none")
    assert rel.GetTargets() == [Sdf.Path("/_anims/walk")]
    bones = stage.GetRelationshipAtPath("/root/figure/bones.skel:animationSource")
    assert bones.GetTargets() == [Sdf.Path("/_anims/walk")]

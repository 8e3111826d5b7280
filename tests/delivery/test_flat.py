"""Delivery of a bake in one flattened file: the bake's prims go, those of the source stay."""

from __future__ import annotations

from pathlib import Path

from pxr import Usd
from small_stages import CUBE, asset_of, bake, write

from gf_usd.core.frames.choices import Choices
from gf_usd.delivery.deliver import deliver
from gf_usd.layers.flatten import write_flat
from gf_usd.system.atomic_files import publish

DUCK = f"""
def Xform "Duck"
{{
    def Mesh "Body"
    {{ {CUBE} }}
    def Scope "GaussianFlesh"
    {{
        def Scope "Materials"
        {{
            def Material "Own" {{ }}
        }}
    }}
}}
"""


def test_a_prim_of_the_source_with_the_name_of_the_scope_is_kept(tmp_path: Path) -> None:
    theirs, ours = "/Duck/GaussianFlesh", "/Duck/GaussianFlesh_2"
    duck = write(tmp_path / "duck.usda", DUCK)
    asset = asset_of(duck)
    root, *_ = bake(asset, tmp_path)
    assert Usd.Stage.Open(str(root.path)).GetPrimAtPath(f"{ours}/Gaussians")
    one = tmp_path / "one.usdc"
    write_flat(one, root, asset, source=duck, choices=Choices())
    done = deliver(publish(one), tmp_path / "out.usda", error=0.02)
    assert [body.meshes for body in done.bodies] == [(asset.surfaces[0].path,)]
    stage = Usd.Stage.Open(str(done.path))
    assert stage.GetPrimAtPath(theirs)
    assert not stage.GetPrimAtPath(ours)

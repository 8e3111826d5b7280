"""The result of a bake as the asset of another: refused before it is filled, by inspect too."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

SMALL = ("--particles", "300", "--frames", "3")
REFUSAL = (
    "error: block.rubber.usda: </World> already has a variant set 'gaussianFlesh': "
    "this file is the result of a bake\n\nhint: bake the original asset, {}, instead\n"
)


@pytest.fixture
def baked(gf_usd, here: Path, block: Path) -> str:
    done = gf_usd("bake", block, *SMALL)
    assert done.status == 0, done.err
    return "block.rubber.usda"


def test_the_result_of_a_bake_is_refused_before_work(gf_usd, baked: str, block: Path) -> None:
    done = gf_usd("bake", baked, *SMALL)
    assert (done.status, done.out, done.err) == (3, "", REFUSAL.format(f"../{block.name}"))


def test_inspect_refuses_the_result_of_a_bake(gf_usd, baked: str, block: Path) -> None:
    done = gf_usd("inspect", baked, *SMALL)
    assert (done.status, done.out, done.err) == (3, "", REFUSAL.format(f"../{block.name}"))
    report = json.loads(gf_usd("inspect", baked, *SMALL, "--json").out)
    assert report["bakeable"] is False
    assert "is the result of a bake" in report["refusal"]["message"]


def test_the_cache_of_a_bake_is_refused_with_the_name_of_its_asset(
    gf_usd, baked: str, block: Path
) -> None:
    """The hint was to give it a mesh."""
    cache = Path(baked.replace(".usda", ".cache.usdc"))
    for command in ("bake", "inspect"):
        done = gf_usd(command, cache, *SMALL)
        assert (done.status, done.out) == (3, "")
        assert done.err.endswith(f"\n\nhint: bake the original asset, ../{block.name}, instead\n")
    Path(baked).unlink()
    done = gf_usd("bake", cache, *SMALL)
    assert done.err.endswith("\n\nhint: bake the original asset instead\n")


@pytest.mark.parametrize("name", ["block.usdz", "block.flat.usda"])
def test_one_file_of_a_bake_is_refused_with_the_name_of_its_asset(
    gf_usd, here: Path, block: Path, name: str
) -> None:
    """It has no variant set of a bake, and was baked.  It refers to no layer in another folder."""
    kind = () if name.endswith("usdz") else ("--flatten",)
    done = gf_usd("bake", block, *SMALL, *kind, "-o", name)
    assert done.status == 0, done.err
    for command in ("bake", "inspect"):
        done = gf_usd(command, name, *SMALL)
        assert (done.status, done.out) == (3, "")
        assert done.err == (
            f"error: {name}: this file is the result of a bake\n\n"
            f"hint: bake the original asset, {block.name}, instead\n"
        )


def test_a_bake_whose_meshes_are_hidden_is_refused_as_one(gf_usd, here: Path, block: Path) -> None:
    """The hint at the bake of what flows was to make its meshes visible."""
    layer = f"""#usda 1.0
(
    customLayerData = {{
        dictionary gaussianFlesh = {{
            string command = "gf-usd bake {block.name} -m water"
        }}
    }}
    subLayers = [@../{block.name}@]
)
over "World" (variants = {{ string gaussianFlesh = "water" }}
    prepend variantSets = "gaussianFlesh")
{{
    token visibility = "invisible"
    variantSet "gaussianFlesh" = {{ "water" {{}} }}
}}
"""
    (here / "block.rubber.usda").write_text(layer, encoding="utf-8")
    for command in ("bake", "inspect"):
        done = gf_usd(command, "block.rubber.usda", *SMALL)
        assert (done.status, done.out, done.err) == (3, "", REFUSAL.format(f"../{block.name}"))


@pytest.mark.parametrize(
    ("folder", "typed"), [("my assets", "'../my assets/block.usda'"), ("", "block.usda")]
)
def test_the_hint_at_the_original_has_its_folder(
    gf_usd, here: Path, block: Path, folder: str, typed: str
) -> None:
    """It was the name alone, wherever the asset was; the name is what the layer has."""
    at = here.parent / folder if folder else here
    at.mkdir(exist_ok=True)
    block.rename(at / block.name)
    asset = f"@../{folder}/{block.name}@" if folder else ""
    (here / "baked.usda").write_text(
        f"""#usda 1.0
(
    customLayerData = {{
        dictionary gaussianFlesh = {{
            string command = "gf-usd bake {block.name} -m jelly"
        }}
    }}
    subLayers = [{asset}]
)
def Xform "World" (variants = {{ string gaussianFlesh = "jelly" }}
    prepend variantSets = "gaussianFlesh")
{{
    def Mesh "Face"
    {{
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    }}
    variantSet "gaussianFlesh" = {{ "jelly" {{}} }}
}}
""",
        encoding="utf-8",
    )
    done = gf_usd("bake", "baked.usda", *SMALL)
    assert done.err.endswith(f"\n\nhint: bake the original asset, {typed}, instead\n")


def test_a_spacing_above_the_asset_is_refused_with_its_file(gf_usd, block: Path) -> None:
    done = gf_usd("bake", block, "--spacing", "900")
    assert done.status == 3
    assert done.err.startswith(f"error: {block}: only 0 particles fit at a spacing of 9 m")


def test_the_result_of_a_bake_can_be_an_obstacle(gf_usd, baked: str, block: Path) -> None:
    done = gf_usd("bake", block, *SMALL, "--collider", baked, "-o", "on.usda")
    assert done.status == 0, done.err

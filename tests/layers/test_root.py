"""The root layer replaces the asset, and its variants give it back."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdValidation
from small_sources import MOVING, PLAIN, SOURCES
from small_stages import ALL, bake, frames_of, info_of, open_with, write, write_cache

from gf_usd.core.errors import InputError
from gf_usd.layers.root import write_root
from gf_usd.layers.variants import BakedVariant

EVERYTHING = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)


# what the root layer adds on purpose
COMPOSITION = {"variantSetNames", "variantSelection", "references", "payload", "inheritPaths"}


SETS = {"gaussianFlesh", "display", "gaussianFleshDisplay"}


@pytest.fixture(params=SOURCES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def contents(stage: Usd.Stage) -> Iterator[tuple[str, object]]:
    """Everything a stage says: name of the thing, and its value."""
    for prim in Usd.PrimRange.Stage(stage, EVERYTHING):
        path = str(prim.GetPath())
        if path == "/blob_GaussianFlesh":
            continue  # an over without a definition, until the payload defines it
        yield path, (prim.GetTypeName(), prim.GetSpecifier(), prim.IsActive(), prim.IsInstance())
        yield f"{path} schemas", prim.GetAppliedSchemas()
        sets = prim.GetVariantSets()
        yield (
            f"{path} variants",
            {n: sets.GetVariantSelection(n) for n in sets.GetNames() if n not in SETS},
        )
        for key, value in prim.GetAllAuthoredMetadata().items():
            if key not in COMPOSITION:
                yield f"{path} {key}", value
        for attr in prim.GetAuthoredAttributes():
            where = str(attr.GetPath())
            yield where, (attr.GetTypeName(), attr.GetVariability(), attr.IsCustom())
            yield f"{where} default", attr.Get()
            yield f"{where} samples", [(t, attr.Get(t)) for t in attr.GetTimeSamples()]
            yield f"{where} connections", attr.GetConnections()
            yield f"{where} metadata", attr.GetAllAuthoredMetadata()
        for rel in prim.GetAuthoredRelationships():
            yield str(rel.GetPath()), (rel.GetTargets(), rel.IsCustom())


def test_none_is_the_source(name: str, tmp_path: Path) -> None:
    asset = SOURCES[name].asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    ours, theirs = open_with(root.path, "none"), Usd.Stage.Open(str(asset.facts.path))
    if name == "instances":
        # see test_retarget: relationships inside these instances can be kept no other way
        for stage in (ours, theirs):
            stage.SetEditTarget(stage.GetSessionLayer())
            for side in ("left", "right"):
                stage.GetPrimAtPath(f"/root/{side}").SetInstanceable(False)
    mine = dict(contents(ours))
    for where, value in contents(theirs):
        assert mine.pop(where) == value, where
    assert mine == {}


def test_the_layers_metadata_is_the_sources(tmp_path: Path) -> None:
    head = (
        PLAIN.head + '\n renderSettingsPrimPath = "/duck/render"'
        '\n customLayerData = {\n string by = "us"\n }\n framesPerSecond = 25'
        "\n timeCodesPerSecond = 50\n endTimeCode = 12"
    )
    asset = replace(PLAIN, head=head).asset(tmp_path)
    root, _, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    cache = Sdf.Layer.FindOrOpen(str(tmp_path / "duck.rubber.cache.usdc"))
    for layer in (stage.GetRootLayer(), cache):
        assert layer.timeCodesPerSecond == 50
        assert layer.framesPerSecond == info.settings.fps
        assert layer.defaultPrim == "duck"
        assert layer.startTimeCode == 10
        assert layer.endTimeCode == 14  # five frames from 10, past the source's 12
        root_prim = layer.pseudoRoot
        assert root_prim.GetInfo("metersPerUnit") == 1
        assert root_prim.GetInfo("upAxis") == "Y"
        assert root_prim.GetInfo("kilogramsPerUnit") == 0.5
    layer = stage.GetRootLayer()
    assert layer.pseudoRoot.GetInfo("renderSettingsPrimPath") == "/duck/render"
    assert layer.customLayerData["by"] == "us"
    ours = layer.customLayerData["gaussianFlesh"]
    assert ours["command"] == "gf-usd bake duck.usda"
    assert ours["version"] == "0.1.0"
    assert ours["inputHash"] == info.input_hash
    assert "colliders" not in ours
    assert ours["looks"]["rubber"]["health"] == {"minJ": 0.5}
    assert ours["looks"]["rubber"]["materials"]["0"]["youngs_modulus"] == 2e5


def test_files_of_obstacles_are_named_from_the_folder_of_the_layer(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    files = {tmp_path / "sets" / "wall.obj": "ab", tmp_path.parent / "floor.usda": "cd"}
    cache = tmp_path / "duck.rubber.cache.usdc"
    info = replace(write_cache(cache, asset)[2], colliders=files)
    baked = BakedVariant(name="rubber", cache=cache, info=info, health={})
    root = write_root(tmp_path / "root.usda", asset, [baked], choices=ALL)
    ours = Sdf.Layer.FindOrOpen(str(root.path)).customLayerData["gaussianFlesh"]
    assert list(ours["colliders"]) == ["./sets/wall.obj", "../floor.usda"]
    assert list(ours["colliderHashes"]) == ["ab", "cd"]


def test_usd_finds_no_fault(name: str, tmp_path: Path) -> None:
    asset = SOURCES[name].asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())

    def faults(stage: Usd.Stage) -> set[tuple[str, str]]:
        return {(e.GetName(), e.GetMessage()) for e in context.Validate(stage)}

    theirs = {n for n, _ in faults(Usd.Stage.Open(str(asset.facts.path)))}
    for variant in ("none", "rubber"):
        for display in ("mesh", "gaussians", "points"):
            stage = open_with(root.path, variant)
            for prim in stage.GetPseudoRoot().GetChildren():
                if prim.GetVariantSets().HasVariantSet(root.display_set):
                    prim.GetVariantSet(root.display_set).SetVariantSelection(display)
            # a fault of the hand-written source stays its own
            found = {(n, text) for n, text in faults(stage) if n not in theirs}
            assert found == set(), (variant, display)


def test_it_drops_into_a_shot(tmp_path: Path) -> None:
    for source, prim, mesh in ((MOVING, "root", "arm/m"), (PLAIN, "duck", "geo/body")):
        asset = source.asset(tmp_path, f"{prim}.usda")
        root, particles, info = bake(asset, tmp_path)
        shot = write(
            tmp_path / f"{prim}_shot.usda",
            f"""
def Xform "set"
{{
    double3 xformOp:translate = (5, 6, 7)
    float xformOp:rotateY = 90
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]
    def "hero" (
        references = @./{root.path.name}@
    )
    {{
    }}
}}
""",
            asset.facts.path.read_text().split("(")[1].split("\n)")[0],
        )
        stage = Usd.Stage.Open(str(shot))
        unit = asset.facts.units.length
        hero = stage.GetPrimAtPath("/set/hero")
        assert Usd.ModelAPI(hero).GetKind() == ("component" if source is PLAIN else "")
        for frame in frames_of(asset, particles, info):
            xforms = UsdGeom.XformCache(frame.time_code)
            # the shot turns (x, y, z) to (z, y, -x) and moves it
            for path, attribute, expected in (
                (mesh, "points", frame.meshes[f"/{prim}/{mesh}"].points),
                ("GaussianFlesh/Gaussians", "positions", frame.gaussians.positions),
                ("GaussianFlesh/Points", "points", frame.gaussians.positions),
            ):
                found = stage.GetPrimAtPath(f"/set/hero/{path}")
                matrix = np.array(xforms.GetLocalToWorldTransform(found))
                local = np.array(found.GetAttribute(attribute).Get(frame.time_code), np.float64)
                placed = expected[:, [2, 1, 0]] * (1, 1, -1) / unit + (5, 6, 7)
                np.testing.assert_allclose(
                    local @ matrix[:3, :3] + matrix[3, :3], placed, rtol=0, atol=2e-4
                )


def test_without_payloads_the_source_shows(tmp_path: Path) -> None:
    root, _, _ = bake(PLAIN.asset(tmp_path), tmp_path)
    stage = Usd.Stage.Open(str(root.path), Usd.Stage.LoadNone)
    assert stage.GetAttributeAtPath("/duck/geo/body.points").GetNumTimeSamples() == 0
    assert len(stage.GetAttributeAtPath("/duck/geo/body.points").Get()) == 8
    assert stage.GetAttributeAtPath("/duck.extentsHint").HasAuthoredValue()
    assert "GaussianFlesh" not in [p.GetName() for p in stage.Traverse()]


def test_references_are_relative_so_the_folder_can_move(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    (tmp_path / "out").mkdir()
    asset = PLAIN.asset(tmp_path / "assets")
    root, _, _ = bake(asset, tmp_path / "out")
    text = root.path.read_text()
    assert "@../assets/duck.usda@</duck>" in text
    assert "@./duck.rubber.cache.usdc@</duck>" in text
    assert str(tmp_path) not in text
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for folder in ("assets", "out"):
        shutil.move(tmp_path / folder, moved / folder)
    stage = Usd.Stage.Open(str(moved / "out" / root.path.name))
    assert stage.GetAttributeAtPath("/duck/geo/body.points").GetNumTimeSamples() == 5


def test_a_stage_with_sublayers_is_referenced_whole(tmp_path: Path) -> None:
    PLAIN.asset(tmp_path, "base.usda")
    shot = replace(
        PLAIN,
        body='over "duck"\n{\n over "geo"\n {\n over "body"\n {\n bool doubleSided = 1\n }\n }\n}',
        head=PLAIN.head + "\n subLayers = [@./base.usda@]",
    )
    root, _, _ = bake(shot.asset(tmp_path, "shot.usda"), tmp_path)
    assert "subLayers" not in root.path.read_text()
    stage = Usd.Stage.Open(str(root.path))
    assert stage.GetAttributeAtPath("/duck/geo/body.doubleSided").Get() is True
    assert stage.GetAttributeAtPath("/duck/geo/body.points").GetNumTimeSamples() == 5


READER = """
from pxr import Usd, UsdGeom, Plug
stage = Usd.Stage.Open({path!r})
assert Plug.Registry().GetPluginWithName("gaussianFlesh") is None
splats = stage.GetPrimAtPath("/duck/GaussianFlesh/Gaussians")
assert splats.IsA(UsdGeom.Gprim), splats.GetTypeName()
assert len(splats.GetAttribute("positions").Get(12)) == 40
assert len(splats.GetAttribute("gaussianFlesh:velocities").Get(12)) == 40
twin = UsdGeom.Points(stage.GetPrimAtPath("/duck/GaussianFlesh/Points"))
assert len(twin.GetIdsAttr().Get()) == 40
material = stage.GetPrimAtPath("/duck/GaussianFlesh/Materials/rubber")
assert "PhysicsMaterialAPI" in material.GetAppliedSchemas()
assert material.GetAttribute("physics:youngsModulus").Get() == 400000.0
print(stage.GetAttributeAtPath("/duck/geo/body.points").GetNumTimeSamples())
"""


def test_it_opens_without_our_schema(tmp_path: Path) -> None:
    root, _, _ = bake(PLAIN.asset(tmp_path), tmp_path)
    env = {k: v for k, v in os.environ.items() if k not in ("PXR_PLUGINPATH_NAME", "PYTHONPATH")}
    done = subprocess.run(
        [sys.executable, "-c", READER.format(path=str(root.path))],
        capture_output=True,
        text=True,
        env=env,
        cwd=tmp_path,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "5\n", "")


def test_a_bake_is_not_baked_again(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    again = replace(asset, facts=replace(asset.facts, path=root.path))
    with pytest.raises(InputError, match="already has a variant set 'gaussianFlesh'"):
        bake(again, tmp_path)


def test_a_new_bake_reaches_a_stage_that_is_open(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path, looks=("rubber",))
    stage = Usd.Stage.Open(str(root.path))
    look = BakedVariant(name="jelly", cache=tmp_path / "c.usdc", info=info_of(asset))
    write_root(root.path, asset, [look])
    assert stage.GetPrimAtPath("/duck").GetVariantSet("gaussianFlesh").GetVariantNames() == [
        "jelly",
        "none",
    ]

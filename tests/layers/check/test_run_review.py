"""The check that a bake ends with: what is wrong with the result and not with its source."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from pxr import Gf, Sdf, Usd
from small_bakes import SAMPLES
from small_sources import PLAIN, SEVERAL_ROOTS, Source
from small_stages import bake

import gf_usd
from gf_usd.core.frames.choices import Choices
from gf_usd.layers.check.run import check_file, review
from gf_usd.layers.flatten import write_flat
from gf_usd.system.atomic_files import publish

MESH = "/duck/geo/body"
STARS = """
def Points "stars"
{
    float3[] extent = [(0, 0, 0), (1, 1, 1)]
    float[] widths = [1, 1]
    point3f[] points = [(0, 0, 0), (1, 1, inf)]
}
"""


def prims(found: list[dict[str, str]]) -> set[tuple[str, str]]:
    """Rule and prim of each finding."""
    return {(f["rule"], f["prim"]) for f in found}


def spoil(cache: Path) -> None:
    """A point at infinity in one frame of a cache."""
    layer = Sdf.Layer.FindOrOpen(str(cache))
    path = f"{MESH}.points"
    time = layer.ListTimeSamplesForPath(path)[2]
    points = list(layer.QueryTimeSample(path, time))
    points[3] = Gf.Vec3f(float("inf"), 0.0, 0.0)
    layer.SetTimeSample(path, time, points)
    layer.Save()


@pytest.mark.parametrize("source", [PLAIN, SEVERAL_ROOTS], ids=["one root", "several roots"])
def test_a_sound_bake_has_no_findings(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    assert review(root.path, asset.facts.path) == []


def test_a_fault_of_the_bake_is_found_with_its_prim_and_fix(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    spoil(tmp_path / "duck.rubber.cache.usdc")
    found = review(root.path, asset.facts.path)
    assert ("finite", MESH) in prims(found)
    assert all(set(f) == {"rule", "prim", "message", "fix"} for f in found)
    assert all(f["message"] and f["fix"] for f in found)
    assert len(prims(found)) == len(found), "each fault is reported once"


def test_every_variant_is_looked_at(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path, looks=("rubber", "jelly"))
    stage = Usd.Stage.Open(str(root.path))
    selected = stage.GetPrimAtPath("/duck").GetVariantSet("gaussianFlesh")
    assert selected.GetVariantSelection() == "rubber"
    spoil(tmp_path / "duck.jelly.cache.usdc")
    assert ("finite", MESH) in prims(review(root.path, asset.facts.path))


def test_looking_changes_no_file(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path, looks=("rubber", "jelly"))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    review(root.path, asset.facts.path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert not Sdf.Layer.FindOrOpen(str(root.path)).dirty


def test_a_fault_of_the_source_is_not_the_bake_s(tmp_path: Path) -> None:
    asset = replace(PLAIN, body=PLAIN.body + STARS).asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    of_source = {(f.rule, f.prim_path) for f in check_file(asset.facts.path).findings}
    assert ("finite", "/stars") in of_source
    assert review(root.path, asset.facts.path) == []
    checked = check_file(root.path)
    assert checked.ok
    assert ("finite", "/stars") in {(f.rule, f.prim_path) for f in checked.inherited}
    assert {(f.rule, f.prim_path) for f in checked.inherited} <= of_source
    # of a shot over the bake only what is in the bake's prims can be the source's
    shot = tmp_path / "shot.usda"
    shot.write_text(
        '#usda 1.0\n( metersPerUnit = 1\n upAxis = "Y" )\n'
        f'def "duck" ( references = @{root.path.name}@</duck> ) {{}}\n{STARS}'
    )
    checked = check_file(shot)
    own = {(f.rule, f.prim_path) for f in checked.findings if f.severity == "error"}
    assert not checked.ok
    assert ("finite", "/stars") in own
    assert "/" in {path for _, path in own}  # it has no default prim
    assert all(f.prim_path.startswith("/duck") for f in checked.inherited)
    # and does not hide another one of the same kind elsewhere
    spoil(tmp_path / "duck.rubber.cache.usdc")
    found = prims(review(root.path, asset.facts.path))
    assert ("finite", MESH) in found
    assert ("finite", "/stars") not in found
    checked = check_file(root.path)
    assert not checked.ok
    assert ("finite", MESH) in {(f.rule, f.prim_path) for f in checked.findings}


def _extent(path: Path, prim: str, values: list[tuple[float, float, float]] | None) -> None:
    """Replace all samples of an extent; None: remove it."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    spec = layer.GetPrimAtPath(prim)
    if values is None:
        spec.RemoveProperty(spec.properties["extent"])
    else:
        for time in layer.ListTimeSamplesForPath(f"{prim}.extent"):
            layer.SetTimeSample(f"{prim}.extent", time, [Gf.Vec3f(*value) for value in values])
    layer.Save()


def test_a_warning_of_the_source_is_not_the_bake_s(tmp_path: Path) -> None:
    late = "double late.timeSamples = { 0: 1, 2000: 2 }\n    float3[] extentsHint"
    asset = replace(PLAIN, body=PLAIN.body.replace("float3[] extentsHint", late)).asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    assert stage.GetEndTimeCode() < 2000.0
    checked = check_file(root.path)
    assert checked.findings == ()
    assert ("warning", "time-range", "/duck") in {
        (f.severity, f.rule, f.prim_path) for f in checked.inherited
    }


def test_an_error_of_the_bake_is_not_hidden_by_a_warning_of_its_source(tmp_path: Path) -> None:
    """Without an extent the source has a warning; a wrong extent of the bake is an error."""
    asset = PLAIN.asset(tmp_path)
    _extent(asset.facts.path, MESH, None)
    source = {(f.severity, f.rule, f.prim_path) for f in check_file(asset.facts.path).findings}
    assert ("warning", "extent", MESH) in source
    root, _, _ = bake(asset, tmp_path)
    assert check_file(root.path).findings == ()
    _extent(tmp_path / "duck.rubber.cache.usdc", MESH, [(0, 0, 0), (1e-3, 1e-3, 1e-3)])
    assert ("extent", MESH) in prims(review(root.path, asset.facts.path))
    checked = check_file(root.path)
    errors = {(f.rule, f.prim_path) for f in checked.findings if f.severity == "error"}
    assert ("extent", MESH) in errors
    assert not checked.ok


def test_a_source_that_is_gone_is_an_error_of_the_bake(tmp_path: Path) -> None:
    """Without a source the variant that shows it has the same faults."""
    asset = PLAIN.asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    asset.facts.path.rename(tmp_path / "elsewhere.usda")
    checked = check_file(root.path)
    assert not checked.ok
    assert str(asset.facts.path) in " ".join(f.message for f in checked.findings)
    assert checked.inherited == ()


@pytest.mark.slow
def test_a_value_clip_that_is_gone_is_an_error_of_the_bake(tmp_path: Path) -> None:
    """The dependencies of a stage are those of all its variants."""
    root = tmp_path / "ball.usda"
    gf_usd.bake(SAMPLES / "sphere.usda", particles=200, frames=6, clip_frames=3, output=root)
    assert check_file(root).ok
    (tmp_path / "ball.clips" / "0002.usdc").unlink()
    result = check_file(root)
    assert not result.ok
    assert result.inherited == ()


@pytest.mark.slow
def test_a_file_that_only_another_variant_names_is_an_error_of_the_source(tmp_path: Path) -> None:
    """A bake as a package has no other variant, and lacks none of their files."""
    path = tmp_path / "ball.usda"
    path.write_text(OTHER_VARIANT, encoding="utf-8")
    (lost,) = check_file(path).findings
    assert lost.rule.endswith("UnresolvableDependency")
    assert "'gone.png'" in lost.message
    for name in ("layers.usda", "package.usdz"):
        done = gf_usd.bake(path, particles=100, frames=2, drop=2.0, output=tmp_path / name)
        assert not done.findings
        assert not check_file(done.root).findings


OTHER_VARIANT = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World" (
    variants = { string look = "bare" }
    prepend variantSets = "look"
)
{
    def Sphere "Ball"
    {
        float3[] extent = [(-1, -1, -1), (1, 1, 1)]
    }
    variantSet "look" = {
        "bare" {
        }
        "rich" {
            def Shader "Picture"
            {
                asset inputs:file = @gone.png@
            }
        }
    }
}
"""
PICTURE = """
def Shader "picture"
{
    asset inputs:file = @./lost.png@
}
"""


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_a_lost_file_of_the_source_hides_no_other(suffix: str, tmp_path: Path) -> None:
    """All that cannot be found is at the stage itself: the file tells them apart."""
    asset = replace(PLAIN, body=PLAIN.body + PICTURE).asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    path = root.path
    if suffix != ".usda":
        path = tmp_path / f"flat{suffix}"
        write_flat(path, root, asset, source=asset.facts.path, choices=Choices())
        publish(path)
    assert review(path, asset.facts.path) == []
    if suffix == ".usdz":
        return
    layer = Sdf.Layer.FindOrOpen(str(path))
    spec = Sdf.CreatePrimInLayer(layer, "/duck/also")
    spec.specifier, spec.typeName = Sdf.SpecifierDef, "Shader"
    Sdf.AttributeSpec(spec, "inputs:file", Sdf.ValueTypeNames.Asset).default = "./gone.png"
    layer.Save()
    (found,) = review(path, asset.facts.path)
    assert found["message"].endswith("gone.png'.")


def test_a_file_that_a_package_lost_is_told_from_one_of_the_source_by_its_folder(
    tmp_path: Path,
) -> None:
    """A package has the names alone of files that cannot be found."""
    other = PICTURE.replace("picture", "other").replace("./lost.png", "./kept/lost.png")
    asset = replace(PLAIN, body=PLAIN.body + PICTURE + other).asset(tmp_path)
    kept = tmp_path / "kept" / "lost.png"
    kept.parent.mkdir()
    kept.write_bytes(b"a picture")
    root, _, _ = bake(asset, tmp_path)
    for name, is_there in (("whole", True), ("less", False)):
        path = tmp_path / f"{name}.usdz"
        if not is_there:
            kept.unlink()
        write_flat(path, root, asset, source=asset.facts.path, choices=Choices())
        publish(path)
        kept.write_bytes(b"a picture")
        found = [one["message"] for one in review(path, asset.facts.path)]
        assert len(found) == (0 if is_there else 1)
        assert all(message.endswith("lost.png'.") for message in found)


def test_a_fault_of_another_property_is_the_bake_s(tmp_path: Path) -> None:
    """The source has colors that are not finite, which are not the points of the bake."""
    asset = replace(PLAIN, body=PLAIN.body.replace("[(1, 0, 0)]", "[(nan, 0, 0)]")).asset(tmp_path)
    known = {(f.rule, f.prim_path, f.subject) for f in check_file(asset.facts.path).findings}
    assert ("finite", MESH, "primvars:displayColor") in known
    root, _, _ = bake(asset, tmp_path)
    spoil(tmp_path / "duck.rubber.cache.usdc")
    found = [f for f in review(root.path, asset.facts.path) if f["rule"] == "finite"]
    assert [f["message"].split()[0] for f in found] == ["points"]


def test_a_file_of_a_longer_name_is_not_the_bake_s(tmp_path: Path) -> None:
    """The root layer lacks its sublayer `gone`; its source lacks `gone.usda.png`."""
    body = PLAIN.body + PICTURE.replace("lost.png", "gone.usda.png")
    asset = replace(PLAIN, body=body).asset(tmp_path)
    root, _, _ = bake(asset, tmp_path)
    layer = Sdf.Layer.FindOrOpen(str(root.path))
    layer.subLayerPaths.append("./gone.usda")
    layer.Save()
    checked = check_file(root.path)
    theirs, own = (
        [Path(f.subject).name for f in found if f.rule.endswith("UnresolvableDependency")]
        for found in (checked.inherited, checked.findings)
    )
    assert (theirs, own) == (["gone.usda.png"], ["gone.usda"])

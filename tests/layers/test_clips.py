"""Value clips say what one file says: every sample, every time between, every border."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, Vt
from small_sources import PLAIN, SOURCES, Source
from small_stages import (
    ALL,
    asset_of,
    bake,
    frames_of,
    info_of,
    open_with,
    particles_of,
    write_cache,
)

from gf_usd.core.asset import Asset
from gf_usd.core.frames.choices import CLIP, LARGE, Choices, clip_length
from gf_usd.layers.cache import CacheWriter
from gf_usd.layers.check.run import check_file
from gf_usd.layers.clips import clips_of, folder_of, remove_clips
from gf_usd.system.atomic_files import partial_path

FRAMES = 8
# A default in the cache hides the samples of value clips: that of what is no longer indexed stays.
OF_THE_SOURCE = ("primvars:normals",)


@pytest.fixture(params=SOURCES, scope="module")
def source(request: pytest.FixtureRequest) -> Source:
    return SOURCES[request.param]


@pytest.fixture(scope="module")
def whole(source: Source, tmp_path_factory: pytest.TempPathFactory) -> tuple[Asset, Path]:
    """A source and its bake in one file."""
    folder = tmp_path_factory.mktemp("whole")
    asset = source.asset(folder)
    return asset, bake(asset, folder, frames=FRAMES)[0].path


def both(asset, folder: Path, length: int, **options: object) -> tuple[Path, Path]:
    """Root layers of the same bake in one file and in clips."""
    roots = []
    for name, choices in (("one", ALL), ("clips", Choices(clip_frames=length))):
        where = folder / name
        where.mkdir()
        root, _, _ = bake(asset, where, choices=choices, frames=FRAMES, **options)
        roots.append(root.path)
    return roots[0], roots[1]


def same_values(one: Usd.Stage, clips: Usd.Stage, start: float, step: float = 1.0) -> int:
    """Compare every attribute at samples, between them, and outside; returns how many vary."""
    varying = 0
    codes = [start + k * step / 4.0 for k in range(-4, 4 * FRAMES + 4)]
    for prim in one.Traverse(Usd.TraverseInstanceProxies()):
        twin = clips.GetPrimAtPath(prim.GetPath())
        assert twin.GetTypeName() == prim.GetTypeName()
        assert twin.GetPropertyNames() == prim.GetPropertyNames()
        for attr in prim.GetAuthoredAttributes():
            other = twin.GetAttribute(attr.GetName())
            assert other.GetTypeName() == attr.GetTypeName()
            assert other.GetTimeSamples() == attr.GetTimeSamples(), attr.GetPath()
            assert other.ValueMightBeTimeVarying() == attr.ValueMightBeTimeVarying()
            if other.GetName() not in OF_THE_SOURCE:
                assert other.Get() == attr.Get()
            varying += attr.GetNumTimeSamples() > 1
            for code in codes:
                value, mine = attr.Get(code), other.Get(code)
                assert np.array_equal(np.array(value), np.array(mine)), (attr.GetPath(), code)
                near = attr.GetBracketingTimeSamples(code)
                assert other.GetBracketingTimeSamples(code) == near, (attr.GetPath(), code)
    return varying


@pytest.mark.parametrize("length", [1, 3, 7, 20])
def test_clips_say_what_one_file_says(
    whole: tuple[Asset, Path], length: int, tmp_path: Path
) -> None:
    asset, one = whole
    choices = Choices(clip_frames=length)
    clips = bake(asset, tmp_path, choices=choices, frames=FRAMES)[0].path
    start = info_of(asset).settings.start
    assert same_values(Usd.Stage.Open(str(one)), Usd.Stage.Open(str(clips)), start) > 10
    files = sorted(p.name for p in (tmp_path / "duck.rubber.clips").iterdir())
    count = -(-(FRAMES - 1) // length)
    assert files == [*(f"{k:04d}.usdc" for k in range(1, count + 1)), "manifest.usda"]


def test_what_is_constant_is_in_the_cache_and_what_varies_in_the_clips(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    _, root = both(asset, tmp_path, 3)
    cache = Sdf.Layer.FindOrOpen(str(root.with_name("duck.rubber.cache.usdc")))
    sites: list[Sdf.Path] = []
    cache.Traverse(Sdf.Path.absoluteRootPath, sites.append)
    specs = [cache.GetAttributeAtPath(site) for site in sites if site.IsPropertyPath()]
    assert not any(spec.HasInfo("timeSamples") for spec in specs if spec)
    folder = root.with_name("duck.rubber.clips")
    manifest = Sdf.Layer.FindOrOpen(str(folder / "manifest.usda"))
    clip = Sdf.Layer.FindOrOpen(str(folder / "0002.usdc"))
    declared, varying = [], []
    manifest.Traverse(Sdf.Path.absoluteRootPath, declared.append)
    clip.Traverse(Sdf.Path.absoluteRootPath, varying.append)
    properties = {site for site in varying if site.IsPropertyPath()}
    assert {site for site in declared if site.IsPropertyPath()} == properties
    for site in properties:
        assert not clip.GetAttributeAtPath(site).HasDefaultValue()
        # three frames, and the first of the next clip
        assert clip.ListTimeSamplesForPath(site) == [13.0, 14.0, 15.0, 16.0]
    assert (clip.startTimeCode, clip.endTimeCode) == (13.0, 16.0)


def test_a_shot_at_another_rate_sees_the_same(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    stages = []
    for root in both(asset, tmp_path, 3):
        shot = Sdf.Layer.CreateNew(str(root.with_name("shot.usda")))
        shot.timeCodesPerSecond = 48
        prim = Sdf.CreatePrimInLayer(shot, "/duck")
        prim.specifier = Sdf.SpecifierDef
        offset = Sdf.LayerOffset(7.0)
        prim.referenceList.prependedItems = [Sdf.Reference(f"./{root.name}", "/duck", offset)]
        shot.Save()
        stages.append(Usd.Stage.Open(shot))
    assert stages[0].GetAttributeAtPath("/duck/geo/body.points").GetTimeSamples()[0] == 27.0
    assert same_values(*stages, start=27.0, step=2.0) > 10


def test_a_source_that_has_clips_itself(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    stage = Usd.Stage.Open(str(asset.facts.path))
    points = stage.GetAttributeAtPath("/duck/geo/body.points")
    moved = np.array(points.Get()) + 1.0
    clip = Usd.Stage.CreateNew(str(tmp_path / "their.usda"))
    over = clip.OverridePrim("/duck/geo/body")
    theirs = over.CreateAttribute("points", Sdf.ValueTypeNames.Point3fArray, False)
    theirs.Set(points.Get(), 10.0)
    theirs.Set(Vt.Vec3fArray.FromNumpy(moved.astype(np.float32)), 12.0)
    clip.Save()
    api = Usd.ClipsAPI(stage.GetPrimAtPath("/duck"))
    api.SetClipAssetPaths([Sdf.AssetPath("./their.usda")])
    api.SetClipPrimPath("/duck")
    api.SetClipActive([(10.0, 0.0)])
    api.SetClipTimes([(10.0, 10.0), (30.0, 12.0)])
    # clips are weaker than what the layer with them says itself
    points.Clear()
    stage.Save()
    assert np.array_equal(np.array(points.Get(30.0)), moved)
    one, clips = both(asset_of(asset.facts.path), tmp_path, 3)
    assert same_values(Usd.Stage.Open(str(one)), Usd.Stage.Open(str(clips)), 10.0) > 10
    without = open_with(clips, "none")
    bare = without.GetAttributeAtPath("/duck/geo/body.points")
    assert np.array_equal(np.array(bare.Get(30.0)), moved)


def test_the_check_has_nothing_to_say(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    one, clips = both(asset, tmp_path, 3)
    found = [{(f.rule, f.prim_path) for f in check_file(root).findings} for root in (one, clips)]
    assert found[0] == found[1]


def test_a_full_clip_is_there_before_the_bake_is_done(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    info, particles = info_of(asset, frames=FRAMES), particles_of(asset)
    cache = tmp_path / "duck.rubber.cache.usdc"
    folder = folder_of(cache)
    seen = []
    with CacheWriter(cache, asset, particles, info, choices=Choices(clip_frames=2)) as writer:
        for frame in frames_of(asset, particles, info):
            writer.write(frame)
            seen.append(sorted(p.name for p in folder.iterdir() if "partial" not in p.name))
            if frame.index == 5:
                # what a kill at this time would leave
                stage = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(partial_path(cache))))
                clips = (
                    stage.GetRootLayer().GetPrimAtPath("/duck").GetInfo("clips")["gaussianFlesh"]
                )
                names = [Path(path.path).name for path in clips["assetPaths"]]
                assert names == ["0001.usdc", "0002.usdc"]
                assert stage.GetEndTimeCode() == 14.0
                del stage
    # a clip is full, and closed, with two frames and the first of the next
    assert [len(names) for names in seen] == [1, 1, 2, 2, 3, 3, 4, 4]
    assert not cache.exists()


def test_a_folder_that_is_there_is_not_written_to(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    cache = tmp_path / "duck.rubber.cache.usdc"
    choices = Choices(clip_frames=2)
    first, _, _ = write_cache(cache, asset, choices=choices)
    before = {path: path.read_bytes() for path in first.clips}
    second, _, _ = write_cache(cache, asset, choices=choices)
    assert {path.parent.name for path in second.clips} == {"duck.rubber.clips-2"}
    assert {path: path.read_bytes() for path in before} == before
    assert clips_of(cache) == tmp_path / "duck.rubber.clips-2"


def test_only_clips_are_removed(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    cache = tmp_path / "c.usdc"
    summary, _, _ = write_cache(cache, asset, choices=Choices(clip_frames=2))
    folder = clips_of(cache)
    assert summary.bytes == sum(p.stat().st_size for p in (cache, *summary.clips))
    (folder / "notes.txt").write_text("mine")
    for name in ("0009.partial.usdc", "0009.partial.LRS4IR", "manifest.partial.nmefTH"):
        (folder / name).write_bytes(b"left by a kill, the last two by one within USD")
    remove_clips(folder)
    assert [p.name for p in folder.iterdir()] == ["notes.txt"]
    (folder / "notes.txt").unlink()
    remove_clips(folder)
    assert not folder.exists()
    assert clips_of(tmp_path / "none.usdc") is None
    write_cache(tmp_path / "d.usdc", asset)
    assert clips_of(tmp_path / "d.usdc") is None


def test_the_length_of_clips() -> None:
    assert clip_length(None, 1e6, 100) == 0
    frame = 2.0 * LARGE / 1000
    assert clip_length(None, frame, 1000) == int(CLIP / frame)
    assert clip_length(0, frame, 1000) == 0
    assert clip_length(30, 1.0, 1000) == 30
    assert clip_length(None, 2.0 * LARGE, 2) == 1

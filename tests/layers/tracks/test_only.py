"""``--only``: the cache holds the shapes that were chosen, and the displays show no others."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd
from small_sources import SOURCES, Source
from small_stages import EPS, bake, frames_of, open_with, world
from visible_prims import visible

from gf_usd.core.asset import Asset
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.frame import BakeInfo
from gf_usd.core.frames.particles import Particles
from gf_usd.layers.check.run import check_file
from gf_usd.layers.root import RootSummary
from gf_usd.prepare.options.texts import parse_only

SUBSETS = [("mesh",), ("gaussians",), ("points",), ("mesh", "points"), ("gaussians", "points")]
DRAWN = {"gaussians": "Gaussians", "points": "Points"}


@pytest.fixture(params=SOURCES)
def source(request: pytest.FixtureRequest) -> Source:
    return SOURCES[request.param]


Baked = Callable[[Source, tuple[str, ...]], tuple[Asset, RootSummary, Particles, BakeInfo]]


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """Bakes a source with some shapes, (): all; once for all tests, which only read the files."""

    @cache
    def made(
        source: Source, shapes: tuple[str, ...]
    ) -> tuple[Asset, RootSummary, Particles, BakeInfo]:
        folder = tmp_path_factory.mktemp("baked")
        asset = source.asset(folder)
        choices = Choices(shapes=shapes) if shapes else Choices()
        root, particles, info = bake(asset, folder, choices=choices)
        return asset, root, particles, info

    return made


@pytest.mark.parametrize("shapes", SUBSETS, ids=",".join)
def test_what_was_chosen_is_there_and_nothing_else(
    shapes: tuple[str, ...], source: Source, baked: Baked
) -> None:
    asset, root, particles, info = baked(source, shapes)
    stage = Usd.Stage.Open(str(root.path))
    frame = list(frames_of(asset, particles, info))[-1]
    unit = asset.facts.units.length
    for path, pose in frame.meshes.items():
        if "mesh" in shapes:
            found = world(stage, path, "points", frame.time_code) * unit
            np.testing.assert_allclose(found, pose.points, rtol=0, atol=EPS * 100 * unit)
        else:
            velocities = stage.GetPrimAtPath(path).GetAttribute("velocities")
            assert not velocities.HasAuthoredValue()
    kinds = {"ParticleField3DGaussianSplat": "gaussians", "Points": "points"}
    there = {kinds[p.GetTypeName()] for p in stage.Traverse() if p.GetTypeName() in kinds}
    assert there == set(shapes) - {"mesh"}
    if "mesh" in shapes:
        assert visible(stage) >= set(frame.meshes)
    else:
        assert not visible(stage) & set(frame.meshes)


@pytest.mark.parametrize("shapes", SUBSETS, ids=",".join)
def test_each_shape_that_is_there_has_a_display(
    shapes: tuple[str, ...], source: Source, baked: Baked
) -> None:
    asset, root, _, _ = baked(source, shapes)
    stage = open_with(root.path, "rubber")
    meshes = {surface.path for surface in asset.surfaces}
    prims = [stage.GetPrimAtPath(path) for path in root.switches]
    for prim in prims:
        names = prim.GetVariantSet(root.display_set).GetVariantNames()
        assert set(names) == set(shapes)
    for shape in shapes:
        for prim in prims:
            prim.GetVariantSet(root.display_set).SetVariantSelection(shape)
        seen = visible(stage)
        assert (meshes <= seen) == (shape == "mesh")
        for name, drawn in DRAWN.items():
            assert any(path.endswith(f"/{drawn}") for path in seen) == (shape == name)


Faults = set[tuple[str, str]]  # rule and prim path


@pytest.fixture(scope="module")
def faults(baked: Baked) -> Callable[[Source], Faults]:
    """What the check finds in a source and in its bake with all shapes."""

    @cache
    def found(source: Source) -> Faults:
        asset, root, _, _ = baked(source, ())
        files = (asset.facts.path, root.path)
        return {(f.rule, f.prim_path) for file in files for f in check_file(file).findings}

    return found


@pytest.mark.parametrize("shapes", SUBSETS, ids=",".join)
def test_nothing_dangles(
    shapes: tuple[str, ...], source: Source, baked: Baked, faults: Callable[[Source], Faults]
) -> None:
    asset, root, _, _ = baked(source, shapes)
    known = faults(source)
    found = check_file(root.path).findings
    assert [f for f in found if f.severity == "error" and (f.rule, f.prim_path) not in known] == []
    without = open_with(root.path, "none")
    assert without.GetCompositionErrors() == []
    assert visible(without) == visible(Usd.Stage.Open(str(asset.facts.path)))
    assert open_with(root.path, "rubber").GetCompositionErrors() == []


def test_a_cache_of_less_is_smaller(tmp_path: Path) -> None:
    asset = SOURCES["plain"].asset(tmp_path)
    sizes = {}
    for shapes in (("mesh", "gaussians", "points"), ("gaussians",), ("mesh",)):
        folder = tmp_path / "-".join(shapes)
        folder.mkdir()
        bake(asset, folder, choices=Choices(shapes=shapes))
        sizes[shapes] = (folder / "duck.rubber.cache.usdc").stat().st_size
    assert sorted(sizes.values(), reverse=True) == list(sizes.values())


def test_the_words_of_only() -> None:
    assert Choices().shapes == ("mesh", "gaussians", "points")
    assert parse_only("points, mesh") == ("mesh", "points")
    with pytest.raises(UsageError, match="--only mesh,voxels: there is no 'voxels'"):
        parse_only("mesh,voxels")

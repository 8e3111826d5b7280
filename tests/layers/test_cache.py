"""Frames written into the cache come back through a freshly composed stage."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom
from small_sources import MOVING, PLAIN, SOURCES, Source
from small_stages import (
    EPS,
    bake,
    finish,
    frames_of,
    info_of,
    particles_of,
    world,
    write_cache,
)

from gf_usd.core.errors import BakeError, UsageError
from gf_usd.layers import cache
from gf_usd.layers.cache import CacheWriter
from gf_usd.layers.stage import save
from gf_usd.system.atomic_files import partial_path


@pytest.fixture(params=SOURCES)
def source(request: pytest.FixtureRequest) -> Source:
    return SOURCES[request.param]


def test_world_points_come_back(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    unit = asset.facts.units.length
    scope = next(
        p.GetPath() for p in stage.Traverse() if p.GetName() == "Gaussians"
    ).GetParentPath()
    for frame in frames_of(asset, particles, info):
        time = frame.time_code
        for path, pose in frame.meshes.items():
            found = world(stage, path, "points", time) * unit
            np.testing.assert_allclose(found, pose.points, rtol=0, atol=EPS * 100 * unit)
        for name, attribute in (("Gaussians", "positions"), ("Points", "points")):
            found = world(stage, f"{scope}/{name}", attribute, time) * unit
            np.testing.assert_allclose(
                found, frame.gaussians.positions, rtol=0, atol=EPS * 100 * unit
            )


def test_every_frame_is_a_sample_and_nothing_else(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    root, _, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    start = info.settings.start
    expected = [start + k for k in range(info.settings.frames)]
    for surface in asset.surfaces:
        prim = stage.GetPrimAtPath(surface.path)
        for name in ("points", "extent", "velocities"):
            assert prim.GetAttribute(name).GetTimeSamples() == expected, name


def test_extents_bound_what_is_drawn(source: Source, tmp_path: Path) -> None:
    asset = source.asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    for frame in frames_of(asset, particles, info):
        time = frame.time_code
        for path in frame.meshes:
            prim = stage.GetPrimAtPath(path)
            points = np.array(prim.GetAttribute("points").Get(time))
            extent = np.array(prim.GetAttribute("extent").Get(time))
            np.testing.assert_array_equal(extent, [points.min(axis=0), points.max(axis=0)])
        twin = next(p for p in stage.Traverse() if p.GetTypeName() == "Points")
        points = UsdGeom.Points(twin)
        computed = UsdGeom.Points.ComputeExtent(
            points.GetPointsAttr().Get(time), points.GetWidthsAttr().Get()
        )
        np.testing.assert_array_equal(points.GetExtentAttr().Get(time), computed)


def test_velocities_are_stage_units_per_second_in_local_space(tmp_path: Path) -> None:
    asset = SOURCES["several_roots"].asset(tmp_path)
    root, particles, info = bake(asset, tmp_path)
    stage = Usd.Stage.Open(str(root.path))
    frame = list(frames_of(asset, particles, info))[3]
    for path, pose in frame.meshes.items():
        found = stage.GetPrimAtPath(path).GetAttribute("velocities").Get(frame.time_code)
        np.testing.assert_allclose(np.array(found) * 0.01, pose.velocities, atol=1e-6)
    scope = "/one/GaussianFlesh"
    for path in (f"{scope}/Gaussians.gaussianFlesh:velocities", f"{scope}/Points.velocities"):
        found = stage.GetAttributeAtPath(path).Get(frame.time_code)
        np.testing.assert_allclose(np.array(found) * 0.01, frame.gaussians.velocities, atol=1e-6)


def test_another_rate_than_the_source_keeps_its_animation_in_step(tmp_path: Path) -> None:
    body, head = MOVING.body, MOVING.head.replace("timeCodesPerSecond = 24", "")
    asset = Source(body, head).asset(tmp_path)
    info = info_of(asset)
    fast = replace(info.settings, time_codes_per_second=60.0, fps=60.0, start=2.5)
    info = replace(info, settings=fast)
    particles = particles_of(asset)
    cache = tmp_path / "c.usdc"
    root = finish(cache, asset, particles, info)
    stage = Usd.Stage.Open(str(root.path))
    for frame in frames_of(asset, particles, info):
        found = world(stage, "/root/arm/m", "points", frame.time_code) * 0.01
        np.testing.assert_allclose(found, frame.meshes["/root/arm/m"].points, atol=EPS)


def test_wrong_frames_are_refused_in_words(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    info, particles = info_of(asset), particles_of(asset)
    first, second = list(frames_of(asset, particles, info))[:2]
    path = "/duck/geo/body"
    pose = first.meshes[path]
    short = replace(first, meshes={path: replace(pose, points=pose.points[:3])})
    lost = pose.points.copy()
    lost[2, 1] = np.nan
    astray = replace(first, meshes={path: replace(pose, points=lost)})
    few = replace(first, gaussians=replace(first.gaussians, scales=np.ones((3, 3))))
    cases = (
        (short, f"points of <{path}> at time code 10 have shape (3, 3), not (8, 3)"),
        (astray, f"points of <{path}> at time code 10 contain 1 numbers that are not finite"),
        (
            few,
            "scales of </duck/GaussianFlesh/Gaussians> at time code 10 have shape (3, 3), "
            "not (40, 3)",
        ),
        (replace(first, meshes={}), f"frame 0 has meshes none, but the asset has <{path}>"),
    )
    with CacheWriter(tmp_path / "c.usdc", asset, particles, info) as writer:
        for frame, message in cases:
            with pytest.raises(BakeError) as caught:
                writer.write(frame)
            assert caught.value.message == message
        writer.write(second)
        with pytest.raises(BakeError, match="frame 0 has time code 10, after 11"):
            writer.write(first)


def test_the_asset_is_never_written_to(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    before = asset.facts.path.read_bytes()
    with pytest.raises(UsageError, match="is the asset itself"):
        write_cache(asset.facts.path, asset)
    bake(asset, tmp_path)
    assert asset.facts.path.read_bytes() == before


def test_a_failure_leaves_the_frames_so_far_under_the_partial_name(tmp_path: Path) -> None:
    asset, particles, info, frames = PLAIN.scene(tmp_path)
    path = tmp_path / "c.usdc"

    def stop_after_two() -> None:
        with CacheWriter(path, asset, particles, info) as writer:
            writer.write(frames[0])
            writer.write(frames[1])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_after_two()
    assert not path.exists()
    stage = Usd.Stage.Open(str(partial_path(path)))
    assert stage.GetAttributeAtPath("/duck/geo/body.points").GetTimeSamples() == [10, 11]
    assert stage.GetEndTimeCode() == 11


def test_a_save_runs_in_parallel_to_the_next_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The writer is back while layers are saved, and touches them only when they are."""
    asset, particles, info, frames = PLAIN.scene(tmp_path)
    gate, saved = threading.Event(), []

    def slow(layer: Sdf.Layer) -> None:
        if threading.current_thread() is not threading.main_thread():
            assert gate.wait(10.0)
        times = layer.GetAttributeAtPath("/duck/geo/body.points")
        saved.append(times.GetNumTimeSamples() if times else 0)
        save(layer)

    monkeypatch.setattr(cache, "save", slow)
    path = tmp_path / "c.usdc"
    with CacheWriter(path, asset, particles, info, save_every=2) as writer:
        writer.write(frames[0])
        assert writer.unsaved == 1
        saved.clear()
        writer.write(frames[1])
        assert saved == []
        assert writer.unsaved == 2, "what is being saved is not on the disk"
        threading.Timer(0.1, gate.set).start()
        writer.write(frames[2])
        assert saved == [2], "the third frame waited for it"
        assert writer.unsaved == 1
    stage = Usd.Stage.Open(str(partial_path(path)))
    assert stage.GetAttributeAtPath("/duck/geo/body.points").GetTimeSamples() == [10, 11, 12]
    assert stage.GetEndTimeCode() == 12


def test_a_failed_save_is_reported_by_the_next_call_and_the_layer_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asset, particles, info, frames = PLAIN.scene(tmp_path)
    saved: list[str] = []

    def full(layer: Sdf.Layer) -> None:
        saved.append(layer.identifier)
        raise BakeError("the disk is full.", "free some space")

    writer = CacheWriter(tmp_path / "c.usdc", asset, particles, info, save_every=1)
    monkeypatch.setattr(cache, "save", full)
    writer.write(frames[0])
    for again in (partial(writer.write, frames[1]), writer.close, writer.close):
        with pytest.raises(BakeError, match="the disk is full"):
            again()
    assert len(saved) == 1
    writer.__exit__(BakeError, None, None)
    assert len(saved) == 1


def test_a_folder_that_cannot_be_is_named(tmp_path: Path) -> None:
    asset = PLAIN.asset(tmp_path)
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(BakeError, match=r"c\.partial\.usdc cannot be created") as caught:
        write_cache(tmp_path / "file" / "c.usdc", asset)
    assert str(tmp_path / "file") in caught.value.hint


ENDLESS = """
import sys
from dataclasses import replace
from pathlib import Path
sys.path.insert(0, {tests!r})
from small_sources import PLAIN
from small_stages import frames_of, info_of, particles_of
from gf_usd.layers.cache import CacheWriter
asset = PLAIN.asset(Path({folder!r}))
info = info_of(asset, frames=100000)
particles = particles_of(asset, 2000)
with CacheWriter(Path({folder!r}) / "c.usdc", asset, particles, info, save_every=1) as writer:
    for frame in frames_of(asset, particles, info):
        writer.write(frame)
        print(frame.index, flush=True)
        {then}
"""


def run_endless(folder: Path, then: str = "") -> subprocess.Popen[str]:
    code = ENDLESS.format(
        tests=str(Path(__file__).parents[1] / "helpers"), folder=str(folder), then=then
    )
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL")
def test_a_killed_writer_leaves_nothing_under_the_final_name(tmp_path: Path) -> None:
    for frames in (0, 3):
        process = run_endless(tmp_path)
        for _ in range(frames + 1):
            process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert not (tmp_path / "c.usdc").exists()
        assert partial_path(tmp_path / "c.usdc").exists()
    # and the next bake writes over what is left
    write_cache(tmp_path / "c.usdc", PLAIN.asset(tmp_path))
    assert (tmp_path / "c.usdc").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no file size limit")
def test_a_full_disk_is_an_error_in_words(tmp_path: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (300000, 300000))"
    process = run_endless(tmp_path, limit)
    _, errors = process.communicate(timeout=60)
    assert "c.partial.usdc could not be saved" in errors
    assert "hint: check the space left on the disk" in errors
    assert not (tmp_path / "c.usdc").exists()

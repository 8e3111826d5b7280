"""What a bake does where the machine fails it: disk, folder, input, device, patience."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pxr import Usd, UsdGeom

import gf_usd
from gf_usd.core.errors import BakeError, InputError, UsageError
from gf_usd.layers.check.run import check_file
from gf_usd.pipeline.cost import budget
from gf_usd.system import resources
from gf_usd.system.taichi_runtime import import_taichi

SAMPLE = Path(__file__).parents[2] / "samples" / "sphere.usda"
SIZE = 16_000_000  # [bytes] of the small disk
FEW = {"material": "rubber", "particles": 200, "drop": "0.1r"}


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of SIZE bytes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no mount to make a small disk with")
    if done.returncode != 0:
        pytest.skip("a small disk cannot be mounted: no right to")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


def fill_up(folder: Path, leave: int) -> Path:
    """Another program's file, which leaves so many bytes free."""
    other = folder / "other"
    with other.open("wb") as file:
        file.write(bytes(int(resources.free_disk(folder)) - leave))
    return other


def test_a_disk_that_is_too_small_is_refused_before_work(disk: Path) -> None:
    with pytest.raises(InputError) as caught:
        gf_usd.bake(SAMPLE, output=f"{disk}/", **FEW, frames=2000)
    assert f"MB in {disk}, where 16 MB are free" in caught.value.message
    assert "half=True" in caught.value.hint
    assert names(disk) == []


def test_a_small_bake_that_a_nearly_full_disk_cannot_take_is_refused_before_work(
    disk: Path,
) -> None:
    """What is kept free for the root layer and the report counts from the start."""
    other = fill_up(disk, 1_500_000)
    with pytest.raises(InputError) as caught:
        gf_usd.bake(SAMPLE, output=f"{disk}/", **FEW, frames=4)
    assert f"MB in {disk}, where 1.5 MB are free" in caught.value.message
    assert names(disk) == [other.name]


@pytest.mark.slow
@pytest.mark.parametrize("materials", [["rubber"], ["rubber", "jelly"]])
def test_a_disk_that_is_full_before_the_first_frame_is_an_error_without_files(
    disk: Path, materials: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program fills it between the start and the first frame of the last material."""
    options = {**FEW, "material": materials, "frames": 2}
    required = budget.ResourceGuard.require
    guards: list[object] = []

    def require(guard: budget.ResourceGuard, index: int, unsaved: int) -> None:
        if guard not in guards:
            guards.append(guard)
            if len(guards) == len(materials):
                fill_up(disk, 100_000)
        required(guard, index, unsaved)

    monkeypatch.setattr(budget.ResourceGuard, "require", require)
    with pytest.raises(BakeError) as caught:
        gf_usd.bake(SAMPLE, output=f"{disk}/", **options)
    assert f"{materials[-1]} failed at frame 0 (time code 1)" in caught.value.message
    # fewer than 100 kB are left
    assert re.search(rf"{re.escape(str(disk))} has [\d.]+ k?B left", caught.value.message)
    assert "free some space" in caught.value.hint
    if len(materials) == 1:
        assert "no frame was simulated before" in caught.value.message
        assert set(names(disk)) <= {"other"}
    else:  # what the first material has is kept
        assert "the frames before it are kept in" in caught.value.message
        there = names(disk)
        assert any("rubber.cache.partial" in name for name in there)
        assert not any("jelly.cache" in name for name in there)


@pytest.mark.slow
def test_a_disk_without_a_byte_for_the_report_leaves_the_frames_and_no_empty_files(
    disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = {**FEW, "material": ["rubber", "jelly"], "frames": 2}
    required = budget.ResourceGuard.require
    guards: list[object] = []

    def require(guard: budget.ResourceGuard, index: int, unsaved: int) -> None:
        if guard not in guards:
            guards.append(guard)
            if len(guards) == 2:
                fill_up(disk, 0)
        required(guard, index, unsaved)

    monkeypatch.setattr(budget.ResourceGuard, "require", require)
    with pytest.raises(BakeError) as caught:
        gf_usd.bake(SAMPLE, output=f"{disk}/", **options)
    assert "jelly failed at frame 0 (time code 1)" in caught.value.message
    assert "there is no report: " in caught.value.message
    assert "sphere.rubber-jelly.report.partial.json could not be written" in caught.value.message
    assert "sphere.rubber-jelly.rubber.cache.partial.usdc" in names(disk)
    # the root layer may find room in pages that the second cache gave back
    assert all(path.stat().st_size > 0 for path in disk.iterdir())
    assert not list(disk.glob("*.report*"))


def test_a_memory_that_is_too_small_is_refused_before_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(budget, "free_memory", lambda: 1e6)
    monkeypatch.setattr(budget, "free_swap", lambda: 0.0)
    with pytest.raises(InputError) as caught:
        gf_usd.bake(SAMPLE, output=f"{tmp_path}/", **FEW, frames=4)
    assert "MB of memory, and 1 MB are free" in caught.value.message
    assert names(tmp_path) == []


@pytest.mark.slow
def test_a_disk_that_others_fill_ends_the_bake_at_its_last_frame(disk: Path) -> None:
    """The frames, a layer that opens them and a report are there; --resume ends what was begun."""
    options = {**FEW, "frames": 12, "clip_frames": 2}
    other: list[Path] = []

    def others(done: int, total: int) -> None:
        if done == 7:
            other.append(fill_up(disk, 1_000_000))

    with pytest.raises(BakeError) as caught:
        gf_usd.bake(SAMPLE, output=f"{disk}/", **options, progress=others)
    assert f"{disk} has " in caught.value.message
    assert "the same command with resume=True to continue" in caught.value.hint
    there = names(disk)
    assert not {"sphere.rubber.usda", "sphere.rubber.cache.usdc"} & set(there)
    assert {"sphere.rubber.checkpoint.npz", "sphere.rubber.report.json"} <= set(there)
    stage = Usd.Stage.Open(str(disk / "sphere.rubber.partial.usda"))
    body = UsdGeom.Mesh(stage.GetPrimAtPath("/Sphere/Geom/Body"))
    assert body.GetPointsAttr().GetNumTimeSamples() == 7
    del stage, body
    other[0].unlink()
    result = gf_usd.bake(SAMPLE, output=f"{disk}/", **options, resume=True)
    assert result.frames == 12
    assert check_file(result.root).ok


@pytest.mark.slow
def test_want_of_memory_ends_the_bake_at_its_last_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(budget, "MEMORY_INTERVAL", 0.0)

    def others(done: int, total: int) -> None:
        if done == 3:
            monkeypatch.setattr(budget, "free_memory", lambda: 1e6)
            monkeypatch.setattr(budget, "free_swap", lambda: 0.0)

    with pytest.raises(BakeError) as caught:
        gf_usd.bake(SAMPLE, output=f"{tmp_path}/", **FEW, frames=6, progress=others)
    assert "1 MB of memory are left on this machine" in caught.value.message
    assert "sphere.rubber.usda" not in names(tmp_path)
    assert "sphere.rubber.cache.partial.usdc" in names(tmp_path)


# The disk says that it has room, and has none: what a quota does.
LYING = """
import sys
from gf_usd.pipeline.cost import budget
budget.free_disk = lambda folder: 1e12
{more}
from gf_usd.cli.main import run
sys.argv = ["gf-usd", "bake", {asset!r}, "-o", {out!r}, "--particles", "200", "--frames", "200",
            "--drop", "0.1r", "-q"]
run()
"""


def start(asset: Path, out: Path, more: str = "") -> subprocess.Popen[str]:
    code = LYING.format(asset=str(asset), out=f"{out}/", more=more)
    return subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
@pytest.mark.acceptance
@pytest.mark.skipif(os.name == "nt", reason="no file size limit")
def test_a_disk_that_is_full_without_warning(tmp_path: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000000, 1000000))"
    process = start(SAMPLE, tmp_path, limit)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1, errors
    assert "sphere.rubber.cache.partial.usdc could not be saved" in errors
    assert "hint: check the space left on the disk" in errors
    assert names(tmp_path) == ["sphere.rubber.cache.partial.usdc"]


@pytest.mark.slow
def test_a_disk_that_is_full_without_warning_and_truly(disk: Path) -> None:
    other = fill_up(disk, 1_000_000)
    process = start(SAMPLE, disk)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1, errors
    assert "could not be saved" in errors
    assert names(disk) == [other.name, "sphere.rubber.cache.partial.usdc"]


def test_a_folder_that_is_read_only(disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    with pytest.raises(UsageError) as caught:
        gf_usd.bake(SAMPLE, output=f"{disk}/", **FEW, frames=4)
    assert f"{disk} cannot be written to: Read-only file system" in caught.value.message
    assert "choose another folder" in caught.value.hint


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no /proc")
def test_a_folder_that_nobody_may_write_to() -> None:
    """Not even root."""
    with pytest.raises(UsageError) as caught:
        gf_usd.bake(SAMPLE, output="/proc/", **FEW, frames=4)
    assert "/proc cannot be written to" in caught.value.message


def test_an_input_that_vanishes_during_the_bake(tmp_path: Path) -> None:
    asset = tmp_path / "in" / "ball.usda"
    asset.parent.mkdir()
    asset.write_bytes(SAMPLE.read_bytes())

    def others(done: int, total: int) -> None:
        if done == 2:
            asset.unlink()

    with pytest.raises(BakeError) as caught:
        gf_usd.bake(asset, output=f"{tmp_path}/", **FEW, frames=4, progress=others)
    assert f"{asset} cannot be read any more: No such file" in caught.value.message
    assert "put it back" in caught.value.hint
    assert all(".partial." in name for name in names(tmp_path)), names(tmp_path)


@pytest.mark.slow
def test_a_device_that_is_not_there(tmp_path: Path) -> None:
    ti = import_taichi()
    if ti.lang.misc.is_arch_supported(ti.cuda):
        pytest.skip("there is a CUDA device")
    arguments = ["bake", str(SAMPLE), "--device", "cuda", "-o", f"{tmp_path}/"]
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    errors = done.stderr.removeprefix("reading sphere.usda\n")  # of a machine that is slow to start
    assert errors.startswith("error: no CUDA device was found\n\nhint: use --device cpu")
    assert names(tmp_path) == []


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_second_interrupt_ends_what_the_first_waits_for(tmp_path: Path) -> None:
    """A save that never comes back stands for a network disk that does not answer."""
    hang = (
        "import time; from gf_usd.layers import cache\n"
        "first = cache.save\n"
        "def save(layer):\n"
        "    cache.save = lambda layer: time.sleep(600)\n"
        "    return first(layer)\n"
        "cache.save = save\n"
    )
    process = start(SAMPLE, tmp_path, hang)
    try:
        deadline = time.monotonic() + 60.0
        while "sphere.rubber.cache.partial.usdc" not in names(tmp_path):
            assert process.poll() is None
            assert time.monotonic() < deadline, "the bake never began to write"
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line == "interrupted; only *.partial.* files remain\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == -signal.SIGINT
    finally:
        process.kill()
    assert [n for n in names(tmp_path) if ".lock" not in n] == ["sphere.rubber.cache.partial.usdc"]

"""Two bakes of one output at once: the second is refused, and nothing of the first is touched."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from captures import ball, write_ply
from resumed import require_whole, start, wait_for
from small_bakes import names

from gf_usd.core.errors import UsageError
from gf_usd.pipeline.prepared import prepare
from gf_usd.pipeline.run.run import run
from gf_usd.system.file_locks import acquire, lock_path

pytestmark = pytest.mark.skipif(os.name == "nt", reason="no file locks")
STEM = "block.rubber"
CUBE = """v 0 0 0\nv {0} 0 0\nv {0} 1 0\nv 0 1 0\nv 0 0 1\nv {0} 0 1\nv {0} 1 1\nv 0 1 1
f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8
"""
LONG = ("--particles", "200", "--frames", "100000", "--drop", "150", "--max-hours", "1000",
        "--clip-frames", "1", "-q")  # fmt: skip


def test_a_second_bake_is_refused_until_the_first_is_gone(gf_usd, here: Path, block: Path) -> None:
    first = start("bake", block, *LONG)
    arguments = ("bake", block, "--particles", "200", "--frames", "2", "-q", "--overwrite")
    try:
        wait_for(first, here / f"{STEM}.checkpoint.npz")
        second = gf_usd(*arguments)
        assert second.status == 2
        assert f"another bake is writing {STEM}.usda" in second.err
        assert "hint: wait until it is done, or choose another -o" in second.err
        assert first.poll() is None
        assert (here / f"{STEM}.checkpoint.npz").exists()
    finally:
        first.kill()
        first.communicate(timeout=60)
    require_whole(here)
    # the file of a lock whose process was killed blocks nothing, and is removed with the next one
    assert lock_path(here / f"{STEM}.usda").exists()
    assert gf_usd(*arguments).status == 0
    assert names(here) == [f"{STEM}.{end}" for end in ("cache.usdc", "report.json", "usda")]


def test_a_result_that_came_after_the_look_is_not_replaced(here: Path, block: Path) -> None:
    options = {"particles": 200, "frames": 2}
    plan, other = prepare(block, **options), prepare(block, **options)
    run(other)
    before = (here / f"{STEM}.usda").read_bytes()
    with pytest.raises(UsageError, match=r"another bake wrote .* while this one was prepared"):
        run(plan)
    assert (here / f"{STEM}.usda").read_bytes() == before
    assert not lock_path(here / f"{STEM}.usda").exists()


@pytest.mark.slow
def test_frames_of_one_name_have_one_writer(gf_usd, here: Path, tmp_path: Path) -> None:
    path = write_ply(tmp_path / "ball.ply", ball(300, degree=0))
    held = acquire(here / "all" / "ball.rubber.ply")
    assert held is not None
    arguments = ("bake", path, "--particles", "200", "--frames", "2", "-q", "--export-ply", "all")
    refused = gf_usd(*arguments)
    assert refused.status == 2
    assert "another bake is writing all/ball.rubber.ply" in refused.err
    assert "give another folder for the frames" in refused.err
    held.release(remove=True)
    assert gf_usd(*arguments).status == 0
    assert names(here / "all") == ["ball.rubber.0001.ply", "ball.rubber.0002.ply"]


@pytest.fixture
def cubes(tmp_path: Path) -> tuple[Path, Path]:
    """Two mesh files of one name."""
    made = []
    for folder, width in (("one", 1), ("other", 2)):
        path = tmp_path / folder / "cube.obj"
        path.parent.mkdir()
        path.write_text(CUBE.format(width), encoding="utf-8")
        made.append(path)
    return made[0], made[1]


def test_two_mesh_files_of_one_name_do_not_share_a_layer(
    here: Path, cubes: tuple[Path, Path]
) -> None:
    options = {"particles": 200, "frames": 2}
    one, same, other = (
        prepare(path, output=f"{stem}.usda", **options)
        for path, stem in zip((cubes[0], cubes[0], cubes[1]), ("one", "same", "other"))
    )
    run(one)
    layer = here / "cube.source.usdc"
    before = layer.read_bytes()
    with pytest.raises(UsageError, match=r"wrote cube\.source\.usdc from another file") as refused:
        run(other)
    assert "its own folder" in refused.value.hint
    assert layer.read_bytes() == before
    assert [name for name in names(here) if "other" in name or "lock" in name] == []
    # of the same file it may be, and is used again
    run(same)
    assert layer.read_bytes() == before
    # a second process is refused before anything is prepared
    with pytest.raises(UsageError, match="was made from another file or with other options"):
        prepare(cubes[1], output="other.usda", **options)

"""A bake that ends early resumes from its last full clip, and comes to the same bits."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from arm import arm, swinging, write
from captures import ball, write_ply
from resumed import require_same, require_whole, samples, start, wait_for
from small_bakes import names

STEM = "block.rubber"
KEPT = f"{STEM}.checkpoint.npz"
# it meets the floor in the second frame, so that what it resumes from is strained
SMALL = ("--particles", "200", "--frames", "9", "--drop", "0.05r", "--clip-frames", "2")
STATES = {
    "as it is": (),
    "half": ("--half", "--samples-per-frame", "2", "--stress"),
    "adaptive": (
        "--precision",
        "5%",
        "--adaptive-samples",
        "--no-velocities",
        "--time-scale",
        ".1",
    ),
    "looks": ("-m", "rubber,jelly"),
    "updated": ("--solver", "ul"),
    "paper": ("--preset", "paper"),
    "held": ("--pin", "box:-20,-20,225,20,20,240", "--handles", "1"),
    "range": ("--range", "104:"),
}


LONGER = {
    "half",
    "held",
    "range",
    "looks",
    "paper",
    "updated",
    "adaptive",
}  # share their code with the others


@pytest.mark.slow
@pytest.mark.parametrize(
    "state", [pytest.param(s, marks=[pytest.mark.slow] if s in LONGER else []) for s in STATES]
)
def test_slices_come_to_the_same_bits(gf_usd, here: Path, block: Path, state: str) -> None:
    arguments = ("bake", block, *SMALL, *STATES[state], "-q")
    assert gf_usd(*arguments, "-o", "one/").status == 0
    runs = 1
    first = gf_usd(*arguments, "-o", "two/", "--slice", "1")
    assert first.status == 5
    assert "the slice of 1 clip ends here; two/block." in first.err
    assert "hint: the same command with --resume continues" in first.err
    while gf_usd(*arguments, "-o", "two/", "--slice", "1", "--resume").status == 5:
        require_whole(here / "two")
        runs += 1
    # nine frames of two a clip; a range begins three frames later, variants come one after another
    assert runs == {"range": 2, "looks": 7, "held": 4}.get(state, 3)
    require_same(here / "one", here / "two")


TWO = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{
    def Cube "Low" {
        double size = 0.2
        double3 xformOp:translate = (0, 0.1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Cube "High" {
        double size = 0.2
        double3 xformOp:translate = (0.03, 0.32, 0.02)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""


@pytest.mark.slow
def test_bodies_in_contact_continue_identically(gf_usd, here: Path, tmp_path: Path) -> None:
    scene = tmp_path / "two.usda"
    scene.write_text(TWO, encoding="utf-8")
    arguments = (
        "bake", scene, "--particles", "400", "--frames", "9", "--drop", "0", "-q",
        "-m", "jelly", "--clip-frames", "3",
    )  # fmt: skip
    assert gf_usd(*arguments, "-o", "one/").status == 0
    assert gf_usd(*arguments, "-o", "two/", "--slice", "2").status == 5
    found = samples(here / "two/two.jelly.clips/0002.usdc")
    planes = [
        np.frombuffer(value[2], value[0])[0]
        for key, value in found.items()
        if key[0].endswith("health:injectedEnergy")
    ]
    assert any(planes)  # they push each other before the state is kept
    assert gf_usd(*arguments, "-o", "two/", "--resume").status == 0
    require_same(here / "one", here / "two")


@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize(
    ("kills", "frames"),
    [
        pytest.param(1, 16, marks=pytest.mark.slow),
        pytest.param(20, 61, marks=pytest.mark.acceptance),
    ],
)
def test_killed_at_any_moment_it_leaves_whole_files_and_continues(
    gf_usd, here: Path, block: Path, kills: int, frames: int
) -> None:
    arguments = (
        "bake", block, "--particles", "200", "--frames", frames, "--drop", "0.05r",
        "--clip-frames", "1", "-q",
    )  # fmt: skip
    assert gf_usd(*arguments, "-o", "one/").status == 0
    moments = np.random.default_rng(5).integers(1, frames - 11, kills)
    reached = 0
    for moment in sorted(int(m) for m in moments):
        process = start(*arguments, "-o", "two/", "--resume")
        try:
            if moment > reached:
                wait_for(process, here / f"two/{STEM}.clips/{moment:04d}.usdc")
        finally:
            process.kill()
            process.communicate(timeout=60)
        require_whole(here / "two")
        reached = max(reached, moment)
        assert not (here / f"two/{STEM}.usda").exists()
    assert gf_usd(*arguments, "-o", "two/", "--resume").status == 0
    require_same(here / "one", here / "two")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_signal_says_how_to_resume(gf_usd, here: Path, block: Path) -> None:
    arguments = (
        "bake", block, "--particles", "200", "--frames", "100000", "--drop", "150",
        "--max-hours", "1000", "--clip-frames", "1", "-q",
    )  # fmt: skip
    process = start(*arguments)
    try:
        wait_for(process, here / KEPT)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 143
    assert err == (
        f"terminated; {KEPT} and the full clips are kept: the same command with --resume"
        " continues\n"
    )
    require_whole(here)


@pytest.mark.slow
def test_what_is_not_the_same_bake_is_refused(gf_usd, here: Path, block: Path) -> None:
    arguments = ("bake", block, *SMALL, "-q")
    assert gf_usd(*arguments, "--slice", "1").status == 5
    before = (here / KEPT).read_bytes()
    other = gf_usd(*arguments, "--resume", "--friction", "0.1")
    assert other.status == 2
    assert f"{KEPT} is of another bake: its options differed" in other.err
    block.write_text(block.read_text() + "\n", encoding="utf-8")
    assert "its asset differed" in gf_usd(*arguments, "--resume").err
    assert (here / KEPT).read_bytes() == before
    assert gf_usd(*arguments, "--resume", "--overwrite").status == 0
    assert KEPT not in names(here)
    report = (here / f"{STEM}.report.json").read_text()
    assert "its asset differed; with --overwrite the bake starts over" in report


WALL = "v {x} 0 -50\nv {x} 0 50\nv {x} 300 0\nv -90 0 0\nf 1 2 3\nf 2 1 4\nf 3 2 4\nf 1 3 4\n"


@pytest.mark.slow
def test_an_obstacle_that_has_changed_is_refused(gf_usd, here: Path, block: Path) -> None:
    wall = here / "wall.obj"
    wall.write_text(WALL.format(x=-60), encoding="utf-8")
    arguments = ("bake", block, *SMALL, "--collider", "wall.obj", "-q")
    assert gf_usd(*arguments, "--slice", "1").status == 5
    wall.write_text("# the same shape\n" + WALL.format(x=-60), encoding="utf-8")
    assert gf_usd(*arguments, "--slice", "1", "--resume").status == 5
    wall.write_text(WALL.format(x=-59), encoding="utf-8")
    other = gf_usd(*arguments, "--resume")
    assert other.status == 2
    assert f"{KEPT} is of another bake: its obstacles differed" in other.err
    assert "with unchanged files" in other.err


@pytest.mark.slow
def test_what_usd_was_writing_when_it_was_killed_is_removed(
    gf_usd, here: Path, block: Path
) -> None:
    """Found by a kill in the middle of a clip: USD saves to a name of its own, and renames it."""
    arguments = ("bake", block, *SMALL, "-q")
    assert gf_usd(*arguments, "--slice", "2").status == 5
    clips = here / f"{STEM}.clips"
    (clips / "0003.partial.aK0Gvf").write_bytes(b"half a clip")
    (clips / "notes.partial.txt").write_text("not ours")
    assert gf_usd(*arguments, "--resume").status == 0
    assert names(clips) == [
        *(f"{k:04d}.usdc" for k in (1, 2, 3, 4)),
        "manifest.usda",
        "notes.partial.txt",
    ]


@pytest.mark.slow
def test_a_checkpoint_without_its_clips_is_refused(gf_usd, here: Path, block: Path) -> None:
    arguments = ("bake", block, *SMALL, "-q")
    assert gf_usd(*arguments, "--slice", "2").status == 5
    (here / f"{STEM}.clips" / "0001.usdc").unlink()
    again = gf_usd(*arguments, "--resume")
    assert again.status == 2
    assert f"{STEM}.clips/0001.usdc is missing" in again.err
    (here / KEPT).write_bytes(b"no checkpoint")
    assert (
        f"{KEPT} is not a checkpoint that this program can read"
        in gf_usd(*arguments, "--resume").err
    )
    assert gf_usd(*arguments).status == 0
    assert names(here / f"{STEM}.clips") == [
        *(f"{k:04d}.usdc" for k in (1, 2, 3, 4)),
        "manifest.usda",
    ]


@pytest.mark.slow
def test_without_a_checkpoint_it_begins_anew_and_says_so(gf_usd, here: Path, block: Path) -> None:
    arguments = ("bake", block, "--particles", "200", "--frames", "3")
    done = gf_usd(*arguments, "--resume")
    assert done.status == 0
    assert f"--resume: there is no {KEPT}" in done.err
    assert "there will be none without --clip-frames; the bake starts over" in done.err
    refused = gf_usd(*arguments, "--slice", "1", "--overwrite")
    assert refused.status == 2
    assert "--slice 1 counts value clips, but this bake has none" in refused.err


@pytest.mark.slow
def test_a_new_bake_removes_what_it_does_not_resume(gf_usd, here: Path, block: Path) -> None:
    arguments = ("bake", block, *SMALL, "-q")
    assert gf_usd(*arguments, "--slice", "1").status == 5
    assert gf_usd("bake", block, "--particles", "200", "--frames", "3", "-q").status == 0
    assert names(here) == [f"{STEM}.{end}" for end in ("cache.usdc", "report.json", "usda")]


@pytest.mark.slow
def test_a_bake_cut_between_its_last_files_is_resumed(
    gf_usd, here: Path, block: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gf_usd.pipeline.run import run

    arguments = ("bake", block, *SMALL, "-q")
    assert gf_usd(*arguments, "-o", "one/").status == 0

    def killed(*args: object) -> None:
        raise SystemExit(137)

    with monkeypatch.context() as patch:
        patch.setattr(run, "publish_text", killed)
        assert gf_usd(*arguments, "-o", "two/").status == 137
    assert (here / "two" / f"{STEM}.usda").exists()
    assert gf_usd(*arguments, "-o", "two/", "--resume").status == 0
    require_same(here / "one", here / "two")


@pytest.mark.slow  # a capture takes long to fill
def test_captured_gaussians_continue_identically(gf_usd, here: Path, tmp_path: Path) -> None:
    path = write_ply(tmp_path / "block.ply", ball(300, degree=1))
    arguments = ("bake", path, *SMALL, "-q")
    assert gf_usd(*arguments, "-o", "one/", "--export-ply", "all").status == 0
    arguments = (*arguments, "-o", "two/", "--export-ply", "parts")
    assert gf_usd(*arguments, "--slice", "1").status == 5
    while gf_usd(*arguments, "--slice", "1", "--resume").status == 5:
        pass
    require_same(here / "one", here / "two")
    assert len(names(here / "all")) == 9
    for name in names(here / "all"):
        assert (here / "all" / name).read_bytes() == (here / "parts" / name).read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        pytest.param((), marks=pytest.mark.acceptance),  # the others have its state, and more
        ("--goal-frequency", "4"),
        pytest.param(("--rigid", "box:1.5,-1,-1,3,1,1"), marks=pytest.mark.acceptance),
        ("--squish", "0.6", "--stretch", "0.3", "--field", "noise:9:length=0.5:rate=2"),
    ],
)
def test_flesh_continues_identically(gf_usd, here: Path, more: tuple[str, ...]) -> None:
    write(here, arm())
    arguments = (
        "bake", "arm.usda", "--flesh", "-m", "jelly", "--particles", "400", "--preroll", "6",
        "--clip-frames", "4", *more,
    )  # fmt: skip
    assert gf_usd(*arguments, "-o", "whole/").status == 0
    assert gf_usd(*arguments, "-o", "parts/", "--slice", "1").status == 5
    assert gf_usd(*arguments, "-o", "parts/", "--resume").status == 0
    require_same(here / "whole", here / "parts")


@pytest.mark.slow
def test_a_cycle_that_ends_by_itself_continues_identically(gf_usd, here: Path) -> None:
    write(here, swinging())
    arguments = (
        "bake", "arm.usda", "--flesh", "-m", "jelly", "--particles", "300", "--preroll", "12",
        "--goal-frequency", "8", "--gravity", "0", "--clip-frames", "5", "--loop",
    )  # fmt: skip
    assert gf_usd(*arguments, "-o", "whole/").status == 0
    assert gf_usd(*arguments, "-o", "parts/", "--slice", "1").status == 5
    assert gf_usd(*arguments, "-o", "parts/", "--resume").status == 0
    require_same(here / "whole", here / "parts")

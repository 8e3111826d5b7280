"""Animated points: their frames, the pre-roll, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm import FIRST, LAST, arm, cached, skinned, write
from small_bakes import BLOCK

from gf_usd.core.errors import InputError
from gf_usd.readers import read_asset
from gf_usd.readers.usd.skeleton.bones import skeletons
from gf_usd.readers.usd_bake.caches import cache_range, read_cache

SKIN = ["/Arm/Skin"]


def written(folder: Path, text: str) -> Path:
    path = folder / "cache.usda"
    path.write_text(text, encoding="utf-8")
    return path


def test_points_are_those_of_the_time_samples(tmp_path: Path) -> None:
    source = write(tmp_path, arm())
    path = written(tmp_path, cached(source))
    facts = read_asset(path).facts
    assert skeletons(source, SKIN, facts)
    assert not skeletons(path, SKIN, facts)
    assert cache_range(path, SKIN, facts) == (FIRST, LAST)
    times = list(range(FIRST, LAST + 1))
    frames = read_cache(path, SKIN, facts, first=FIRST, times=times)
    for code, frame in zip(times, frames, strict=True):
        np.testing.assert_allclose(frame["/Arm/Skin"], skinned(source, code), atol=1e-6)


def test_frames_before_lead_from_the_first_pose_into_its_velocity(tmp_path: Path) -> None:
    source = write(tmp_path, arm())
    path = written(tmp_path, cached(source))
    facts = read_asset(path).facts
    times = list(range(FIRST - 24, FIRST + 2))
    frames = [f["/Arm/Skin"] for f in read_cache(path, SKIN, facts, first=FIRST, times=times)]
    np.testing.assert_allclose(frames[0], skinned(source, FIRST), atol=1e-6)
    step, before = frames[-1] - frames[-2], frames[-2] - frames[-3]
    moving = np.linalg.norm(step, axis=1) > 1e-3
    # of a way that slows down by 1 / MEMORY a frame backwards: a frame earlier is 7/8 as fast
    np.testing.assert_allclose(before[moving], step[moving], rtol=0.15, atol=1e-5)


def test_the_range_is_that_of_samples_where_the_stage_says_none(tmp_path: Path) -> None:
    source = write(tmp_path, arm())
    turn = "double xformOp:rotateZ.timeSamples = { 0: 0, 20: 30 }\n"
    turn += '    uniform token[] xformOpOrder = ["xformOp:rotateZ"]'
    path = written(tmp_path, cached(source, with_range=False, more=turn))
    assert cache_range(path, SKIN, read_asset(path).facts) == (0.0, 20.0)


def test_a_mesh_that_nothing_moves_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, BLOCK)
    with pytest.raises(
        InputError, match="no skeleton poses </World/Block>, and its points have no"
    ):
        cache_range(path, ["/World/Block"], read_asset(path).facts)


def test_a_skinned_mesh_without_a_skel_root_is_reported_so(tmp_path: Path) -> None:
    """As where a shot says `def Xform` of the prim at which it references a character."""
    path = written(tmp_path, arm().replace("def SkelRoot", "def Xform"))
    with pytest.raises(
        InputError,
        match=r"poses </Arm/Skin> \(it is not below a SkelRoot\), and its points have no",
    ):
        cache_range(path, SKIN, read_asset(path).facts)


def test_points_that_come_and_go_are_refused(tmp_path: Path) -> None:
    text = cached(write(tmp_path, arm()), every=12)
    head, _, last = text.partition(f"{LAST}: [")
    fewer = last.partition("]")
    text = f"{head}{LAST}: [{fewer[0]}, (9, 9, 9)]{fewer[2]}"
    path = written(tmp_path, text)
    frames = read_cache(path, SKIN, read_asset(path).facts, first=FIRST, times=[FIRST, LAST])
    next(frames)
    with pytest.raises(InputError, match="has 36 points at the first frame but 37 at time code 13"):
        next(frames)

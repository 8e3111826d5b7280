"""The first frame of a bake is the source at that time, whatever the source says of its time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_stages import with_variant, world_points
from production_shot import mesh
from pxr import Usd

import gf_usd
from gf_usd.pipeline.prepared import prepare
from gf_usd.readers import read_asset
from gf_usd.readers.usd_physics.scene import read_physics

BODY = f"""
def Xform "World"
{{
    double3 xformOp:translate.timeSamples = {{
        -10: (0, -10, 0),
        0: (0, 0, 0),
        10: (0, 30, 0),
    }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "Box"
    {{
        {mesh(10.0)}
    }}
}}
"""
RATE = "timeCodesPerSecond = 24"
RANGE = "startTimeCode = 5\n    endTimeCode = 10"
# what the head says, --fps, the first time code of the bake and its height
HEADS = {
    "nothing authored": ("", None, 1.0, 3.0),
    "nothing authored, other fps": ("", 48.0, 1.0, 3.0),
    "a range": (RANGE, None, 5.0, 15.0),
    "a range, other fps": (RANGE, 48.0, 5.0, 15.0),
    "a range and a rate, other fps": (f"{RANGE}\n    {RATE}", 48.0, 5.0, 15.0),
    "twice the rate": (f"{RANGE}\n    timeCodesPerSecond = 48", 24.0, 5.0, 15.0),
    "frames of playback": (
        f"{RANGE}\n    timeCodesPerSecond = 48\n    framesPerSecond = 24",
        None,
        5.0,
        15.0,
    ),
}


def write(path: Path, head: str, body: str) -> Path:
    path.write_text(
        f'#usda 1.0\n(\n    defaultPrim = "World"\n    metersPerUnit = 0.01\n'
        f'    upAxis = "Y"\n    {head}\n)\n{body}',
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("name", HEADS)
def test_the_first_frame_is_the_source_at_that_time(name: str, tmp_path: Path) -> None:
    head, fps, start, height = HEADS[name]
    source = write(tmp_path / "shot.usda", head, BODY)
    result = gf_usd.bake(
        source, output=f"{tmp_path}/out/", particles=60, frames=3, floor="none", fps=fps
    )
    none, baked = (with_variant(result.root, look) for look in ("none", "rubber"))
    times = baked.GetAttributeAtPath("/World/Box.points").GetTimeSamples()
    assert times[0] == start
    # a second of playback is a second, in the source as in the bake
    assert baked.GetTimeCodesPerSecond() == Usd.Stage.Open(str(source)).GetTimeCodesPerSecond()
    assert baked.GetFramesPerSecond() == (fps or 24.0)
    assert times[1] - times[0] == baked.GetTimeCodesPerSecond() / (fps or 24.0)
    ours, theirs = (world_points(stage, "/World/Box", start) for stage in (baked, none))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5)
    assert ours[:, 1].mean() == pytest.approx(height)


def test_without_time_samples_the_rate_is_the_frames(tmp_path: Path) -> None:
    source = write(tmp_path / "still.usda", "", f'def Mesh "World"\n{{\n{mesh(10.0)}\n}}\n')
    assert not read_asset(source).facts.animated
    plan = prepare(source, output=f"{tmp_path}/out/", particles=60, fps=48.0).plan
    assert plan.settings.time_codes_per_second == 48.0


def test_samples_in_any_layer_count(tmp_path: Path) -> None:
    write(tmp_path / "below.usda", "", BODY)
    source = write(
        tmp_path / "shot.usda", "", 'def "World" (\n    references = @./below.usda@\n)\n{\n}\n'
    )
    assert read_asset(source).facts.animated


def test_what_moved_before_the_first_frame_has_its_velocity(tmp_path: Path) -> None:
    source = write(tmp_path / "shot.usda", "", BODY)
    facts = read_asset(source).facts
    physics = read_physics(source, facts, ["/World/Box"], rest=None, times=[1.0, 2.0])
    moving = physics.bodies[0].moving
    assert moving is not None
    # 30 cm in 10 frames of 1/24 s
    np.testing.assert_allclose(moving, np.tile([0.0, 0.72, 0.0], (26, 1)), atol=1e-6)

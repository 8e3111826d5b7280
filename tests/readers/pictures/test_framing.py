"""What a picture is fitted to where bodies fall out of the scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from gf_usd.core.scene import Bounds
from gf_usd.readers.pictures.extent import STATIC_MARGIN, motion_boxes
from gf_usd.readers.pictures.framing import FALL_MARGIN, Framing, frame_motion
from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.readers.pictures.scene import PictureStage

Y = np.array([0.0, 1.0, 0.0])
CODES = (1.0, 2.0, 3.0, 4.0, 5.0)
TABLE = """
def Cube "Table" {
    double size = 1
    double3 xformOp:translate = (0, -0.5, 0)
    float3 xformOp:scale = (8, 1, 8)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}
"""
CEILING = """
def Cube "Ceiling" {
    double size = 1
    double3 xformOp:translate = (0, 8.6, 0)
    float3 xformOp:scale = (12, 1, 4)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}
"""
CAMERA = 'def Camera "Camera" {\n}\n'
FALLS, LANDS = (1.0, 1.0, -3.0, -8.0, -15.0), (1.0, 1.0, -3.0, -8.0, -8.0)


def ball(heights: Sequence[float]) -> str:
    """A cube of 2 m that rolls off the table."""
    way = ", ".join(f"{k + 1}: ({k}, {y}, 0)" for k, y in enumerate(heights))
    return f"""
def Cube "Ball" {{
    double size = 2
    double3 xformOp:translate.timeSamples = {{ {way} }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
"""


def drops(falling: int) -> str:
    """Ten points on the table, some of which fall from it to the heights of FALLS."""
    rows = []
    for k, y in enumerate(FALLS):
        points = [(float(n - 5), y if n < falling else 0.1 + 0.01 * k, 0.0) for n in range(10)]
        rows.append(f"{k + 1}: {points}")
    return f"""
def Points "Drops" {{
    point3f[] points.timeSamples = {{ {", ".join(rows)} }}
    float[] widths = [0.0]
}}
"""


def pendants(*ways: Sequence[float]) -> str:
    """Cubes of 2 m, far apart, by their heights."""
    cubes = []
    for number, heights in enumerate(ways):
        x = 8 * number - 4
        way = ", ".join(f"{k + 1}: ({x}, {y}, 0)" for k, y in enumerate(heights))
        cubes.append(f"""
def Cube "Pendant{number}" {{
    double size = 2
    double3 xformOp:translate.timeSamples = {{ {way} }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
""")
    return "".join(cubes)


def drips() -> str:
    """Six points in the ceiling, and four that sink below it."""
    rows = []
    for k in range(5):
        points = [(float(n - 5), 8.5 if n < 6 else 4.0 - 0.5 * k, 0.0) for n in range(10)]
        rows.append(f"{k + 1}: {points}")
    return f"""
def Points "Drips" {{
    point3f[] points.timeSamples = {{ {", ".join(rows)} }}
    float[] widths = [0.0]
}}
"""


def fit(write: Callable[..., Path], body: str) -> tuple[Bounds, Framing]:
    """The box of all, and the framing."""
    stage = Usd.Stage.Open(str(write(body)))
    prims = [prim for prim in stage.GetPseudoRoot().GetChildren() if prim.GetName() != "Camera"]
    boxes = motion_boxes(prims, CODES, 1.0)
    assert boxes.bounds is not None
    return boxes.bounds, frame_motion(prims, boxes, boxes.bounds, Y)


def test_what_falls_to_the_end_leaves_the_picture(write: Callable[..., Path]) -> None:
    whole, framing = fit(write, TABLE + ball(FALLS))
    assert framing.fallen == ("/Ball",)
    assert whole.low[1] == -16.0
    # the ball of the first two frames, and of the table what is near that
    reach = STATIC_MARGIN * np.linalg.norm((3.0, 2.0, 2.0))
    low, high = (
        np.array([-1.0 - reach, -reach, -1.0 - reach]),
        np.array([2.0 + reach, 2.0, 1 + reach]),
    )
    low[1] -= FALL_MARGIN * (high - low).max()
    np.testing.assert_allclose(framing.bounds.low, low)
    np.testing.assert_allclose(framing.bounds.high, high)
    assert framing.until == 2.0


@pytest.mark.parametrize(
    "body",
    [TABLE + ball(LANDS), ball(FALLS), TABLE + drops(9), TABLE + ball((9.0, 7.0, 4.0, 1.0, 1.0))],
    ids=["it lands", "nothing stays", "most of it falls", "on the table"],
)
def test_all_of_any_other_motion_is_shown(write: Callable[..., Path], body: str) -> None:
    whole, framing = fit(write, body)
    assert framing == Framing(whole)


@pytest.mark.parametrize(
    "body",
    [
        pendants((6.0, 5.5, 6.0, 5.5, 5.0), (6.0, 6.5, 6.0, 5.5, 6.0)),
        pendants((5.0, 7.2, 6.0, 4.0, 1.0), (6.0, 6.0, 6.0, 6.0, 6.1)),
        drips(),
    ],
    ids=["pendants", "one bumps its top", "drips"],
)
def test_what_hangs_from_a_ceiling_has_not_fallen(write: Callable[..., Path], body: str) -> None:
    whole, framing = fit(write, CEILING + body)
    assert framing == Framing(whole)


def test_of_drops_those_that_fall_do_not_count(write: Callable[..., Path]) -> None:
    whole, framing = fit(write, TABLE + drops(2))
    assert framing.fallen == ("/Drops",)
    assert framing.until is None  # eight stay
    assert whole.low[1] == -15.0
    # on the table, of which a part is near, and a tenth of its width below
    assert -1.0 - FALL_MARGIN * 11.0 < framing.bounds.low[1] < 0.0
    assert framing.bounds.high[1] == 1.0


def test_a_picture_says_what_falls_out_of_it(write: Callable[..., Path]) -> None:
    path = write(TABLE + ball(FALLS) + CAMERA)
    motion_box, seen = PictureStage(path), PictureStage(path, camera="/Camera")
    (note,) = [
        one for one in motion_box.scene(1.0).notes if one.startswith("</Ball>: falls out of")
    ]
    assert "--camera" in note
    assert seen.scene(1.0).notes == ()
    assert motion_box.motion.bounds is not None
    assert motion_box.motion.bounds.low[1] > -3.0
    assert motion_box.motion.ground == seen.motion.ground
    assert (motion_box.motion.shown_until, seen.motion.shown_until) == (2.0, None)
    recording = BakedMotion(path, displayed=True).recording()
    assert recording.framed is not None
    np.testing.assert_allclose(recording.framed.low, motion_box.motion.bounds.low)
    assert recording.shown_until == 2.0
    plain = BakedMotion(path).recording()
    assert (plain.framed, plain.shown_until) == (None, None)

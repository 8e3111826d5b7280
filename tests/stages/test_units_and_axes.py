"""Units and axes: the same crate in shots that count in meters, centimeters, inches and feet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_stages import additions, differences, with_variant, world_points
from production_shot import write_props
from pxr import Usd
from slow_parameters import slow_but

import gf_usd

SHOTS = {
    "meters, Z up": (1.0, "Z"),
    "centimeters, Y up": (0.01, "Y"),
    "inches, Z up": (0.0254, "Z"),
    "feet, Y up": (0.3048, "Y"),
}
G = 9.81


def write_shot(folder: Path, unit: float, up: str) -> Path:
    """Two root prims, no default prim; the layers below are in meters, Z up, and in inches, Y up.

    /Left/Crate is scaled into the shot's unit by a prim above; /Right is the inches' payload.
    """
    write_props(folder)
    turn = "" if up == "Z" else "-90"
    ops = '["xformOp:rotateX", "xformOp:scale"]' if turn else '["xformOp:scale"]'
    scale = 1.0 / unit
    path = folder / "shot.usda"
    path.write_text(
        f"""#usda 1.0
(
    metersPerUnit = {unit}
    upAxis = "{up}"
)
def Xform "Left"
{{
    {f"float xformOp:rotateX = {turn}" if turn else ""}
    float3 xformOp:scale = ({scale}, {scale}, {scale})
    uniform token[] xformOpOrder = {ops}
    def "Crate" (
        references = @./props/crate.usda@
    )
    {{
    }}
}}
def Xform "Right" (
    payload = @./props/ball.usdc@
)
{{
    double3 xformOp:translate = ({scale}, 0, 0)
    float3 xformOp:scale = ({0.0254 * scale}, {0.0254 * scale}, {0.0254 * scale})
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}}
""",
        encoding="utf-8",
    )
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_but(SHOTS, "centimeters, Y up", "inches, Z up"))
def test_a_body_falls_by_half_g_t_squared_in_any_unit(name: str, tmp_path: Path) -> None:
    unit, up = SHOTS[name]
    shot = write_shot(tmp_path / "in", unit, up)
    result = gf_usd.bake(
        shot, output=f"{tmp_path / 'out'}/", particles=200, frames=4, floor="none", start=1
    )
    source, baked = Usd.Stage.Open(str(shot)), with_variant(result.root, "rubber")
    none = with_variant(result.root, "none")
    assert differences(source, none) == {}
    assert additions(source, none) == set()
    down = -np.eye(3)["XYZ".index(up)]
    box, skin = (world_points(source, path, 1.0) for path in ("/Left/Crate/Box", "/Right/Skin"))
    # The skin comes with the motion that its skeleton had a frame before.
    way = (skin - world_points(source, "/Right/Skin", 0.0)).mean(0)
    assert np.linalg.norm(way) > 0.0
    for frame in range(4):
        fallen = 0.5 * G * (frame / 24.0) ** 2 / unit
        points = world_points(baked, "/Left/Crate/Box", 1.0 + frame)
        # float32 of numbers below 100 and scales of up to 100
        np.testing.assert_allclose(points, box + fallen * down, rtol=0, atol=2e-5 / min(unit, 1.0))
        mean = world_points(baked, "/Right/Skin", 1.0 + frame).mean(0)
        # it bends besides, by millimeters: the mean of its vertices is not quite that of its mass
        np.testing.assert_allclose(
            mean, skin.mean(0) + frame * way + fallen * down, rtol=0, atol=2e-3 / unit
        )


def test_the_shots_are_the_same_in_meters(tmp_path: Path) -> None:
    found = []
    for number, (unit, up) in enumerate(SHOTS.values()):
        stage = Usd.Stage.Open(str(write_shot(tmp_path / f"{number}", unit, up)))
        points = world_points(stage, "/Left/Crate/Box", 1.0) * unit
        found.append(points if up == "Z" else points[:, [0, 2, 1]] * (1, -1, 1))
    for points in found[1:]:
        np.testing.assert_allclose(points, found[0], rtol=0, atol=1e-7)

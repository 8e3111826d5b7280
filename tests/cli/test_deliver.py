"""``gf-usd deliver``: what it prints."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh
from moving_splats import moving_splats
from small_bakes import SMALL

from gf_usd import bake as gf_usd_bake
from gf_usd.cli.deliver import error_text
from gf_usd.core.units import bytes_text
from gf_usd.delivery.deliver import DeliveredSplats


@pytest.mark.slow
def test_it_says_how_far_off_gaussians_are(gf_usd, tmp_path: Path) -> None:
    source = moving_splats(tmp_path / "ball.usdc", mesh=False)
    done = gf_usd("deliver", source, "-o", tmp_path / "out.glb", "--error", "2%")
    assert done.status == 0, done.err
    assert "</Ball/Splats>: 200 Gaussians, position error at most" in done.out
    assert "covariance error" in done.out
    assert f"out.glb: {bytes_text((tmp_path / 'out.glb').stat().st_size)}, " in done.out
    quiet = gf_usd("deliver", source, "-o", tmp_path / "out.glb", "--error", "2%", "-q")
    assert (quiet.status, quiet.out, quiet.err) == (0, "", "")
    done = gf_usd("deliver", source, "-o", tmp_path / "out.glb", "--error", "2%", "--json")
    report = json.loads(done.out)["splats"][0]
    assert report["count"] == 200
    assert len(report["covariance"]) == 3
    done = gf_usd("deliver", source, "-o", tmp_path / "out.usdz", "--splats", "only")
    assert done.status == 2
    assert "--splats only is only for .glb" in done.err


@pytest.mark.slow
@pytest.mark.parametrize("flat", [(), ("--flatten",)])
def test_the_mesh_file_that_was_baked_is_not_replaced(gf_usd, tmp_path: Path, flat) -> None:
    """It is no layer of the bake, and has the name that one would give to the delivered file."""
    asset, root = tmp_path / "box.glb", tmp_path / f"box.rubber.{'usdc' if flat else 'usda'}"
    trimesh.creation.box((0.2, 0.4, 0.6)).export(asset)
    before = asset.read_bytes()
    assert gf_usd("bake", asset, *SMALL, *flat, "-o", root).status == 0
    done = gf_usd("deliver", root, "-o", asset, "--error", "2%")
    assert done.status == 2
    assert f"{asset} is the asset that was baked" in done.err
    assert asset.read_bytes() == before
    for _ in range(2):  # a delivered file is replaced
        assert gf_usd("deliver", root, "-o", tmp_path / "out.glb", "--error", "2%").status == 0


@pytest.mark.slow
def test_obstacles_that_stand_still_are_named_in_one_line(gf_usd, tmp_path: Path) -> None:
    text = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{
    def Cube "body"
    {
        double size = 1
        double3 xformOp:translate = (0, 1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""
    for number in range(4):
        text += (
            f'    def Cube "step{number}" (prepend apiSchemas = ["PhysicsCollisionAPI"])\n    {{\n'
            f"        double size = 0.8\n        double3 xformOp:translate = ({number}, 0, 0)\n"
            '        uniform token[] xformOpOrder = ["xformOp:translate"]\n    }\n'
        )
    asset = tmp_path / "steps.usda"
    asset.write_text(text + "}\n", encoding="utf-8")
    baked = gf_usd_bake(asset, particles=200, frames=4, output=tmp_path / "baked.usda")
    done = gf_usd("deliver", baked.root, "-o", tmp_path / "steps.glb", "--error", "5%")
    assert done.status == 0, done.err
    lines = done.out.splitlines()
    assert lines[1] == "/World/step0, /World/step1, /World/step2, ...: do not move"
    assert len(lines) == 3


def test_large_errors_have_no_exponent() -> None:
    cloud = DeliveredSplats(
        variant="", path="/Duck", count=3, position=0.004, covariance=(0.043, 0.591, 4.98)
    )
    text = error_text(cloud)
    assert text.endswith("covariance error 4.3 % (median), 59 % (99 in 100), 500 % (largest)")

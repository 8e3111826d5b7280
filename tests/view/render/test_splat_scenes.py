"""Captured Gaussians look the same at rest, and turn with the body, in degree 3 as well.

Pictures are the Gaussians alone over black: peak signal-to-noise ratio over all pixels, where the
Gaussians' own colors reach 1.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from captures import ball, define
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from gf_usd.core.asset import Splats
from gf_usd.core.frames.frame import Pose
from gf_usd.core.scene import Camera, Harmonics, RenderSplats
from gf_usd.geometry.splat_hull import hull
from gf_usd.layers.stage import Clock
from gf_usd.layers.tracks.captured import SplatTrack
from gf_usd.physics.output.gaussians import CarriedSplats
from gf_usd.readers.pictures.scene import PictureStage
from gf_usd.system.taichi_runtime import ensure_taichi
from gf_usd.view.render.camera import pinhole_camera
from gf_usd.view.render.splats import draw_splats, view_dependent_color

SIZE = (200, 150)
EYE = np.array([0.4, 0.9, 2.2])
UP = np.array([0.0, 1.0, 0.0])
# Turned coefficients are stored in half precision: 5e-4 of about .2 in each of 16 terms.
ENOUGH = 60.0  # [dB] an error of 1e-3
TURN = Rotation.from_euler("xyz", [0.7, -1.2, 2.1]).as_matrix()


def picture(cloud: RenderSplats, turn: np.ndarray | None = None) -> np.ndarray:
    """(H, W, 3) over black, from the camera turned about the origin."""
    ensure_taichi()
    turn = np.eye(3) if turn is None else turn
    eye, up = turn @ EYE, turn @ UP
    view = pinhole_camera(
        Camera(eye=tuple(eye), target=(0.0, 0.0, 0.0), up=tuple(up), fov=40.0), *SIZE, np.zeros(3)
    )
    out = np.zeros((SIZE[1], SIZE[0], 3), np.float32)
    colors = view_dependent_color(cloud.harmonics, cloud.positions - eye)
    draw_splats(cloud, colors, view, out, np.full(out.shape[:2], np.inf, np.float32))
    return out


def direct(splats: Splats) -> RenderSplats:
    """As a picture shows them, without a file between."""
    return RenderSplats(
        name="/ball",
        positions=splats.points,
        axes=splats.axes,
        colors=splats.colors,
        opacities=splats.opacities,
        harmonics=Harmonics(coefficients=splats.harmonics, frame=np.eye(3), srgb=True),
    )


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10.0 * np.log10(np.mean((a - b) ** 2) + 1e-30))


@pytest.fixture
def file(tmp_path):
    """A stage with the capture, and its first frames as the cache has them, in one layer."""

    def write(rest: Splats, poses) -> PictureStage:
        path = str(tmp_path / "ball.usda")
        stage = Usd.Stage.CreateNew(path)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.SetStageUpAxis(stage, "Y")
        prim = define(stage, "/ball", rest)
        surface, _ = hull(rest, up=1)
        clock = Clock(rate=24.0, source_rate=24.0, start=1.0, end=2.0, step=1.0)
        track = SplatTrack(stage, prim, surface, clock, 1.0)
        carried = CarriedSplats(rest)
        for number, (x, F) in enumerate(poses):
            n = len(rest)
            pose = Pose(x=x, v=np.zeros((n, 3)), F=np.broadcast_to(F, (n, 3, 3)))
            track.write(carried.advance(pose, np.eye(3)), 1.0 + number)
        stage.SetStartTimeCode(1)
        stage.Save()
        return PictureStage(tmp_path / "ball.usda")

    return write


def shaped(degree: int = 3) -> Splats:
    """Not the same from any two sides."""
    rest = ball(700, degree=degree, seed=5)
    return replace(rest, positions=rest.positions * np.float32([1.0, 0.7, 0.5]))


@pytest.mark.slow
def test_the_rest_frame_is_the_input(file):
    rest = shaped()
    read = file(rest, [(rest.points, np.eye(3))])
    shown = picture(read.scene(1.0).splats[0])
    assert shown.max() > 0.5
    assert psnr(shown, picture(direct(rest))) > ENOUGH


@pytest.mark.slow
def test_a_turned_body_is_a_turned_camera(file):
    rest = shaped()
    read = file(rest, [(rest.points, np.eye(3)), (rest.points @ TURN.T, TURN)])
    turned = read.scene(2.0).splats[0]
    expected = picture(direct(rest), TURN.T)
    assert psnr(picture(turned), expected) > ENOUGH
    # with coefficients that stay as they are it is another picture
    assert turned.harmonics is not None
    stiff = replace(turned, harmonics=replace(turned.harmonics, coefficients=rest.harmonics))
    assert psnr(picture(stiff), expected) < 40.0

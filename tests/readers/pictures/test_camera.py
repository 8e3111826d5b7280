"""A stage's camera against USD's own projection."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from gf_usd.core.errors import InputError
from gf_usd.readers.pictures.scene import PictureStage
from gf_usd.view.render.camera import pinhole_camera

STAGE = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Z"
)
def Cube "box" {
    double size = 2
}
def Xform "rig" {
    double3 xformOp:translate = (3, 1, 0)
    double3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    def Camera "cam" {
        float focalLength = 35
        float horizontalAperture = 36
        float verticalAperture = 20
        float horizontalApertureOffset = 2
        float verticalApertureOffset = -1.5
        double3 xformOp:translate.timeSamples = { 1: (1, -8, 3), 5: (2, -9, 4) }
        float3 xformOp:rotateXYZ.timeSamples = { 1: (75, 0, 5), 5: (70, 10, 15) }
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }
    def Camera "flat" {
        token projection = "orthographic"
    }
    def Camera "broken" {
        float focalLength = 0
    }
}
"""
POINTS = np.array([(0.0, 0.0, 0.0), (1.0, -1.0, 1.0), (-1.0, 1.0, 0.5)])


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "stage.usda"
    file.write_text(STAGE, encoding="utf-8")
    return file


@pytest.mark.parametrize("time", [1.0, 3.0, 5.0])
@pytest.mark.parametrize("aspect", [36 / 20, 1.0, 2.5])
def test_known_points_fall_where_usd_projects_them(path, time, aspect):
    source = PictureStage(path, camera="/rig/cam")
    height = 400
    width = int(aspect * height)
    camera = source.camera(time, width / height)
    clip = pinhole_camera(camera, width, height, np.zeros(3)).clip(0.01 * POINTS)
    shown = clip[:, :2] / clip[:, 2:]

    stage = Usd.Stage.Open(str(path))
    seen = UsdGeom.Camera(stage.GetPrimAtPath("/rig/cam")).GetCamera(time)
    frustum = seen.frustum
    # the whole aperture stays in the picture: it grows about its middle to the picture's shape
    window = frustum.GetWindow()
    middle, half = window.GetMidpoint(), 0.5 * window.GetSize()
    wide = max(half[0], half[1] * aspect)
    grown = Gf.Vec2d(wide, wide / aspect)
    frustum.SetWindow(Gf.Range2d(middle - grown, middle + grown))
    matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    expected = np.array([matrix.Transform(Gf.Vec3d(*map(float, p))) for p in POINTS])
    pixels = np.stack(
        [0.5 * (1 + expected[:, 0]) * width, 0.5 * (1 - expected[:, 1]) * height], axis=1
    )
    # apertures and focal length are single-precision numbers
    assert np.allclose(shown, pixels, atol=1e-3)


def test_the_motion_includes_that_of_the_camera(path):
    assert PictureStage(path).motion.time_codes == ()
    assert PictureStage(path, camera="/rig/cam").motion.time_codes == (1.0, 5.0)
    assert PictureStage(path).camera(1.0, 1.0) is None


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/rig/none", "there is no camera </rig/none>"),
        ("not a path", "there is no camera <not a path>"),
        ("/rig", "</rig> is of type Xform, not Camera"),
        ("/rig/flat", "has orthographic projection"),
    ],
)
def test_what_is_no_camera_is_refused(path, name, message):
    with pytest.raises(InputError) as caught:
        PictureStage(path, camera=name)
    assert message in caught.value.message
    assert "/rig/cam" in caught.value.hint or "leave --camera out" in caught.value.hint


def test_a_camera_that_makes_no_picture_is_refused(path):
    with pytest.raises(InputError, match="/rig/broken> cannot render an image"):
        PictureStage(path, camera="/rig/broken").camera(None, 1.0)

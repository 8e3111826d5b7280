"""Reader of a UsdGeomCamera for rendering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from gf_usd.core.arrays import triple
from gf_usd.core.errors import InputError
from gf_usd.core.scene import Camera


def find_camera(stage: Usd.Stage, path: Path, name: str) -> UsdGeom.Camera:
    """The UsdGeomCamera at a prim path.

    Raises InputError where there is no camera at this path, or its projection is orthographic.
    """
    prim = stage.GetPrimAtPath(name) if Sdf.Path.IsValidPathString(name) else None
    if not prim or not prim.IsA(UsdGeom.Camera):
        if prim:
            what = f"<{name}> is of type {prim.GetTypeName() or 'none'}, not Camera"
        else:
            what = f"there is no camera <{name}>"
        raise InputError(f"{path}: {what}", _hint_of_cameras(stage))
    camera = UsdGeom.Camera(prim)
    projection = camera.GetProjectionAttr().Get()
    if projection != UsdGeom.Tokens.perspective:
        raise InputError(
            f"{path}: the camera {name} has {projection} projection; only perspective cameras "
            f"are supported",
            "choose another camera, or leave --camera out to have one fitted to the motion",
        )
    return camera


def _hint_of_cameras(stage: Usd.Stage) -> str:
    walk = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    cameras = [str(prim.GetPath()) for prim in walk if prim.IsA(UsdGeom.Camera)]
    if not cameras:
        return "the stage has no camera: leave --camera out to have one fitted to the motion"
    return f"the cameras in the stage are {', '.join(cameras)}"


def read_camera(
    camera: UsdGeom.Camera, time: Usd.TimeCode, unit: float, path: Path, aspect: float
) -> Camera:
    """The camera at a time, for images of an aspect ratio width / height.

    The image contains the whole aperture (CameraUtilFit): where the image is narrower, the widths
    match and it extends above and below; where it is wider, the heights match.  Clipping planes,
    depth of field and the shutter are ignored.

    Raises InputError for an invalid focal length, aperture or transform.
    """
    gf_camera = camera.GetCamera(time)
    focal = float(gf_camera.focalLength)
    width, height = float(gf_camera.horizontalAperture), float(gf_camera.verticalAperture)
    matrix = np.array(gf_camera.transform, dtype=np.float64)
    up, back = matrix[1:3, :3]
    valid = min(focal, width, height) > 0.0 and np.isfinite(matrix).all()
    if not valid or abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
        raise InputError(
            f"{path}: the camera <{camera.GetPath()}> cannot render an image at {time}: focal "
            f"length {focal:g}, aperture {width:g} x {height:g}, transform "
            f"{_format_matrix(gf_camera.transform)}",
            "give it a focal length and apertures above 0 and a transform that can be inverted",
        )
    half = max(height, width / aspect) / (2.0 * focal)
    eye = matrix[3, :3] * unit
    target = eye - back / np.linalg.norm(back)
    return Camera(
        eye=triple(eye),
        target=triple(target),
        up=triple(up / np.linalg.norm(up)),
        fov=float(np.degrees(2.0 * np.arctan(half))),
        shift=(
            float(gf_camera.horizontalApertureOffset) / focal,
            float(gf_camera.verticalApertureOffset) / focal,
        ),
    )


def _format_matrix(matrix: Gf.Matrix4d) -> str:
    return " ".join(f"{value:.3g}" for row in matrix for value in row)

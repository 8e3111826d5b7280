"""Reader of a UsdGeomCamera for rendering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from gf_usd.core.arrays import triple
from gf_usd.core.errors import InputError
from gf_usd.core.scene import (
    Camera,
)


def find_camera(stage: Usd.Stage, path: Path, name: str) -> UsdGeom.Camera:
    """The camera of that prim path.

    Raises InputError where there is no such prim, or it is not a camera with perspective.
    """
    prim = stage.GetPrimAtPath(name) if Sdf.Path.IsValidPathString(name) else None
    if not prim or not prim.IsA(UsdGeom.Camera):
        if prim:
            what = f"<{name}> is of type {prim.GetTypeName() or 'none'}, not Camera."
        else:
            what = f"The camera <{name}> does not exist."
        raise InputError(f"{path}: {what}", _choice(stage))
    camera = UsdGeom.Camera(prim)
    projection = camera.GetProjectionAttr().Get()
    if projection != UsdGeom.Tokens.perspective:
        raise InputError(
            f"{path}: the camera {name} has {projection} projection; only perspective cameras "
            f"are supported.",
            "choose another camera, or leave --camera out to have one fitted to the motion",
        )
    return camera


def _choice(stage: Usd.Stage) -> str:
    walk = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    there = [str(prim.GetPath()) for prim in walk if prim.IsA(UsdGeom.Camera)]
    if not there:
        return "the stage has no camera: leave --camera out to have one fitted to the motion"
    return f"the cameras in the stage are {', '.join(there)}"


def read_camera(
    camera: UsdGeom.Camera, time: Usd.TimeCode, unit: float, path: Path, aspect: float
) -> Camera:
    """The camera at a time for pictures of a width / height.

    The whole of its aperture is in the picture, as a viewer shows a scene's camera: where the
    picture is narrower than the aperture its width fits and the picture shows more above and
    below, where it is wider its height fits.  Clipping planes, depth of field and the shutter
    are left out.

    Raises InputError where focal length, aperture or transform make no picture.
    """
    seen = camera.GetCamera(time)
    focal = float(seen.focalLength)
    across, down = float(seen.horizontalAperture), float(seen.verticalAperture)
    matrix = np.array(seen.transform, dtype=np.float64)
    up, back = matrix[1:3, :3]
    sound = min(focal, across, down) > 0.0 and np.isfinite(matrix).all()
    if not sound or abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
        raise InputError(
            f"{path}: the camera {camera.GetPath()} cannot render an image at {time}: focal length "
            f"{focal:g}, aperture {across:g} x {down:g}, transform {_short(seen.transform)}.",
            "give it a focal length and apertures above 0 and a transform that can be inverted",
        )
    half = max(down, across / aspect) / (2.0 * focal)
    eye = matrix[3, :3] * unit
    target = eye - back / np.linalg.norm(back)
    return Camera(
        eye=triple(eye),
        target=triple(target),
        up=triple(up / np.linalg.norm(up)),
        fov=float(np.degrees(2.0 * np.arctan(half))),
        shift=(
            float(seen.horizontalApertureOffset) / focal,
            float(seen.verticalApertureOffset) / focal,
        ),
    )


def _short(matrix: Gf.Matrix4d) -> str:
    return " ".join(f"{value:.3g}" for row in matrix for value in row)

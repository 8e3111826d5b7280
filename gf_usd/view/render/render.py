"""Rendering of one scene to one picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.errors import UsageError
from gf_usd.core.scene import Camera, RenderSplats, Scene
from gf_usd.system.taichi_runtime import ensure_taichi
from gf_usd.view.render.camera import PinholeCamera, fit_camera, pinhole_camera
from gf_usd.view.render.image import encode, untone
from gf_usd.view.render.lights import make_light_rig
from gf_usd.view.render.packing import extent_points, pack_surfaces
from gf_usd.view.render.splats import draw_splats, view_dependent_color
from gf_usd.view.render.surfaces import (
    OVERSAMPLING,
    LightMaps,
    draw_light_maps,
    draw_surfaces,
    irradiance,
)

LARGEST = 8192  # pixels a side


def render(
    scene: Scene, camera: Camera | None = None, size: tuple[int, int] = (640, 480)
) -> NDArray[np.uint8]:
    """Draw a scene: sRGB pixels (H, W, 3).  The result is deterministic, bit by bit.

    Parameters
    ----------
    camera : None: fitted to the scene.   size : (width, height) [pixels], each 1 to 8192.

    Raises
    ------
    UsageError : size out of range, or a camera without a direction.
    """
    return encode(render_linear(scene, camera, size))


def render_linear(
    scene: Scene, camera: Camera | None = None, size: tuple[int, int] = (640, 480)
) -> NDArray[np.float32]:
    """As `render`, but linear radiance (H, W, 3) before the tone curve."""
    width, height = size
    if not (1 <= width <= LARGEST and 1 <= height <= LARGEST):
        raise UsageError(
            f"an image of {width}x{height} pixels cannot be rendered",
            f"give a width and a height of 1 to {LARGEST} pixels, e.g. --size 640x480",
        )
    ensure_taichi()
    if camera is None:
        points = extent_points(scene)
        corners = np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else None
        camera = fit_camera(_box_corners(corners), scene.up, width / height)
    packed = pack_surfaces(scene)
    view = np.subtract(camera.eye, camera.target)
    rig = make_light_rig(scene.lights, view / np.linalg.norm(view), np.array(scene.up, dtype=float))
    oversampled = pinhole_camera(camera, width, height, packed.origin, OVERSAMPLING)
    light_maps = draw_light_maps(scene, packed, rig)
    image, depth = draw_surfaces(packed, light_maps, oversampled)
    if scene.splats:
        joined, radiance = _join_splats(scene.splats, light_maps, oversampled)
        draw_splats(
            joined, radiance, pinhole_camera(camera, width, height, packed.origin), image, depth
        )
    return image


def _box_corners(corners: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Corners (8, 3) of a box from its low and high corner; of a cube of edge 2 for None."""
    low, high = ((-1.0,) * 3, (1.0,) * 3) if corners is None else corners
    return np.array([np.where(bits, high, low) for bits in np.ndindex(2, 2, 2)], dtype=float)


def _join_splats(
    clouds: tuple[RenderSplats, ...], light_maps: LightMaps, view: PinholeCamera
) -> tuple[RenderSplats, NDArray[np.float32]]:
    """All splats as one cloud, which is sorted by depth as a whole, and their radiance (N, 3)."""
    radiance = np.concatenate([_radiance(cloud, light_maps, view) for cloud in clouds])
    joined = RenderSplats(
        name=" ".join(cloud.name for cloud in clouds),
        positions=np.concatenate([cloud.positions for cloud in clouds]),
        axes=np.concatenate([cloud.axes for cloud in clouds]),
        colors=np.concatenate([cloud.colors for cloud in clouds]),
        opacities=np.concatenate([cloud.opacities for cloud in clouds]),
    )
    return joined, radiance


def _radiance(
    cloud: RenderSplats, light_maps: LightMaps, view: PinholeCamera
) -> NDArray[np.float32]:
    """Radiance (N, 3): albedo times irradiance / pi for lit splats, else the captured radiance.

    The normal of a splat is its shortest axis, in the direction that receives more light: its
    outward direction is unknown, and at the silhouette of a body it points away from the camera.
    Irradiance is evaluated half a splat away from the center, because neighbors overlap it.
    """
    local = cloud.positions - view.origin
    if not cloud.lit:
        colors = cloud.colors
        if cloud.harmonics is not None:
            colors = view_dependent_color(cloud.harmonics, local - view.eye)
        return untone(colors).astype(np.float32)
    length = np.linalg.norm(cloud.axes, axis=1)
    shortest = np.argmin(length, axis=1)[:, None, None]
    normals = np.take_along_axis(np.asarray(cloud.axes), shortest, axis=2)[..., 0]
    normals = normals / np.maximum(length.min(axis=1, keepdims=True), 1e-30)
    half = 0.5 * length.max(axis=1, keepdims=True)
    light = [irradiance(light_maps, local + half * side, side) for side in (normals, -normals)]
    return cloud.colors.astype(np.float32) * np.maximum(*light)

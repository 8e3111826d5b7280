"""One picture of one scene.

From linear light to a file: tone curve, sRGB, dither, PNG.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.radiance import linear_to_srgb
from gf_usd.core.scene import Camera, RenderSplats, Scene
from gf_usd.system.taichi_runtime import ensure_taichi
from gf_usd.view.render.camera import Lens, fit_camera, lens
from gf_usd.view.render.lights import make_rig
from gf_usd.view.render.splats import draw_splats, seen_from
from gf_usd.view.render.surfaces import (
    OVERSAMPLING,
    Lit,
    content,
    draw_surfaces,
    irradiance,
    light_up,
    pack,
)

LARGEST = 8192  # pixels a side


def render(
    scene: Scene, camera: Camera | None = None, size: tuple[int, int] = (640, 480)
) -> NDArray[np.uint8]:
    """Draw a scene: pixels (H, W, 3), sRGB; the same scene gives the same bytes every time.

    Parameters
    ----------
    camera : None: fitted to the scene.   size : (width, height) [pixels], each 1 to 8192.

    Raises
    ------
    UsageError : an impossible size, or a camera without a direction.
    """
    return encode(render_linear(scene, camera, size))


def render_linear(
    scene: Scene, camera: Camera | None = None, size: tuple[int, int] = (640, 480)
) -> NDArray[np.float32]:
    """As `render`, but linear light (H, W, 3) before the tone curve."""
    width, height = size
    if not (1 <= width <= LARGEST and 1 <= height <= LARGEST):
        raise UsageError(
            f"An image of {width}x{height} pixels cannot be rendered.",
            f"give a width and a height of 1 to {LARGEST} pixels, e.g. --size 640x480",
        )
    ensure_taichi()
    if camera is None:
        points = content(scene)
        corners = np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else None
        camera = fit_camera(_box(corners), scene.up, width / height)
    packed = pack(scene)
    view = np.subtract(camera.eye, camera.target)
    rig = make_rig(scene.lights, view / np.linalg.norm(view), np.array(scene.up, dtype=float))
    fine = lens(camera, width, height, packed.origin, OVERSAMPLING)
    lit = light_up(scene, packed, rig)
    picture, seen = draw_surfaces(packed, lit, fine)
    if scene.splats:
        joined, radiance = _join_splats(scene.splats, lit, fine)
        draw_splats(joined, radiance, lens(camera, width, height, packed.origin), picture, seen)
    return picture


def _box(corners: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """(8, 3) corners of a box; of a unit cube where there is nothing."""
    low, high = ((-1.0,) * 3, (1.0,) * 3) if corners is None else corners
    return np.array([np.where(bits, high, low) for bits in np.ndindex(2, 2, 2)], dtype=float)


def _join_splats(
    clouds: tuple[RenderSplats, ...], lit: Lit, view: Lens
) -> tuple[RenderSplats, NDArray[np.float32]]:
    """All splats as one cloud, so that they sort among each other, and what each shows."""
    radiance = np.concatenate([_radiance(cloud, lit, view) for cloud in clouds])
    joined = RenderSplats(
        name=" ".join(cloud.name for cloud in clouds),
        positions=np.concatenate([cloud.positions for cloud in clouds]),
        axes=np.concatenate([cloud.axes for cloud in clouds]),
        colors=np.concatenate([cloud.colors for cloud in clouds]),
        opacities=np.concatenate([cloud.opacities for cloud in clouds]),
    )
    return joined, radiance


def _radiance(cloud: RenderSplats, lit: Lit, view: Lens) -> NDArray[np.float32]:
    """(N, 3) albedo times light where the splats are lit; else their own radiance.

    The normal of a splat is its shortest axis, on the side that sees more light: which side is
    outside is not known, and at the rim of a body it is the one that faces away.  Light is
    gathered half a splat above it, for its neighbors overlap it.
    """
    local = cloud.positions - view.origin
    if not cloud.lit:
        colors = cloud.colors
        if cloud.harmonics is not None:
            colors = seen_from(cloud.harmonics, local - view.eye)
        return untone(colors).astype(np.float32)
    length = np.linalg.norm(cloud.axes, axis=1)
    shortest = np.argmin(length, axis=1)[:, None, None]
    normals = np.take_along_axis(np.asarray(cloud.axes), shortest, axis=2)[..., 0]
    normals = normals / np.maximum(length.min(axis=1, keepdims=True), 1e-30)
    half = 0.5 * length.max(axis=1, keepdims=True)
    light = [irradiance(lit, local + half * side, side) for side in (normals, -normals)]
    return cloud.colors.astype(np.float32) * np.maximum(*light)


KNEE = 0.65  # below it colors stay as they are


def tone(linear: Floats) -> NDArray[np.floating]:
    """x below the knee k, k + (1 - k) tanh((x - k) / (1 - k)) above: film's soft shoulder."""
    x = np.maximum(linear, 0.0)
    return np.where(x < KNEE, x, KNEE + (1 - KNEE) * np.tanh((x - KNEE) / (1 - KNEE)))


def untone(shown: Floats) -> NDArray[np.floating]:
    """The linear value that `tone` shows as `shown` (0..1; nearly white at most)."""
    y = np.clip(shown, 0.0, 0.998)
    high = np.arctanh(np.maximum(y - KNEE, 0.0) / (1 - KNEE))
    return np.where(y < KNEE, y, KNEE + (1 - KNEE) * high)


def encode(linear: Floats) -> NDArray[np.uint8]:
    """8-bit sRGB (H, W, 3) of linear light (H, W, 3).

    A fixed pattern of less than one step [interleaved gradient noise, Jimenez 2014] is added
    before rounding, so that a gradient shows no bands and a picture is the same every time.
    """
    y, x = np.mgrid[0 : linear.shape[0], 0 : linear.shape[1]]
    noise = np.modf(52.9829189 * np.modf(0.06711056 * x + 0.00583715 * y)[0])[0]
    codes = 255.0 * linear_to_srgb(tone(linear)) + noise[..., None]
    return np.clip(np.floor(codes), 0, 255).astype(np.uint8)


def write_png(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write pixels (H, W, 3) sRGB; the file appears whole or not at all.

    Raises UsageError where the folder does not exist or may not be written.
    """
    partial = path.with_name(f"{path.stem}.partial{path.suffix}")
    try:
        Image.fromarray(pixels).save(partial, format="PNG", optimize=True)
        partial.replace(path)
    except OSError as error:
        raise UsageError(
            f"The image {path} cannot be written: {error.strerror or error}.",
            "choose a folder that exists and is writable, with -o",
        ) from error

"""The surface pass: meshes, ellipsoids, floor and shadows into a linear picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from gf_usd.model import Floats
from gf_usd.scene import Scene
from gf_usd.view import lighting, raster, shading
from gf_usd.view.camera import Lens
from gf_usd.view.light import BOUNCE, SKY, Rig
from gf_usd.view.pack import Packed

OVERSAMPLING = 2  # samples a pixel, each way
KEY_TEXELS = 256  # a side of the depth map of each direction of the key
DOME_TEXELS = 128  # ... of the dome, whose shadows are fainter
FLOOR_TEXELS = 384  # a side of the floor's light map; half of it for the dome
FLOOR_BLUR = 2.5  # [texels] joins the hard shadows of the sampled lights
FAR = np.float32(3e38)

BACKDROP = (0.80, 0.79, 0.775)  # linear, in the middle
BACKDROP_EDGE = (0.50, 0.505, 0.52)  # in the corners


@dataclass(frozen=True, kw_only=True)
class Lit:
    """What a point of the scene can see of its lights."""

    look: NDArray[np.float32]  # (LOOK_SIZE,) see gf_usd.view.lighting
    rig: Rig
    key: NDArray[np.float32]  # (K, S, S) [m] depth map of each direction of the key
    dome: NDArray[np.float32]  # (D, s, s) [m] ... of the dome
    floor: NDArray[np.float32]  # (G, G, 2) key and dome seen by the floor


def light_up(scene: Scene, packed: Packed, rig: Rig) -> Lit:
    """Draw the depth maps of all lights and the light map of the floor."""
    key = _depths(packed, rig.frames[: rig.key_samples], KEY_TEXELS)
    dome = _depths(packed, rig.frames[rig.key_samples :], DOME_TEXELS)
    look = _look(scene, packed, rig)
    floor = np.ones((FLOOR_TEXELS, FLOOR_TEXELS, 2), dtype=np.float32)
    if scene.ground is not None:
        half = np.empty((FLOOR_TEXELS // 2, FLOOR_TEXELS // 2), dtype=np.float32)
        full = np.empty((FLOOR_TEXELS, FLOOR_TEXELS), dtype=np.float32)
        lighting.shade_floor(look, rig.frames, rig.key_samples, key, dome, full, half)
        for layer, light in enumerate((full, half.repeat(2, axis=0).repeat(2, axis=1))):
            floor[..., layer] = gaussian_filter(light, FLOOR_BLUR, mode="nearest")
    return Lit(look=look, rig=rig, key=key, dome=dome, floor=floor)


def _depths(packed: Packed, frames: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(L, size, size) [m] how far each light of frames (L, 10) sees."""
    depth = np.full((len(frames), size, size), FAR, dtype=np.float32)
    if packed.n_triangles:
        raster.shadow_triangles(packed.points, packed.triangles, frames, packed.radius, depth)
    if len(packed.blob_centres):
        raster.shadow_blobs(
            packed.blob_centres, packed.blob_covariances, frames, packed.radius, depth
        )
    return depth


def draw_surfaces(
    packed: Packed, lit: Lit, lens: Lens, oversampling: int = OVERSAMPLING
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Draw everything but the splats.

    Parameters
    ----------
    lens : of the oversampled picture, width and height multiples of `oversampling`.

    Returns
    -------
    colour (H, W, 3) linear, and depth (H, W) [m] behind which each pixel hides everything.
    """
    height, width = lens.height // oversampling, lens.width // oversampling
    key = np.full((lens.height, lens.width), raster.EMPTY, dtype=np.int64)
    clip, camera = lens.clip(packed.points), lens.packed()
    if packed.n_triangles:
        raster.draw_triangles(clip, packed.triangles, lens.near, lens.skew, key)
    if packed.n_ellipsoids:
        raster.draw_ellipsoids(
            packed.centres, packed.inverses, packed.reach, camera, len(packed.triangles), key
        )
    out = np.empty((height, width, 3), dtype=np.float32)
    seen = np.empty((height, width), dtype=np.float32)
    shading.shade(
        key, oversampling, camera,
        clip, packed.triangles, packed.points, packed.normals, packed.colours, packed.uvs,
        packed.finish, packed.skin,
        packed.atlas.texels, packed.atlas.levels, packed.atlas.kinds,
        packed.centres, packed.inverses, packed.tint,
        lit.look, lit.rig.frames, lit.rig.key_samples, lit.key, lit.dome, lit.floor,
        out, seen,
    )  # fmt: skip
    return out, seen


def irradiance(lit: Lit, points: Floats, normals: Floats) -> NDArray[np.float32]:
    """Diffuse light / pi (N, 3) at points (N, 3) [m, from the origin] with unit normals (N, 3)."""
    out = np.zeros((len(points), 3), dtype=np.float32)
    if len(points):
        lighting.shade_points(
            lit.look, lit.rig.frames, lit.rig.key_samples, lit.key, lit.dome, lit.floor,
            np.ascontiguousarray(points, dtype=np.float32),
            np.ascontiguousarray(normals, dtype=np.float32), out,
        )  # fmt: skip
    return out


def _look(scene: Scene, packed: Packed, rig: Rig) -> NDArray[np.float32]:
    """Lights, backdrop and floor as the kernels read them."""
    look = np.zeros(lighting.LOOK_SIZE, dtype=np.float32)
    up, key = np.array(scene.up, dtype=np.float64), np.array(rig.key.direction)

    def put(slot: int, value: Floats | tuple[float, float, float]) -> None:
        look[slot : slot + 3] = value

    put(lighting.UP, up)
    put(lighting.KEY_DIR, key)
    put(lighting.KEY, rig.key.radiance)
    put(lighting.FILL_DIR, rig.fill.direction if rig.fill else up)
    put(lighting.FILL, rig.fill.radiance if rig.fill else (0.0, 0.0, 0.0))
    put(lighting.SKY, SKY)
    put(lighting.BOUNCE, BOUNCE)
    put(lighting.CENTRE, BACKDROP)
    put(lighting.EDGE, BACKDROP_EDGE)
    look[lighting.RADIUS] = packed.radius
    look[lighting.KEY_SPREAD] = np.tan(np.radians(rig.key.angle))

    # the floor's map holds the footprint and the key's shadow, which falls away from the light
    centre_height = float(packed.origin @ up)
    ground = FAR if scene.ground is None else scene.ground - centre_height
    look[lighting.FLOOR] = ground
    slope = max(float(key @ up), 0.1)
    drop = 0.0 if scene.ground is None else max(-float(ground), 0.0)
    shadow = -(key - (key @ up) * up) / slope * drop
    x_axis = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    x_axis = x_axis / np.linalg.norm(x_axis)
    put(lighting.MAP_X, x_axis)
    put(lighting.MAP_Y, np.cross(up, x_axis))
    put(lighting.MAP_O, 0.5 * shadow - drop * up)
    look[lighting.MAP_HALF] = 2.6 * packed.radius + 0.5 * float(np.linalg.norm(shadow))
    return look

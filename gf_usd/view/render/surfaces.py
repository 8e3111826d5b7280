"""The surface pass: draws meshes, ellipsoids, the floor and their shadows in linear light.

Light maps are drawn first: the depth maps of all light directions and the light map of the floor.
A z-buffer of the surfaces follows, and shading resolves it to pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from gf_usd.core.arrays import Floats
from gf_usd.core.scene import Scene
from gf_usd.view.render import lighting, raster, shading
from gf_usd.view.render.camera import PinholeCamera
from gf_usd.view.render.lights import BOUNCE, SKY, LightRig
from gf_usd.view.render.packing import SurfaceArrays

OVERSAMPLING = 2  # samples per pixel along each axis
KEY_TEXELS = 256  # of a side of the shadow map of each direction of the key light
DOME_TEXELS = 128  # ... of the dome, whose shadows are fainter
FLOOR_TEXELS = 384  # of a side of the floor's light map; half of it for the dome
FLOOR_BLUR = 2.5  # [texels] standard deviation; blends the hard shadows of the sampled lights
FAR = np.float32(3e38)  # [m] depth of nothing

BACKDROP = (0.80, 0.79, 0.775)  # linear, in the middle
BACKDROP_EDGE = (0.50, 0.505, 0.52)  # in the corners


@dataclass(frozen=True, kw_only=True)
class LightMaps:
    """Shadow maps of all lights of a scene, and the light map of its floor."""

    uniforms: NDArray[np.float32]  # (UNIFORM_COUNT,) see gf_usd.view.render.lighting
    rig: LightRig
    key_depth: NDArray[np.float32]  # (K, S, S) [m] shadow map of each direction of the key
    dome_depth: NDArray[np.float32]  # (D, s, s) [m] ... of the dome
    floor_light: NDArray[np.float32]  # (G, G, 2) visibility of key and dome on the floor


def draw_light_maps(scene: Scene, packed: SurfaceArrays, rig: LightRig) -> LightMaps:
    """Draw the shadow maps of all lights and the light map of the floor."""
    key = _draw_shadow_maps(packed, rig.frames[: rig.key_samples], KEY_TEXELS)
    dome = _draw_shadow_maps(packed, rig.frames[rig.key_samples :], DOME_TEXELS)
    uniforms = _uniforms(scene, packed, rig)
    floor = np.ones((FLOOR_TEXELS, FLOOR_TEXELS, 2), dtype=np.float32)
    if scene.ground is not None:
        half = np.empty((FLOOR_TEXELS // 2, FLOOR_TEXELS // 2), dtype=np.float32)
        full = np.empty((FLOOR_TEXELS, FLOOR_TEXELS), dtype=np.float32)
        lighting.shade_floor(uniforms, rig.frames, rig.key_samples, key, dome, full, half)
        for layer, light in enumerate((full, half.repeat(2, axis=0).repeat(2, axis=1))):
            floor[..., layer] = gaussian_filter(light, FLOOR_BLUR, mode="nearest")
    return LightMaps(uniforms=uniforms, rig=rig, key_depth=key, dome_depth=dome, floor_light=floor)


def _draw_shadow_maps(
    packed: SurfaceArrays, frames: NDArray[np.float32], size: int
) -> NDArray[np.float32]:
    """Shadow maps (L, size, size) [m] of the light directions `frames` (L, 10)."""
    depth = np.full((len(frames), size, size), FAR, dtype=np.float32)
    if packed.n_triangles:
        raster.shadow_triangles(packed.points, packed.triangles, frames, packed.radius, depth)
    if len(packed.occluder_centers):
        raster.shadow_ellipsoids(
            packed.occluder_centers, packed.occluder_covariances, frames, packed.radius, depth
        )
    return depth


def draw_surfaces(
    packed: SurfaceArrays,
    light_maps: LightMaps,
    pinhole: PinholeCamera,
    oversampling: int = OVERSAMPLING,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Draw everything but the splats.

    Parameters
    ----------
    pinhole : of the oversampled image; width and height are multiples of `oversampling`.

    Returns
    -------
    color (H, W, 3) linear, and depth (H, W) [m] of the surface in each pixel.
    """
    height, width = pinhole.height // oversampling, pinhole.width // oversampling
    zbuffer = np.full((pinhole.height, pinhole.width), raster.EMPTY, dtype=np.int64)
    clip, camera = pinhole.clip(packed.points), pinhole.packed()
    if packed.n_triangles:
        raster.draw_triangles(clip, packed.triangles, pinhole.near, pinhole.skew, zbuffer)
    if packed.n_ellipsoids:
        raster.draw_ellipsoids(
            packed.centers,
            packed.inverses,
            packed.radius_bound,
            camera,
            len(packed.triangles),
            zbuffer,
        )
    color = np.empty((height, width, 3), dtype=np.float32)
    depth = np.empty((height, width), dtype=np.float32)
    shading.shade(
        zbuffer, oversampling, camera,
        clip, packed.triangles, packed.points, packed.normals, packed.colors, packed.uvs,
        packed.roughness_metallic, packed.texture_indices,
        packed.atlas.texels, packed.atlas.levels, packed.atlas.kinds,
        packed.centers, packed.inverses, packed.ellipsoid_colors,
        light_maps.uniforms, light_maps.rig.frames, light_maps.rig.key_samples,
        light_maps.key_depth, light_maps.dome_depth, light_maps.floor_light,
        color, depth,
    )  # fmt: skip
    return color, depth


def irradiance(light_maps: LightMaps, points: Floats, normals: Floats) -> NDArray[np.float32]:
    """Irradiance / pi (N, 3) at points (N, 3) [m, from the origin] with unit normals (N, 3)."""
    color = np.zeros((len(points), 3), dtype=np.float32)
    if len(points):
        lighting.shade_points(
            light_maps.uniforms, light_maps.rig.frames, light_maps.rig.key_samples,
            light_maps.key_depth, light_maps.dome_depth, light_maps.floor_light,
            np.ascontiguousarray(points, dtype=np.float32),
            np.ascontiguousarray(normals, dtype=np.float32), color,
        )  # fmt: skip
    return color


def _uniforms(scene: Scene, packed: SurfaceArrays, rig: LightRig) -> NDArray[np.float32]:
    """Lights, backdrop and floor in the layout of the kernels (offsets in `lighting`)."""
    uniforms = np.zeros(lighting.UNIFORM_COUNT, dtype=np.float32)
    up, key = np.array(scene.up, dtype=np.float64), np.array(rig.key.direction)

    def put(slot: int, value: Floats | tuple[float, float, float]) -> None:
        uniforms[slot : slot + 3] = value

    put(lighting.UP, up)
    put(lighting.KEY_DIR, key)
    put(lighting.KEY, rig.key.radiance)
    put(lighting.FILL_DIR, rig.fill.direction if rig.fill else up)
    put(lighting.FILL, rig.fill.radiance if rig.fill else (0.0, 0.0, 0.0))
    put(lighting.SKY, SKY)
    put(lighting.BOUNCE, BOUNCE)
    put(lighting.CENTER, BACKDROP)
    put(lighting.EDGE, BACKDROP_EDGE)
    uniforms[lighting.RADIUS] = packed.radius
    uniforms[lighting.KEY_SPREAD] = np.tan(np.radians(rig.key.angle))

    # the floor's light map covers the content and its shadow of the key light
    center_height = float(packed.origin @ up)
    ground = FAR if scene.ground is None else scene.ground - center_height
    uniforms[lighting.FLOOR] = ground
    slope = max(float(key @ up), 0.1)
    drop = 0.0 if scene.ground is None else max(-float(ground), 0.0)
    shadow = -(key - (key @ up) * up) / slope * drop
    x_axis = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    x_axis = x_axis / np.linalg.norm(x_axis)
    put(lighting.MAP_X, x_axis)
    put(lighting.MAP_Y, np.cross(up, x_axis))
    put(lighting.MAP_O, 0.5 * shadow - drop * up)
    uniforms[lighting.MAP_HALF] = 2.6 * packed.radius + 0.5 * float(np.linalg.norm(shadow))
    return uniforms

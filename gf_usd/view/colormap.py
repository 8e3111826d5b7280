"""The color map of scalar quantities, and scenes colored by their values.

The map is perceptually uniform: equal differences of the value are equal distances in CIELAB.  It
goes from dark violet over blue, teal and green to light yellow.  Its lightness L* increases
monotonically, so that it is readable in grayscale and with color vision deficiency.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Texture
from gf_usd.core.radiance import linear_to_srgb, srgb_to_linear
from gf_usd.core.scene import RenderMesh, Scene

STEPS = 256  # entries of the map
# sRGB colors equidistant in CIELAB (D65), lightness L* from 28 to 93
STOPS = (
    "433683 394a99 285da9 1f6aab 1b74a8 1a7fa5 188ca4 1699a3 25a6a0"
    " 3db199 54bb90 6ac486 7fcd7c 98d572 b0db68 c8e15e e1e755 feee54"
)
ROUGHNESS = 0.9  # of colored surfaces: highlights would look like high values


@cache
def color_map() -> NDArray[np.floating]:
    """The color map (256, 3), linear Rec. 709, interpolated from `STOPS`; read-only."""
    stops = np.array([list(bytes.fromhex(stop)) for stop in STOPS.split()]) / 255.0
    positions, entries = np.linspace(0.0, 1.0, STEPS), np.linspace(0.0, 1.0, len(stops))
    return srgb_to_linear(
        np.stack([np.interp(positions, entries, channel) for channel in stops.T], axis=1)
    )


def fraction(values: Floats, low: float, high: float) -> NDArray[np.float64]:
    """(values - low) / (high - low), clamped to 0..1; 0 for values that are not finite."""
    span = high - low if high > low else 1.0
    return np.clip(np.nan_to_num((np.asarray(values) - low) / span, nan=0.0), 0.0, 1.0)


def colors(values: Floats, low: float, high: float) -> NDArray[np.float64]:
    """Linear colors (..., 3) of values (...)."""
    positions = fraction(values, low, high) * (STEPS - 1)
    return np.stack(
        [np.interp(positions, np.arange(STEPS), channel) for channel in color_map().T], axis=-1
    )


@cache
def _color_map_texture() -> Texture:
    codes = np.round(255.0 * linear_to_srgb(color_map())).astype(np.uint8)
    return Texture(pixels=codes[None], srgb=True, wrap_s="clamp", wrap_t="clamp")


def color_by_value(scene: Scene, low: float, high: float) -> Scene:
    """The scene with matt colors by value; prims without values are unchanged.

    Meshes get the color map as a texture and the value as its coordinate, so that values, not
    colors, are interpolated between vertices.
    """
    return replace(
        scene,
        meshes=tuple(_color_mesh_by_value(mesh, low, high) for mesh in scene.meshes),
        splats=tuple(
            cloud
            if cloud.values is None
            else replace(cloud, colors=colors(cloud.values, low, high), harmonics=None)
            for cloud in scene.splats
        ),
        ellipsoids=tuple(
            cloud
            if cloud.values is None
            else replace(cloud, colors=colors(cloud.values, low, high))
            for cloud in scene.ellipsoids
        ),
    )


def _color_mesh_by_value(mesh: RenderMesh, low: float, high: float) -> RenderMesh:
    if mesh.values is None:
        return mesh
    count = len(mesh.triangles)
    # texel centers: 0 is that of the first, 1 that of the last
    u = (0.5 + fraction(mesh.values, low, high) * (STEPS - 1)) / STEPS
    uvs = np.full((count, 3, 2), 0.5)
    uvs[..., 0] = u[np.asarray(mesh.triangles)]
    return replace(
        mesh,
        uvs=uvs,
        textures=(_color_map_texture(),),
        triangle_textures=np.zeros(count, dtype=np.int32),
        roughness=np.array(ROUGHNESS),
        metallic=np.array(0.0),
    )

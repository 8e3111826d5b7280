"""Numbers as colours: a ramp of even perceptual steps, and scenes painted with it.

The ramp is a curve through CIELAB (D65) from dark violet over blue, teal and green to light
yellow.  It is walked at constant speed, so that equal differences of the number are equal colour
differences, and its lightness L* rises all the way: it reads the same in grey and to a
colour-blind eye.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gf_usd.colour import linear_to_srgb
from gf_usd.model import Floats, Texture
from gf_usd.scene import RenderMesh, Scene

STEPS = 256
# lightness, chroma and hue [deg] in CIELAB that the curve passes through
STOPS = np.array(
    [
        (28.0, 50.0, 303.0),
        (40.0, 47.0, 282.0),
        (50.0, 31.0, 242.0),
        (63.0, 36.0, 186.0),
        (76.0, 52.0, 140.0),
        (87.0, 68.0, 110.0),
        (93.0, 74.0, 99.0),
    ]
)
# CIE 1931 XYZ of a CIELAB white, and linear Rec. 709 of XYZ (IEC 61966-2-1)
WHITE = np.array([0.95047, 1.0, 1.08883])
XYZ_OF_RGB = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
MATT = 0.9  # roughness of what is painted: a highlight would read as a high value


def lab_to_linear(lab: Floats) -> NDArray[np.float64]:
    """Linear Rec. 709 (..., 3) of CIELAB (..., 3), D65; may leave 0..1."""
    lab = np.asarray(lab, dtype=np.float64)
    y = (lab[..., 0] + 16.0) / 116.0
    f = np.stack([y + lab[..., 1] / 500.0, y, y - lab[..., 2] / 200.0], axis=-1)
    small = 3.0 * (6.0 / 29.0) ** 2 * (f - 4.0 / 29.0)
    xyz = WHITE * np.where(f > 6.0 / 29.0, f**3, small)
    return xyz @ np.linalg.inv(XYZ_OF_RGB).T


@cache
def ramp() -> NDArray[np.float64]:
    """(256, 3) linear Rec. 709, low to high.  Do not write to it."""
    hue = np.radians(STOPS[:, 2])
    lab = np.stack([STOPS[:, 0], STOPS[:, 1] * np.cos(hue), STOPS[:, 1] * np.sin(hue)], axis=1)
    # a Catmull-Rom curve through the stops, then even steps along its length
    padded = np.concatenate([2 * lab[:1] - lab[1:2], lab, 2 * lab[-1:] - lab[-2:-1]])
    t = np.linspace(0.0, 1.0, 64, endpoint=False)[:, None]
    pieces = [_catmull_rom(padded[i : i + 4], t) for i in range(len(lab) - 1)]
    curve = np.concatenate([*pieces, lab[-1:]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    even = np.linspace(0.0, length[-1], STEPS)
    walked = np.stack([np.interp(even, length, channel) for channel in curve.T], axis=1)
    return np.clip(lab_to_linear(walked), 0.0, 1.0)


def _catmull_rom(p: Floats, t: Floats) -> Floats:
    """Points (n, 3) between p[1] and p[2] of four (4, 3), t (n, 1) in 0..1."""
    a, b, c, d = p
    return b + 0.5 * t * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)))


def fraction(values: Floats, low: float, high: float) -> NDArray[np.float64]:
    """Where values lie in low..high, held to 0..1; 0 for those that are not finite."""
    span = high - low if high > low else 1.0
    return np.clip(np.nan_to_num((np.asarray(values) - low) / span, nan=0.0), 0.0, 1.0)


def colours(values: Floats, low: float, high: float) -> NDArray[np.float64]:
    """Linear colours (..., 3) of values (...)."""
    at = fraction(values, low, high) * (STEPS - 1)
    return np.stack([np.interp(at, np.arange(STEPS), channel) for channel in ramp().T], axis=-1)


@cache
def _texture() -> Texture:
    codes = np.round(255.0 * linear_to_srgb(ramp())).astype(np.uint8)
    return Texture(pixels=codes[None], srgb=True, wrap_s="clamp", wrap_t="clamp")


def paint(scene: Scene, low: float, high: float) -> Scene:
    """The scene with all that has values coloured by them, matt; the rest as it was.

    Meshes carry the ramp as a texture whose coordinate is the value, so that between vertices it
    is the value that is interpolated and not the colour.
    """
    return replace(
        scene,
        meshes=tuple(_paint_mesh(mesh, low, high) for mesh in scene.meshes),
        splats=tuple(
            cloud
            if cloud.values is None
            else replace(cloud, colours=colours(cloud.values, low, high), harmonics=None)
            for cloud in scene.splats
        ),
        ellipsoids=tuple(
            cloud
            if cloud.values is None
            else replace(cloud, colours=colours(cloud.values, low, high))
            for cloud in scene.ellipsoids
        ),
    )


def _paint_mesh(mesh: RenderMesh, low: float, high: float) -> RenderMesh:
    if mesh.values is None:
        return mesh
    count = len(mesh.triangles)
    # from the middle of the first texel to that of the last
    u = (0.5 + fraction(mesh.values, low, high) * (STEPS - 1)) / STEPS
    uvs = np.full((count, 3, 2), 0.5)
    uvs[..., 0] = u[np.asarray(mesh.triangles)]
    return replace(
        mesh,
        uvs=uvs,
        textures=(_texture(),),
        triangle_textures=np.zeros(count, dtype=np.int32),
        roughness=np.array(MATT),
        metallic=np.array(0.0),
    )

"""The studio: a key light, a rim light and a dome, and the directions from which they shine.

Soft shadows come from many hard ones.  The key is a disc of directions, the dome a sphere of
them; each direction has a depth map, and the part of them that a point sees is its light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import UsageError
from gf_usd.core.matrices import across
from gf_usd.core.scene import Light

KEY_SAMPLES = 32
DOME_ABOVE = 64
DOME_BELOW = 16
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))

SKY = (0.40, 0.42, 0.46)  # irradiance / pi on a surface that faces up
BOUNCE = (0.26, 0.25, 0.24)  # on one that faces down, from a lit floor


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Lights as the shading kernels read them."""

    key: Light  # the one whose shadow is drawn
    fill: Light | None  # the other, without a cast shadow
    frames: NDArray[np.float32]  # (L, 10) right, up, to the light, weight; the key's come first
    key_samples: int


def studio(view: Floats, up: Floats) -> tuple[Light, Light]:
    """Key and rim light that suit a camera in direction `view` (3,) from the scene.

    The key stands to the left of the camera and above it, warm and broad; the rim behind the
    subject on the other side, cool.
    """
    flat = view - np.dot(view, up) * up
    # a camera straight above has no left: any horizontal direction serves
    if np.linalg.norm(flat) < 1e-6:
        flat = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    flat = flat / np.linalg.norm(flat)
    right = np.cross(up, flat)

    def towards(azimuth: float, elevation: float) -> tuple[float, float, float]:
        a, e = np.radians(azimuth), np.radians(elevation)
        d = np.cos(e) * (np.cos(a) * flat + np.sin(a) * right) + np.sin(e) * up
        return float(d[0]), float(d[1]), float(d[2])

    key = Light(direction=towards(-48.0, 50.0), radiance=(0.95, 0.91, 0.85), angle=9.0)
    rim = Light(
        direction=towards(148.0, 32.0), radiance=(0.34, 0.38, 0.44), angle=12.0, shadows=False
    )
    return key, rim


def make_rig(lights: tuple[Light, ...], view: Floats, up: Floats) -> Rig:
    """Resolve the lights of a scene; the first that casts shadows becomes the key.

    Raises UsageError for more than two lights.
    """
    lights = lights or studio(view, up)
    if len(lights) > 2:
        raise UsageError(
            f"An image can have a key light and a fill light, but the scene has {len(lights)} "
            f"lights.",
            "leave out the weaker ones: the dome light replaces them",
        )
    casting = [light for light in lights if light.shadows] or list(lights)
    key = casting[0]
    directions = np.concatenate([_disc(np.array(key.direction), key.angle), _sphere(up)])
    # a cosine-weighted direction stands for a solid angle of 1 / cosine; held near the horizon
    height = np.abs(directions @ up)
    return Rig(
        key=key,
        fill=next((light for light in lights if light is not key), None),
        frames=_frames(directions, 1.0 / (height + 0.1)),
        key_samples=KEY_SAMPLES,
    )


def _disc(direction: Floats, angle: float) -> Floats:
    """(K, 3) directions that fill a cone of half `angle` [deg] evenly: a sunflower."""
    i = np.arange(KEY_SAMPLES)
    radius = np.tan(np.radians(angle)) * np.sqrt((i + 0.5) / KEY_SAMPLES)
    u, v = across(direction)
    turn = i * GOLDEN_ANGLE
    rays = direction + radius[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _sphere(up: Floats) -> Floats:
    """(K, 3) directions of the dome: cosine-weighted above the horizon, sparser below it.

    Both halves are Fibonacci lattices about `up`.
    """
    i, j = np.arange(DOME_ABOVE), np.arange(DOME_BELOW)
    height = np.concatenate(
        [np.sqrt(1.0 - (i + 0.5) / DOME_ABOVE), -np.sqrt(1.0 - (j + 0.5) / DOME_BELOW)]
    )
    ring = np.sqrt(1.0 - height**2)
    u, v = across(up)
    turn = np.concatenate([i, j]) * GOLDEN_ANGLE
    return (
        ring[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
        + height[:, None] * up
    )


def _frames(directions: Floats, weights: Floats) -> NDArray[np.float32]:
    """(L, 10) axes and weight of each map, turned so that the maps' grids do not align."""
    frames = np.empty((len(directions), 10), dtype=np.float32)
    for i, d in enumerate(directions):
        u, v = across(d)
        c, s = np.cos(i * GOLDEN_ANGLE), np.sin(i * GOLDEN_ANGLE)
        frames[i] = np.concatenate([c * u + s * v, c * v - s * u, d, weights[i : i + 1]])
    return frames

"""The light rig: a key light, a rim or fill light and a dome, sampled by directions.

Soft shadows are the mean of hard ones.  The key light is sampled by directions in a cone, the dome
by directions on a sphere.  Each direction has a shadow map; the visibility of a light at a point is
the fraction of its directions that are not occluded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, triple
from gf_usd.core.errors import UsageError
from gf_usd.core.matrices import across
from gf_usd.core.scene import Light

KEY_SAMPLES = 32
DOME_ABOVE = 64
DOME_BELOW = 16
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))

SKY = (0.40, 0.42, 0.46)  # irradiance / pi of a surface that faces up
BOUNCE = (0.26, 0.25, 0.24)  # of one that faces down, from the unoccluded floor


@dataclass(frozen=True, kw_only=True)
class LightRig:
    """The lights of a scene and their sampled directions."""

    key: Light  # casts shadows
    fill: Light | None  # casts none
    frames: NDArray[np.float32]  # (L, 10) right, up, to the light, weight; those of the key first
    key_samples: int  # directions of the key


def studio(view: Floats, up: Floats) -> tuple[Light, Light]:
    """Default key and rim lights for a camera in unit direction `view` (3,) from the scene.

    The key light is warm and large, above the camera and to its left; the rim light is cool, behind
    the subject on the other side.
    """
    horizontal = view - np.dot(view, up) * up
    # the left of a camera straight above is undefined: any horizontal direction will do
    if np.linalg.norm(horizontal) < 1e-6:
        horizontal = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    horizontal = horizontal / np.linalg.norm(horizontal)
    right = np.cross(up, horizontal)

    def towards(azimuth: float, elevation: float) -> tuple[float, float, float]:
        a, e = np.radians(azimuth), np.radians(elevation)
        d = np.cos(e) * (np.cos(a) * horizontal + np.sin(a) * right) + np.sin(e) * up
        return float(d[0]), float(d[1]), float(d[2])

    key = Light(direction=towards(-48.0, 50.0), radiance=(0.95, 0.91, 0.85), angle=9.0)
    rim = Light(
        direction=towards(148.0, 32.0), radiance=(0.34, 0.38, 0.44), angle=12.0, shadows=False
    )
    return key, rim


def make_light_rig(lights: tuple[Light, ...], view: Floats, up: Floats) -> LightRig:
    """Sample the lights of a scene, or `studio` lights; the first that casts shadows is the key.

    Raises UsageError for more than two lights.
    """
    lights = lights or studio(view, up)
    if len(lights) > 2:
        raise UsageError(
            f"an image can have a key light and a fill light, but the scene has {len(lights)} "
            f"lights",
            "leave out the weaker ones: the dome light replaces them",
        )
    casting = [light for light in lights if light.shadows] or list(lights)
    key = casting[0]
    return LightRig(
        key=key,
        fill=next((light for light in lights if light is not key), None),
        frames=_sampled(triple(key.direction), key.angle, triple(up)),
        key_samples=KEY_SAMPLES,
    )


@lru_cache(maxsize=1)  # the lights of a film stand still
def _sampled(
    direction: tuple[float, float, float], angle: float, up: tuple[float, float, float]
) -> NDArray[np.float32]:
    """`LightRig.frames` of a key light of half-angle `angle` [deg], and of the dome."""
    upward = np.array(up)
    directions = np.concatenate(
        [_cone_directions(np.array(direction), angle), _dome_directions(upward)]
    )
    # a cosine-weighted direction has a solid angle of 1 / cosine; bounded near the horizon
    height = np.abs(directions @ upward)
    frames = _light_axes(directions, 1.0 / (height + 0.1))
    frames.setflags(write=False)
    return frames


def _cone_directions(direction: Floats, angle: float) -> Floats:
    """Evenly distributed directions (K, 3) in a cone of half-angle `angle` [deg] (Vogel spiral)."""
    i = np.arange(KEY_SAMPLES)
    radius = np.tan(np.radians(angle)) * np.sqrt((i + 0.5) / KEY_SAMPLES)
    u, v = across(direction)
    angle_around = i * GOLDEN_ANGLE
    rays = direction + radius[:, None] * (
        np.cos(angle_around)[:, None] * u + np.sin(angle_around)[:, None] * v
    )
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _dome_directions(up: Floats) -> Floats:
    """Directions (K, 3) of the dome: cosine-weighted, with fewer samples below the horizon.

    Both hemispheres are Fibonacci lattices about `up`.
    """
    i, j = np.arange(DOME_ABOVE), np.arange(DOME_BELOW)
    height = np.concatenate(
        [np.sqrt(1.0 - (i + 0.5) / DOME_ABOVE), -np.sqrt(1.0 - (j + 0.5) / DOME_BELOW)]
    )
    ring = np.sqrt(1.0 - height**2)
    u, v = across(up)
    angle_around = np.concatenate([i, j]) * GOLDEN_ANGLE
    return (
        ring[:, None] * (np.cos(angle_around)[:, None] * u + np.sin(angle_around)[:, None] * v)
        + height[:, None] * up
    )


def _light_axes(directions: Floats, weights: Floats) -> NDArray[np.float32]:
    """Axes and weight (L, 10) of each shadow map, rotated so that the texel grids do not align."""
    frames = np.empty((len(directions), 10), dtype=np.float32)
    for i, d in enumerate(directions):
        u, v = across(d)
        c, s = np.cos(i * GOLDEN_ANGLE), np.sin(i * GOLDEN_ANGLE)
        frames[i] = np.concatenate([c * u + s * v, c * v - s * u, d, weights[i : i + 1]])
    return frames

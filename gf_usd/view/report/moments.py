"""The frames worth a picture: where it starts, touches, is squashed, rebounds and ends."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gf_usd.core.scene import Camera, MotionFrame, Recording, RenderEllipsoids, Scene
from gf_usd.view.render.camera import fit_camera
from gf_usd.view.render.render import render
from gf_usd.view.report.motion import Motion

PICTURES = 6
SIZE = (400, 300)  # pixels: sharp at 200 wide on a fine screen
QUALITY = 82
TOUCHING = 0.02  # of the body's height above the floor
FLYING = 0.05  # of the body's height above the floor


def moments(motion: Motion, most: int = PICTURES) -> list[tuple[int, str]]:
    """(frame of the page, words) of up to `most` frames, in order."""
    last = len(motion.time_codes) - 1
    named = {0: "start", **_bounce(motion)}
    named.setdefault(last, "end")
    while len(named) < min(most, last + 1):
        # the middle of the longest stretch without a picture
        there = sorted(named)
        gap = int(np.argmax(np.diff(there)))
        named[(there[gap] + there[gap + 1]) // 2] = ""
    return sorted(named.items())[:most]


def _bounce(motion: Motion) -> dict[int, str]:
    """The frames at which the body first touches the floor, is squashed, and flies highest after.

    Flattest is where its height stops falling; it flies where its lowest point is clear of the
    floor.  Nothing where it starts on the floor, or never comes to it.
    """
    low, high = (np.array(motion.curves.get(name, ())) for name in ("lowest", "highest"))
    ground = motion.recording.ground
    if ground is None or len(low) != len(motion.time_codes) or len(high) != len(low):
        return {}
    height = high - low
    touching = low <= ground + TOUCHING * height[0]
    if touching[0] or not touching.any():
        return {}
    touch = int(np.argmax(touching))
    flat = _first_turn(height, touch)
    found = {touch: "contact", flat: "squashed"} if flat > touch else {touch: "contact"}
    flying = np.flatnonzero(low[flat:] > ground + FLYING * height[0])
    if len(flying):
        apex = _first_turn(-low, flat + int(flying[0]))
        found.setdefault(apex, "rebound")
    return found


def _first_turn(values: NDArray[np.float64], start: int) -> int:
    """The first place from `start` on after which values do not fall."""
    rises = np.flatnonzero(np.diff(values[start:]) >= 0.0)
    return start + int(rises[0]) if len(rises) else len(values) - 1


def pictures(
    recording: Recording, frames: Iterable[MotionFrame], camera: Camera | None
) -> list[str]:
    """A data URI of a JPEG for each frame."""
    return [_uri(_scene(recording, frame), camera) for frame in frames]


def camera_for(motion: Motion) -> Camera:
    """A camera that has the whole motion in its picture."""
    low, high = bounds(motion)
    corners = [[(low, high)[b][i] for i, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)]
    up = motion.recording.up
    return fit_camera(np.array(corners), up, SIZE[0] / SIZE[1], margin=0.06)


def bounds(motion: Motion) -> tuple[Sequence[float], Sequence[float]]:
    """Low and high corner [m] of all that moves, over all frames."""
    points = np.concatenate([motion.points.reshape(-1, 3), motion.positions.reshape(-1, 3)])
    if motion.flow is not None:
        points = np.concatenate([points, motion.flow.points])
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


def _scene(recording: Recording, frame: MotionFrame) -> Scene:
    meshes = tuple(
        # the authored normals are those of the first frame
        replace(mesh, points=points, normals=None)
        for mesh, points in zip(recording.meshes, frame.meshes)
    )
    meshes += frame.flows
    solid: tuple[RenderEllipsoids, ...] = ()
    cloud = recording.gaussians
    if not meshes and cloud and frame.positions is not None and frame.axes is not None:
        solid = (
            RenderEllipsoids(
                name=cloud.name,
                positions=frame.positions,
                axes=frame.axes,
                colors=cloud.colors,
            ),
        )
    return Scene(up=recording.up, meshes=meshes, ellipsoids=solid, ground=recording.ground)


def _uri(scene: Scene, camera: Camera | None) -> str:
    data = io.BytesIO()
    Image.fromarray(render(scene, camera, SIZE)).save(data, "JPEG", quality=QUALITY)
    return "data:image/jpeg;base64," + base64.b64encode(data.getvalue()).decode("ascii")

"""Key frames of a motion and their pictures: start, contact, squash, rebound and end."""

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
SIZE = (400, 300)  # [pixels] displayed at half of it, for high-density screens
QUALITY = 82  # of JPEG
TOUCHING = 0.02  # largest gap to the floor in contact, as a fraction of the body's height
FLYING = 0.05  # smallest gap to the floor in flight, likewise


def choose_key_frames(motion: Motion, most: int = PICTURES) -> list[tuple[int, str]]:
    """Up to `most` key frames (index, label) in order, until all that moves has left pictures."""
    end = motion.recording.shown_until
    last = sum(end is None or code <= end for code in motion.time_codes) - 1
    labels = {0: "start", **{k: what for k, what in _find_bounce(motion).items() if k <= last}}
    labels.setdefault(last, "end" if last + 1 == len(motion.time_codes) else "")
    while len(labels) < min(most, last + 1):
        # the middle of the longest interval without a picture
        frames = sorted(labels)
        gap = int(np.argmax(np.diff(frames)))
        labels[(frames[gap] + frames[gap + 1]) // 2] = ""
    return sorted(labels.items())[:most]


def _find_bounce(motion: Motion) -> dict[int, str]:
    """Frames and labels of the first contact with the floor, the squash and the apex after it.

    The squash is the first local minimum of the body's height after contact.  The body flies where
    its lowest point is above the floor by FLYING.  Empty where it starts on the floor or never
    reaches it.
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
    squash = _first_minimum(height, touch)
    labels = {touch: "contact", squash: "squashed"} if squash > touch else {touch: "contact"}
    flying = np.flatnonzero(low[squash:] > ground + FLYING * height[0])
    if len(flying):
        apex = _first_minimum(-low, squash + int(flying[0]))
        labels.setdefault(apex, "rebound")
    return labels


def _first_minimum(values: NDArray[np.float64], start: int) -> int:
    """Index of the first local minimum from `start` on."""
    rises = np.flatnonzero(np.diff(values[start:]) >= 0.0)
    return start + int(rises[0]) if len(rises) else len(values) - 1


def render_pictures(
    recording: Recording, frames: Iterable[MotionFrame], camera: Camera | None
) -> list[str]:
    """Render each frame to a JPEG, as a data URI."""
    return [_render_data_uri(scene_of(recording, frame), camera) for frame in frames]


def camera_for(motion: Motion) -> Camera:
    """A camera for pictures of any frame."""
    low, high = bounds(motion)
    corners = [[(low, high)[b][i] for i, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)]
    up = motion.recording.up
    return fit_camera(np.array(corners), up, SIZE[0] / SIZE[1], margin=0.06)


def bounds(motion: Motion) -> tuple[Sequence[float], Sequence[float]]:
    """Low and high corner [m] of what pictures contain: the box of all frames, unless the recording
    has another.
    """
    if (framed := motion.recording.framed) is not None:
        return framed.low, framed.high
    points = np.concatenate([motion.points.reshape(-1, 3), motion.positions.reshape(-1, 3)])
    if motion.flow is not None:
        points = np.concatenate([points, motion.flow.points])
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


def scene_of(recording: Recording, frame: MotionFrame) -> Scene:
    """The meshes of a frame, and its Gaussians where none of these meshes is a body."""
    meshes = tuple(
        # recorded normals are valid in the first frame only
        replace(mesh, points=points, normals=None)
        for mesh, points in zip(recording.meshes, frame.meshes)
    )
    meshes += frame.flows
    ellipsoids: tuple[RenderEllipsoids, ...] = ()
    cloud = recording.gaussians
    body = frame.flows or any(recording.baked)
    if not body and cloud and frame.positions is not None and frame.axes is not None:
        ellipsoids = (
            RenderEllipsoids(
                name=cloud.name,
                positions=frame.positions,
                axes=frame.axes,
                colors=cloud.colors,
            ),
        )
    return Scene(up=recording.up, meshes=meshes, ellipsoids=ellipsoids, ground=recording.ground)


def _render_data_uri(scene: Scene, camera: Camera | None) -> str:
    data = io.BytesIO()
    Image.fromarray(render(scene, camera, SIZE)).save(data, "JPEG", quality=QUALITY)
    return "data:image/jpeg;base64," + base64.b64encode(data.getvalue()).decode("ascii")

"""Whether obstacles hide the bodies of a bake from a camera, and a view from which they do not."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.scene import Camera, Scene
from gf_usd.system.taichi_runtime import ensure_taichi
from gf_usd.view.render import raster
from gf_usd.view.render.camera import AZIMUTH, ELEVATION, pinhole_camera

HEIGHT = 120  # [pixels] of the depth map in which points are looked up
DEPTH_MARGIN = 2e-3  # of the distance to the camera: a point that touches an obstacle is not hidden
HIDDEN = 0.25  # share of the points in front of all obstacles, below which a body counts as hidden
NEARLY = 0.9  # of the share that the best view sees
# (azimuth, elevation) [deg] of the views that are tried, the usual one first
VIEWS = tuple(
    (azimuth, elevation)
    for elevation in (ELEVATION, 45.0)
    for azimuth in (AZIMUTH, -AZIMUTH, 180.0 - AZIMUTH, AZIMUTH - 180.0)
) + ((AZIMUTH, 75.0),)


@dataclass(frozen=True, kw_only=True)
class Occluded:
    """One frame: points of the bodies, and what can be in front of them."""

    points: Floats  # (n, 3) [m]
    corners: Floats  # (V, 3) [m] of obstacles
    triangles: NDArray[np.int32]  # (T, 3)

    @classmethod
    def of_scene(cls, scene: Scene, bodies: Collection[str], obstacles: Collection[str]):
        """The frame of a scene, with the prim paths of its bodies and obstacles."""
        clouds = (*scene.splats, *scene.ellipsoids)
        points = [mesh.points for mesh in scene.meshes if mesh.name in bodies]
        points += [cloud.positions for cloud in clouds if cloud.name in bodies]
        hiding = [m for m in scene.meshes if m.name in obstacles and len(m.triangles)]
        first = np.cumsum([0, *(len(mesh.points) for mesh in hiding)])
        triangles = [mesh.triangles + base for mesh, base in zip(hiding, first)]
        return cls(
            points=np.concatenate([np.zeros((0, 3)), *points]),
            corners=np.concatenate([np.zeros((0, 3)), *(mesh.points for mesh in hiding)]),
            triangles=np.concatenate([np.zeros((0, 3), np.int32), *triangles]).astype(np.int32),
        )

    def seen_share(self, camera: Camera, aspect: float) -> float:
        """The share of the points in the picture that are in front of all obstacles.

        NaN where no point is in the picture.
        """
        width = max(1, round(aspect * HEIGHT))
        origin = self.points.mean(axis=0) if len(self.points) else np.zeros(3)
        pinhole = pinhole_camera(camera, width, HEIGHT, origin)
        x, y, depth = pinhole.clip(self.points - origin).T
        ahead = depth > pinhole.near
        column = np.floor(x / np.where(ahead, depth, 1.0)).astype(int)
        row = np.floor(y / np.where(ahead, depth, 1.0)).astype(int)
        inside = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < HEIGHT)
        if not inside.any():
            return float("nan")
        if not len(self.triangles):
            return 1.0
        ensure_taichi()
        zbuffer = np.full((HEIGHT, width), raster.EMPTY, dtype=np.int64)
        clip = pinhole.clip(self.corners - origin)
        raster.draw_triangles(clip, self.triangles, pinhole.near, pinhole.skew, zbuffer)
        bits = (zbuffer[row[inside], column[inside]] >> 32).astype(np.int32)
        nearest = np.where(bits == raster.EMPTY_BITS, np.inf, bits.view(np.float32))
        return float((depth[inside] <= nearest * (1.0 + DEPTH_MARGIN)).mean())


def hidden_frames(shares: Sequence[float]) -> int:
    """The number of frames in which too small a share of the bodies is seen, or none is there."""
    return sum(not share >= HIDDEN for share in shares)


def mostly_hidden(shares: Sequence[float]) -> bool:
    """Whether bodies are hidden in more than half of the frames."""
    return 2 * hidden_frames(shares) > len(shares)


def best_view(
    frames: Sequence[Occluded], cameras: Sequence[Camera], aspect: float
) -> tuple[int, list[float]]:
    """Index of the camera to use, and the shares of the bodies that it sees (frames,).

    The first camera is kept unless it does not see the bodies in more than half of the frames.
    Then it is the first that sees NEARLY as much as the best one.  Frames in which no body is in
    the picture of the first do not count.
    """
    found = [[frame.seen_share(cameras[0], aspect) for frame in frames]]
    counted = [not np.isnan(share) for share in found[0]]
    kept = [frame for frame, counts in zip(frames, counted) if counts]
    found[0] = [share for share in found[0] if share == share]
    if not kept or not mostly_hidden(found[0]):
        return 0, found[0]
    for camera in cameras[1:]:
        found.append([frame.seen_share(camera, aspect) for frame in kept])
    means = np.array([np.nan_to_num(shares).mean() for shares in found])
    best = int(np.argmax(means >= NEARLY * means.max()))
    best = 0 if mostly_hidden(found[best]) else best
    return best, found[best]

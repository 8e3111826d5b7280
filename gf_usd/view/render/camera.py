"""Pinhole cameras: projection to image coordinates, and cameras that frame a whole motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, triple
from gf_usd.core.errors import UsageError
from gf_usd.core.scene import Camera

AZIMUTH = 32.0  # [deg] to the right of the front: a three-quarter view
ELEVATION = 16.0  # [deg] above the horizon
NEAR = 1e-4  # depth of the near plane, as a fraction of the distance to the target


@dataclass(frozen=True, kw_only=True)
class PinholeCamera:
    """Intrinsics and extrinsics of a camera for width x height samples, relative to an origin."""

    origin: NDArray[np.float64]  # (3,) [m] subtracted from all positions, to limit cancellation
    eye: NDArray[np.float64]  # (3,) [m] from the origin
    axes: NDArray[np.float64]  # (3, 3) rows right, up, forward; orthonormal
    focal: float  # [samples]
    width: int
    height: int
    near: float  # [m]
    center: tuple[float, float]  # [samples] principal point
    skew: float = 0.0  # [samples] see `raster.sample_position`

    def clip(self, points: Floats) -> NDArray[np.float64]:
        """Homogeneous image coordinates (V, 3) = (X, Y, w) of points (V, 3) [m, from the origin].

        w is the depth [m]; X / w [samples] increases to the right and Y / w downward, and sample
        centers are at half-integers.
        """
        x, y, w = self.axes @ (np.asarray(points, dtype=np.float64) - self.eye).T
        across = self.focal * x + self.center[0] * w
        down = self.center[1] * w - self.focal * y
        return np.ascontiguousarray(np.stack([across, down, w], axis=1))

    def packed(self) -> NDArray[np.float64]:
        """(17,) eye, right, up, forward, focal, center x and y, near, skew: the kernels' layout."""
        rest = (self.focal, *self.center, self.near, self.skew)
        return np.concatenate([self.eye, self.axes.ravel(), rest])


def pinhole_camera(
    camera: Camera, width: int, height: int, origin: Floats, oversampling: int = 1
) -> PinholeCamera:
    """Resolve a camera for an image of width x height pixels, n x n samples each.

    Parameters
    ----------
    origin : (3,) [m].   oversampling : n.

    Raises UsageError for an undefined direction: eye at the target, or up parallel to the view.
    """
    eye, target = np.array(camera.eye, dtype=np.float64), np.array(camera.target)
    forward = target - eye
    distance = float(np.linalg.norm(forward))
    right = np.cross(forward, np.array(camera.up, dtype=np.float64))
    if not np.linalg.norm(right) > 1e-9 * distance > 0.0:
        raise UsageError(
            f"the camera at {camera.eye} looking at {camera.target} with up {camera.up} "
            "has no direction",
            "move it away from its target, and choose an up vector that is not parallel to the "
            "view",
        )
    forward = forward / distance
    right = right / np.linalg.norm(right)
    width, height = oversampling * width, oversampling * height
    focal = 0.5 * height / float(np.tan(np.radians(camera.fov) / 2.0))
    return PinholeCamera(
        origin=np.array(origin, dtype=np.float64),
        eye=eye - origin,
        axes=np.stack([right, np.cross(right, forward), forward]),
        focal=focal,
        width=width,
        height=height,
        center=(0.5 * width - focal * camera.shift[0], 0.5 * height + focal * camera.shift[1]),
        near=NEAR * distance,
        skew=0.25 if oversampling == 2 else 0.0,
    )


def view_direction(up: Floats, azimuth: float = AZIMUTH, elevation: float = ELEVATION) -> Floats:
    """Unit vector (3,) from the scene to a camera at azimuth and elevation [deg].

    Azimuth 0 is the front of an asset: +Z where Y is up, -Y where Z is up.
    """
    front, right = _front_and_right(np.array(up, dtype=np.float64))
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.cos(e) * (np.cos(a) * front + np.sin(a) * right) + np.sin(e) * np.array(up)


def fit_camera(
    points: Floats,
    up: tuple[float, float, float],
    aspect: float,
    *,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    fov: float = 30.0,
    margin: float = 0.12,
) -> Camera:
    """The nearest camera of a given direction whose view frustum contains all points.

    With t the tangent of half the field of view and (x, y, z) the points along right, up and
    forward, a camera at depth -d and offset c contains them where |x - c| <= t (d + z), so
    c = (max(x - t z) + min(x + t z)) / 2 and d = (max(x - t z) - min(x + t z)) / 2t; likewise y.

    Parameters
    ----------
    points : (K, 3) [m], e.g. the corners of the motion's bounds.
    up : unit.   aspect : width / height.   fov : [deg] vertical.
    margin : fraction of the image's half width and height to leave free.
    """
    points = np.asarray(points, dtype=np.float64)
    out = view_direction(np.array(up), azimuth, elevation)
    right = np.cross(np.array(up), out)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(out, right), -out])
    middle = points.mean(axis=0)
    x, y, z = axes @ (points - middle).T
    slope = (1.0 - margin) * np.tan(np.radians(fov) / 2.0)
    across, back_x = _fit_frustum(x, z, slope * aspect)
    upward, back_y = _fit_frustum(y, z, slope)
    # for a single point any distance will do
    back = max(back_x, back_y) or 1.0
    eye = middle + axes.T @ np.array([across, upward, -back])
    target = middle + axes.T @ np.array([across, upward, 0.0])
    return Camera(eye=triple(eye), target=triple(target), up=up, fov=fov)


def _fit_frustum(x: Floats, z: Floats, slope: float) -> tuple[float, float]:
    """Offset c and distance d of the nearest frustum, |x - c| <= slope (d + z), around (x, z)."""
    high, low = float(np.max(x - slope * z)), float(np.min(x + slope * z))
    return 0.5 * (high + low), 0.5 * (high - low) / slope


def _front_and_right(up: Floats) -> tuple[Floats, Floats]:
    """Unit vectors (3,): the front of an asset, and the right of a viewer in front of it."""
    front = np.array([0.0, -1.0, 0.0]) if abs(up[2]) > 0.5 else np.array([0.0, 0.0, 1.0])
    return front, np.cross(up, front)

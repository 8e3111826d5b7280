"""Parts of one surface that reach into each other."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray

from gf_usd.geometry.winding import boxes
from gf_usd.model import Floats, Ints

PROBES = 50_000  # places looked at: bounds time
FINEST = 12  # places along an edge, where triangles are few
DEPTH = 1e-4  # [sizes of a part] below its surface: parts that only touch share nothing there
SHARED = 1.5  # winding number of flesh that two parts claim: 2


def overlapping(points: Floats, triangles: Ints, label: Ints) -> NDArray[np.bool_]:
    """(K,) parts of outward triangles (T, 3) that lie in the flesh of others in some places.

    Just below the surface of a part alone the winding number is 1; where another part has the
    place too, it is 2.
    """
    count = int(label.max(initial=-1)) + 1
    if count < 2:
        return np.zeros(count, bool)
    rows = np.arange(0, len(triangles), -(-len(triangles) // PROBES))
    n = int(np.clip(np.sqrt(2.0 * PROBES / len(rows)), 1, FINEST))
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    # the middles of the n^2 / 2 upright triangles that a triangle is cut into
    u, v = ((np.stack([i, j])[:, i + j < n] + 1.0 / 3.0) / n)[:, None, :, None]
    a, b, c = (corner[:, None, :] for corner in np.moveaxis(points[triangles[rows]], 1, 0))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    low, high = boxes(points, triangles, label)
    depth = DEPTH * np.linalg.norm(high - low, axis=1)[label[rows]][:, None, None]
    X = (a + u * (b - a) + v * (c - a) - depth * normal).reshape(-1, 3)
    centre = points[triangles].mean((0, 1))
    faces = np.ascontiguousarray(triangles, np.int64)
    w = np.asarray(igl.fast_winding_number(points - centre, faces, X - centre))
    shared = (w.reshape(len(rows), -1) > SHARED).any(1)
    return np.bincount(label[rows], shared, count) > 0

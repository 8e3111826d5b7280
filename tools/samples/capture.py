"""A capture of the duck, as of 3D Gaussian splatting: discs on the visible surface.

It represents a capture of a real object: hollow, open at the bottom on which it stood, and with the
light of the room in its colors. One disc for each quad of the duck, in meters, as SPZ.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Splats
from gf_usd.readers.splats.write import spz_bytes
from tools.samples.usd import Sample

LIGHT = np.array([0.4, 0.8, 0.45])  # towards the window
SHADE = 0.45  # of the light that reaches what faces away from it
UNSEEN = 0.04  # lower than this share of the height, what faces down was on the table
WIDE, THIN = 0.62, 0.06  # standard deviations over the edge of a quad
Y_0 = 0.28209479177387814  # harmonic of degree 0


def write_capture(path: Path, sample: Sample) -> int:
    """Write `sample` as a capture; returns the number of Gaussians."""
    corners = sample.mesh.points[sample.mesh.faces]  # (F, 4, 3)
    centers = corners.mean(axis=1)
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    edges = np.sqrt(0.5 * np.linalg.norm(normals, axis=1))  # of a square of the same area
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    low, high = centers[:, 1].min(), centers[:, 1].max()
    seen = (centers[:, 1] > low + UNSEEN * (high - low)) | (normals[:, 1] > -0.3)
    albedo = np.array([sample.looks[part].color for part in sample.mesh.parts])
    faces_light = np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    light = SHADE + (1.0 - SHADE) * faces_light
    color = encoded(np.clip(albedo * light[:, None], 0.0, 1.0))
    splats = Splats(
        positions=(sample.meters_per_unit * centers[seen]).astype(np.float32),
        orientations=facing(normals[seen]).astype(np.float32),
        scales=(sample.meters_per_unit * edges[seen, None] * [WIDE, WIDE, THIN]).astype(np.float32),
        opacities=np.full(int(seen.sum()), 0.95, np.float32),
        harmonics=((color[seen] - 0.5) / Y_0)[:, None].astype(np.float32),
        path="/DuckCapture",
    )
    path.write_bytes(spz_bytes(splats))
    return len(splats)


def encoded(linear: Floats) -> Floats:
    """sRGB of linear colors."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def facing(normals: Floats) -> Floats:
    """(n, 4) quaternions (w, x, y, z) that turn z to each normal (n, 3)."""
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    turns = np.stack([across, np.cross(normals, across), normals], axis=2)
    return Rotation.from_matrix(turns).as_quat()[:, [3, 0, 1, 2]]

"""The creature's colors, a function of the place in the bind pose, and their texture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from tools.samples.creature import EYE, EYE_RADIUS, NOSE, TAIL
from tools.samples.quads import Quads
from tools.samples.uv import Atlas

Floats = NDArray[np.float64]

SIZE = 1024  # texels
PALETTE = 96  # colors of the file

COAT, STRIPE = np.array([98, 176, 170.0]), np.array([62, 132, 136.0])  # sRGB of 255
CREAM, CORAL = np.array([250, 236, 208.0]), np.array([243, 142, 126.0])
INK, WHITE, NOSE_COLOR = (
    np.array([38, 30, 36.0]),
    np.array([255, 255, 255.0]),
    np.array([120, 58, 62.0]),
)


def paint(p: Floats) -> Floats:
    """(n, 3) sRGB colors of 0 to 255 at places (n, 3) on the creature."""
    x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    color = np.tile(COAT, (len(p), 1))

    def over(new: Floats, edge: Floats, soft: float) -> None:
        """`new` where `edge` is negative, blended over `soft`."""
        share = np.clip(0.5 - edge / soft, 0.0, 1.0)
        share = (share * share * (3.0 - 2.0 * share))[:, None]
        color[:] = (1.0 - share) * color + share * new

    over(
        STRIPE,
        np.maximum(0.45 - np.cos(0.85 * (y - 0.55 * z)), np.maximum(z + 5.0, x - 6.0) / 6.0),
        0.35,
    )
    over(CREAM, np.maximum(np.hypot(x / 8.6, (y - 19.5) / 10.5) - 1.0, (2.0 - z) / 8.0), 0.12)
    over(CREAM, np.maximum(np.hypot(x / 6.4, (y - 42.0) / 4.3) - 1.0, (5.0 - z) / 4.0), 0.2)
    over(CREAM, np.linalg.norm(p - np.array(TAIL[2]), axis=1) - 5.2, 1.0)
    over(CREAM, np.maximum(np.hypot(x - 22.0, y - 29.0) - 4.2, z - 90.0), 0.8)
    over(CREAM, np.maximum(y - 2.4, 6.5 - z), 0.8)
    # the inner ear: near the middle line of its front
    root, tip = np.array([6.6, 54.0]), np.array([17.8, 68.0])
    along = np.clip(((x - root[0]) * 11.2 + (y - root[1]) * 14.0) / (11.2**2 + 14.0**2), 0.0, 1.0)
    middle = root + along[:, None] * (tip - root) + np.sin(np.pi * along)[:, None] * [-0.6, 0.6]
    away = np.hypot(x - middle[:, 0], y - middle[:, 1])
    over(
        CORAL,
        np.maximum(away - 2.3 * np.sqrt(np.sin(np.pi * (0.08 + 0.84 * along))), (0.3 - z) * 2.0),
        0.8,
    )
    q = np.stack([x, y, z], axis=1)
    over(CORAL, np.linalg.norm(q - [9.6, 41.8, 8.0], axis=1) - 2.7, 1.6)
    over(
        INK,
        np.abs(y - 41.2 - 0.09 * (x - 1.6) ** 2)
        + np.maximum(x - 3.0, 0.0)
        + np.maximum(10.0 - z, 0.0)
        - 0.28,
        0.3,
    )
    over(INK, np.maximum(x - 0.22, np.maximum(np.abs(y - 42.3) - 1.2, 11.0 - z)), 0.25)
    over(NOSE_COLOR, np.linalg.norm((q - NOSE) / [1.25, 0.95, 1.2], axis=1) - 1.75, 0.3)
    for side in (1.0, -1.0):
        eye = EYE * [side, 1.0, 1.0]
        flat = np.hypot(p[:, 0] - eye[0], (p[:, 1] - eye[1]) / 1.2)
        front = (4.0 - z) * 2.0
        over(INK, np.maximum(flat - EYE_RADIUS, front), 0.25)
        shine = np.hypot(p[:, 0] - eye[0] + 0.55, p[:, 1] - eye[1] - 0.85)
        over(WHITE, np.maximum(shine - 0.55, front), 0.25)
    return color


def texels(mesh: Quads, atlas: Atlas) -> tuple[NDArray[np.bool_], Floats]:
    """Which texels (SIZE, SIZE) a face covers, and the places (SIZE, SIZE, 3) of those."""
    covered = np.zeros((SIZE, SIZE), dtype=bool)
    places = np.zeros((SIZE, SIZE, 3))
    corners = atlas.values[atlas.indices] * SIZE - 0.5
    for quad, uv in zip(mesh.faces, corners):
        for k in ((0, 1, 2), (0, 2, 3)):
            a, b, c = uv[list(k)]
            lo = np.maximum(np.floor(np.min([a, b, c], axis=0)).astype(int), 0)
            hi = np.minimum(np.ceil(np.max([a, b, c], axis=0)).astype(int), SIZE - 1)
            grid = np.stack(
                np.meshgrid(*(np.arange(i, j + 1) for i, j in zip(lo, hi)), indexing="ij"), -1
            )
            edges = np.array([b - a, c - a]).T
            s, t = np.moveaxis((grid - a) @ np.linalg.inv(edges).T, -1, 0)
            share = np.stack([1.0 - s - t, s, t], -1)
            mine = share.min(-1) >= -1e-9
            column, row = grid[mine].T
            covered[row, column] = True
            places[row, column] = share[mine] @ mesh.points[quad[list(k)]]
    return covered, places


def write_texture(path: Path, mesh: Quads, atlas: Atlas) -> None:
    """Write the texture as PNG; texels outside the charts take the nearest color within."""
    covered, places = texels(mesh, atlas)
    nearest: NDArray[np.int32] = np.empty((2, SIZE, SIZE), np.int32)
    ndimage.distance_transform_edt(
        ~covered, return_distances=False, return_indices=True, indices=nearest
    )
    color = np.zeros((SIZE, SIZE, 3))
    color[covered] = paint(places[covered])
    color = color[tuple(nearest)][::-1]
    image = Image.fromarray(np.round(color).astype(np.uint8))
    image.quantize(PALETTE, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        path, optimize=True
    )

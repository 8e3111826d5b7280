# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Anisotropic Gaussians by EWA splatting [Zwicker et al. 2001], front to back.

A Gaussian with covariance Sigma at depth z is projected to the picture as
    C = J W Sigma W' J' + s I,   J = f/z (1 0 -x/z; 0 1 -y/z),
with W the rotation into the view and s the pixel filter's variance; its opacity is scaled by
sqrt(det(C - s I) / det C), so that the filter does not fatten what is thinner than a pixel.

What Gaussians with spherical harmonics show to a camera.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.radiance import DEGREE, basis, srgb_to_linear
from gf_usd.core.scene import Harmonics, RenderSplats
from gf_usd.system.taichi_runtime import import_taichi
from gf_usd.view.render.camera import Lens
from gf_usd.view.render.raster import F32_2, F32_3, I32_1, vec3
from gf_usd.view.render.surfaces import covariances

ti = import_taichi()

TILE = 16  # pixels a side
FILTER = 0.25  # [pixels^2] variance of the pixel filter
FAINTEST = 1.0 / 512.0  # opacity below which a splat ends
OPAQUE = 1e-4  # transmittance at which a pixel is finished


@dataclass(frozen=True, kw_only=True)
class Projected:
    """Splats in the picture, nearest first."""

    shape: NDArray[np.float32]  # (N, 7): x, y [pixels], C^-1 as xx xy yy, opacity, depth [m]
    half: NDArray[np.float64]  # (N, 2) [pixels] half extents
    order: NDArray[np.int64]  # (N,) into the splats as given


def project(splats: RenderSplats, lens: Lens) -> Projected:
    """Splats as ellipses of a picture, those in front of the camera and not too faint to show."""
    view = (np.asarray(splats.positions, dtype=np.float64) - lens.origin - lens.eye) @ lens.axes.T
    x, y, z = view.T
    kept = np.flatnonzero((z > lens.near) & (np.asarray(splats.opacities) > FAINTEST))
    kept = kept[np.argsort(z[kept], kind="stable")]
    x, y, z = x[kept], y[kept], z[kept]
    # beyond the picture's edge the linearized projection grows without bound: hold it there
    middle = 0.5 * np.array([lens.width, lens.height])
    limit = (1.3 * middle + np.abs(middle - lens.center)) / lens.focal
    slope_x, slope_y = np.clip(x / z, -limit[0], limit[0]), np.clip(y / z, -limit[1], limit[1])
    zero = np.zeros_like(z)
    jacobian = np.stack(
        [np.stack([1 / z, zero, -slope_x / z], -1), np.stack([zero, -1 / z, slope_y / z], -1)], 1
    )
    turn = lens.focal * jacobian @ lens.axes
    sigma = covariances(splats.axes[kept])
    plane = turn @ sigma @ np.swapaxes(turn, 1, 2)
    xx, xy, yy = plane[:, 0, 0] + FILTER, plane[:, 0, 1], plane[:, 1, 1] + FILTER
    det = xx * yy - xy**2
    sharp = np.maximum(plane[:, 0, 0] * plane[:, 1, 1] - xy**2, 0.0)
    opacity = np.asarray(splats.opacities)[kept] * np.sqrt(sharp / det)
    reach = np.sqrt(np.maximum(2.0 * np.log(np.maximum(opacity, 1e-30) / FAINTEST), 0.0))
    px = lens.center[0] + lens.focal * x / z
    py = lens.center[1] - lens.focal * y / z
    shape = np.stack([px, py, yy / det, -xy / det, xx / det, opacity, z], axis=1)
    half = reach[:, None] * np.sqrt(np.stack([xx, yy], axis=1))
    return Projected(shape=shape.astype(np.float32), half=half, order=kept)


def tile_lists(
    projected: Projected, width: int, height: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Splats of each tile, nearest first: `entries`, and `start` (tiles + 1,) of each tile."""
    across, down = -(-width // TILE), -(-height // TILE)
    center = projected.shape[:, :2].astype(np.float64)
    low = np.clip(np.floor((center - projected.half) / TILE), 0, (across, down)).astype(np.int64)
    high = np.clip(np.floor((center + projected.half) / TILE) + 1, 0, (across, down))
    span = np.maximum(high.astype(np.int64) - low, 0) * (projected.half[:, :1] > 0)
    count = span[:, 0] * span[:, 1]
    splat = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(splat)) - np.repeat(np.cumsum(count) - count, count)
    wide = np.maximum(span[splat, 0], 1)
    tile = (low[splat, 1] + nth // wide) * across + low[splat, 0] + nth % wide
    # stable: within a tile the order stays that of depth
    by_tile = np.argsort(tile, kind="stable")
    start = np.searchsorted(tile[by_tile], np.arange(across * down + 1))
    return splat[by_tile].astype(np.int32), start.astype(np.int32)


def draw_splats(
    splats: RenderSplats,
    radiance: Floats,
    lens: Lens,
    picture: NDArray[np.float32],
    seen: NDArray[np.float32],
) -> None:
    """Composite splats over a linear picture (H, W, 3), in place.

    Parameters
    ----------
    radiance : (N, 3) linear, what each splat shows.
    seen : (H, W) [m] depth of the opaque surface behind which splats are hidden.
    """
    projected = project(splats, lens)
    if not len(projected.order):
        return
    entries, start = tile_lists(projected, lens.width, lens.height)
    if not len(entries):
        return
    colors = np.ascontiguousarray(np.asarray(radiance)[projected.order], dtype=np.float32)
    composite(projected.shape, colors, entries, start, seen, picture)


@ti.kernel
def composite(
    shape: F32_2, colors: F32_2, entries: I32_1, start: I32_1, seen: F32_2, picture: F32_3
):
    """c = sum_i c_i a_i prod_{j<i} (1 - a_j) + (1 - all) background, a = o exp(-d' C^-1 d / 2)."""
    height, width = picture.shape[0], picture.shape[1]
    across = (width + TILE - 1) // TILE
    for job in range((start.shape[0] - 1) * TILE * TILE):
        tile, inner = job // (TILE * TILE), job % (TILE * TILE)
        x = (tile % across) * TILE + inner % TILE
        y = (tile // across) * TILE + inner // TILE
        if x < width and y < height:
            through = 1.0
            color = vec3(0.0)
            k, end = start[tile], start[tile + 1]
            while k < end:
                i = entries[k]
                k += 1
                if shape[i, 6] > seen[y, x] or through < OPAQUE:
                    k = end
                else:
                    dx, dy = x + 0.5 - shape[i, 0], y + 0.5 - shape[i, 1]
                    power = dx * dx * shape[i, 2] + 2.0 * dx * dy * shape[i, 3]
                    alpha = shape[i, 5] * ti.exp(-0.5 * (power + dy * dy * shape[i, 4]))
                    if alpha >= FAINTEST:
                        for c in ti.static(range(3)):
                            color[c] += through * alpha * colors[i, c]
                        through *= 1.0 - alpha
            for c in ti.static(range(3)):
                picture[y, x, c] = color[c] + through * picture[y, x, c]


def seen_from(harmonics: Harmonics, towards: Floats) -> NDArray[np.floating]:
    """Linear color (N, 3) = 0.5 + sum_k c_k Y_k(d) of splats seen along `towards` (N, 3)."""
    local = towards @ np.asarray(harmonics.frame).T
    local = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    used = min(harmonics.coefficients.shape[1], (DEGREE + 1) ** 2)
    weights = basis(local)[:, :used]
    value = 0.5 + np.einsum("nk,nkc->nc", weights, harmonics.coefficients[:, :used])
    value = np.maximum(value, 0.0)
    return srgb_to_linear(value) if harmonics.srgb else value

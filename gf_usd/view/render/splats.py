# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""EWA splatting of anisotropic Gaussians [Zwicker et al. 2001], composited front to back.

A Gaussian with covariance Sigma at depth z is projected to the image as
    C = J W Sigma W' J' + s I,   J = f/z (1 0 -x/z; 0 1 -y/z),
with W the rotation into the view and s the pixel filter's variance; its opacity is scaled by
sqrt(det(C - s I) / det C), so that the filter preserves the contribution of a splat that is smaller
than a pixel.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.radiance import DEGREE, basis, srgb_to_linear
from gf_usd.core.scene import Harmonics, RenderSplats
from gf_usd.system.taichi_runtime import import_taichi
from gf_usd.view.render.camera import PinholeCamera
from gf_usd.view.render.packing import splat_covariances
from gf_usd.view.render.raster import F32_2, F32_3, I32_1, vec3

ti = import_taichi()

TILE = 16  # [pixels] of a side
FILTER = 0.25  # [pixels^2] variance of the pixel filter
MIN_OPACITY = 1.0 / 512.0  # opacity at which a splat is truncated
MIN_TRANSMITTANCE = 1e-4  # at which compositing of a pixel stops


@dataclass(frozen=True, kw_only=True)
class Projected:
    """Splats projected to the image, sorted by depth."""

    shape: NDArray[np.float32]  # (N, 7): x, y [pixels], C^-1 as xx xy yy, opacity, depth [m]
    half_extent: NDArray[np.float64]  # (N, 2) [pixels] half extents
    order: NDArray[np.int64]  # (N,) their indices in the input


def project(splats: RenderSplats, pinhole: PinholeCamera) -> Projected:
    """Project splats to ellipses: those beyond the near plane with opacity above MIN_OPACITY."""
    view = (
        np.asarray(splats.positions, dtype=np.float64) - pinhole.origin - pinhole.eye
    ) @ pinhole.axes.T
    x, y, z = view.T
    visible = np.flatnonzero((z > pinhole.near) & (np.asarray(splats.opacities) > MIN_OPACITY))
    visible = visible[np.argsort(z[visible], kind="stable")]
    x, y, z = x[visible], y[visible], z[visible]
    # outside the image the linearized projection grows without bound: clamp the slopes
    middle = 0.5 * np.array([pinhole.width, pinhole.height])
    limit = (1.3 * middle + np.abs(middle - pinhole.center)) / pinhole.focal
    tan_x, tan_y = np.clip(x / z, -limit[0], limit[0]), np.clip(y / z, -limit[1], limit[1])
    zero = np.zeros_like(z)
    jacobian = np.stack(
        [np.stack([1 / z, zero, -tan_x / z], -1), np.stack([zero, -1 / z, tan_y / z], -1)], 1
    )
    projection = pinhole.focal * jacobian @ pinhole.axes
    sigma = splat_covariances(splats.axes[visible])
    covariance_2d = projection @ sigma @ np.swapaxes(projection, 1, 2)
    xx, xy, yy = (
        covariance_2d[:, 0, 0] + FILTER,
        covariance_2d[:, 0, 1],
        covariance_2d[:, 1, 1] + FILTER,
    )
    det = xx * yy - xy**2
    unfiltered = np.maximum(covariance_2d[:, 0, 0] * covariance_2d[:, 1, 1] - xy**2, 0.0)
    opacity = np.asarray(splats.opacities)[visible] * np.sqrt(unfiltered / det)
    reach = np.sqrt(np.maximum(2.0 * np.log(np.maximum(opacity, 1e-30) / MIN_OPACITY), 0.0))
    px = pinhole.center[0] + pinhole.focal * x / z
    py = pinhole.center[1] - pinhole.focal * y / z
    shape = np.stack([px, py, yy / det, -xy / det, xx / det, opacity, z], axis=1)
    half_extent = reach[:, None] * np.sqrt(np.stack([xx, yy], axis=1))
    return Projected(shape=shape.astype(np.float32), half_extent=half_extent, order=visible)


def bin_into_tiles(
    projected: Projected, width: int, height: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Splats of each tile, sorted by depth: `entries`, and their ranges `start` (tiles + 1,)."""
    across, down = -(-width // TILE), -(-height // TILE)
    center = projected.shape[:, :2].astype(np.float64)
    low = np.clip(np.floor((center - projected.half_extent) / TILE), 0, (across, down)).astype(
        np.int64
    )
    high = np.clip(np.floor((center + projected.half_extent) / TILE) + 1, 0, (across, down))
    span = np.maximum(high.astype(np.int64) - low, 0) * (projected.half_extent[:, :1] > 0)
    count = span[:, 0] * span[:, 1]
    splat = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(splat)) - np.repeat(np.cumsum(count) - count, count)
    wide = np.maximum(span[splat, 0], 1)
    tile = (low[splat, 1] + nth // wide) * across + low[splat, 0] + nth % wide
    # a stable sort keeps the order by depth within a tile
    by_tile = np.argsort(tile, kind="stable")
    start = np.searchsorted(tile[by_tile], np.arange(across * down + 1))
    return splat[by_tile].astype(np.int32), start.astype(np.int32)


def draw_splats(
    splats: RenderSplats,
    radiance: Floats,
    pinhole: PinholeCamera,
    image: NDArray[np.float32],
    depth: NDArray[np.float32],
) -> None:
    """Composite splats over a linear image (H, W, 3), in place.

    Parameters
    ----------
    radiance : (N, 3) linear, of each splat.
    depth : (H, W) [m] of the opaque surface, which hides splats behind it.
    """
    projected = project(splats, pinhole)
    if not len(projected.order):
        return
    entries, start = bin_into_tiles(projected, pinhole.width, pinhole.height)
    if not len(entries):
        return
    colors = np.ascontiguousarray(np.asarray(radiance)[projected.order], dtype=np.float32)
    composite(projected.shape, colors, entries, start, depth, image)


@ti.kernel
def composite(
    shape: F32_2, colors: F32_2, entries: I32_1, start: I32_1, depth: F32_2, image: F32_3
):
    """c = sum_i c_i a_i prod_{j<i} (1 - a_j) + (1 - all) background, a = o exp(-d' C^-1 d / 2)."""
    height, width = image.shape[0], image.shape[1]
    across = (width + TILE - 1) // TILE
    for job in range((start.shape[0] - 1) * TILE * TILE):
        tile, inner = job // (TILE * TILE), job % (TILE * TILE)
        x = (tile % across) * TILE + inner % TILE
        y = (tile // across) * TILE + inner // TILE
        if x < width and y < height:
            transmittance = 1.0
            color = vec3(0.0)
            k, end = start[tile], start[tile + 1]
            while k < end:
                i = entries[k]
                k += 1
                if shape[i, 6] > depth[y, x] or transmittance < MIN_TRANSMITTANCE:
                    k = end
                else:
                    dx, dy = x + 0.5 - shape[i, 0], y + 0.5 - shape[i, 1]
                    power = dx * dx * shape[i, 2] + 2.0 * dx * dy * shape[i, 3]
                    alpha = shape[i, 5] * ti.exp(-0.5 * (power + dy * dy * shape[i, 4]))
                    if alpha >= MIN_OPACITY:
                        for c in ti.static(range(3)):
                            color[c] += transmittance * alpha * colors[i, c]
                        transmittance *= 1.0 - alpha
            for c in ti.static(range(3)):
                image[y, x, c] = color[c] + transmittance * image[y, x, c]


def view_dependent_color(harmonics: Harmonics, directions: Floats) -> NDArray[np.floating]:
    """Linear color (N, 3) = 0.5 + sum_k c_k Y_k(d) of splats in view directions (N, 3).

    directions : from the camera to each splat, of any length.
    """
    local = directions @ np.asarray(harmonics.frame).T
    local = local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)
    count = min(harmonics.coefficients.shape[1], (DEGREE + 1) ** 2)
    weights = basis(local)[:, :count]
    value = 0.5 + np.einsum("nk,nkc->nc", weights, harmonics.coefficients[:, :count])
    value = np.maximum(value, 0.0)
    return srgb_to_linear(value) if harmonics.srgb else value

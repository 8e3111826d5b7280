"""Display meshes: vertices are split at creases and where the color changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Texture
from gf_usd.core.neighbors import components
from gf_usd.core.radiance import linear_to_srgb, srgb_to_linear
from gf_usd.core.scene import RenderMesh
from gf_usd.view.report.thinning import cluster_vertices


@dataclass(frozen=True, kw_only=True)
class DisplayMesh:
    """All meshes of a recording as one, thinned: the data that is constant in time."""

    kept: NDArray[np.int64]  # (K,) into the concatenated points of all meshes
    corners: NDArray[np.int64]  # (S, 3) triangles into the display vertices
    source: NDArray[np.int64]  # (D,) into kept: the point of each display vertex
    shade: NDArray[np.int64]  # (D,) group of display vertices with a common normal
    colors: NDArray[np.uint8]  # (D, 3) sRGB
    vertices: int  # before thinning
    triangles: int


def make_display_mesh(meshes: Sequence[RenderMesh], most: int) -> DisplayMesh:
    """Concatenate and thin meshes to at most `most` vertices, and split vertices for display."""
    sizes = [len(mesh.points) for mesh in meshes]
    starts = np.cumsum([0, *sizes])
    points = np.concatenate([np.zeros((0, 3)), *(mesh.points for mesh in meshes)])
    triangles = np.concatenate(
        [np.zeros((0, 3), np.int64)]
        + [np.asarray(m.triangles, np.int64) + s for m, s in zip(meshes, starts)]
    )
    colors = np.concatenate([np.zeros((0, 3, 3)), *(corner_colors(mesh) for mesh in meshes)])
    crease = np.concatenate(
        [[], *(np.full(len(mesh.triangles), mesh.crease_angle) for mesh in meshes)]
    )
    mesh_index = np.repeat(np.arange(len(meshes)), sizes)
    kept, corners, faces = cluster_vertices(points, triangles, mesh_index, most)
    group = smooth_groups(points[kept], corners, crease[faces])
    flat = corners.reshape(-1)
    code = linear_to_srgb(np.clip(colors[faces].reshape(-1, 3), 0.0, 1.0))
    # vertices are split where colors differ visibly: in 5 bits per channel
    color_key = np.floor(code * 31.0 + 0.5).astype(np.int64) @ np.array([1, 32, 1024])
    rows = np.column_stack([flat, group, color_key])
    _, first, where = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    _, shade = np.unique(group[first], return_inverse=True)
    return DisplayMesh(
        kept=kept,
        corners=where.reshape(-1, 3),
        source=flat[first],
        shade=shade.reshape(-1),
        colors=np.round(code[first] * 255.0).astype(np.uint8),
        vertices=len(points),
        triangles=len(triangles),
    )


def smooth_groups(points: Floats, triangles: Ints, crease: Floats) -> Ints:
    """Smoothing group (3 T,) of each triangle corner; corners of one group share a normal.

    Two triangles are joined across an edge where their dihedral angle is below the crease angle.

    Parameters
    ----------
    points : (V, 3).   triangles : (T, 3).   crease : (T,) [deg].
    """
    count = len(triangles)
    corner = np.arange(3 * count).reshape(-1, 3)
    corners_at = np.asarray(points)[np.asarray(triangles)]
    normal = np.cross(corners_at[:, 1] - corners_at[:, 0], corners_at[:, 2] - corners_at[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    edge_vertices = np.concatenate([np.asarray(triangles)[:, [i, (i + 1) % 3]] for i in range(3)])
    edge_corners = np.concatenate([corner[:, [i, (i + 1) % 3]] for i in range(3)])
    swap = edge_vertices[:, 0] > edge_vertices[:, 1]
    edge_vertices[swap], edge_corners[swap] = edge_vertices[swap, ::-1], edge_corners[swap, ::-1]
    order = np.lexsort((edge_vertices[:, 1], edge_vertices[:, 0]))
    edge_vertices, edge_corners = edge_vertices[order], edge_corners[order]
    face = edge_corners[:, 0] // 3
    same = np.flatnonzero((edge_vertices[1:] == edge_vertices[:-1]).all(axis=1))
    cosine = np.einsum("ij,ij->i", normal[face[same]], normal[face[same + 1]])
    limit = np.minimum(np.asarray(crease)[face[same]], np.asarray(crease)[face[same + 1]])
    joined = same[cosine >= np.cos(np.radians(limit)) - 1e-9]
    row, column = edge_corners[joined].reshape(-1), edge_corners[joined + 1].reshape(-1)
    graph = coo_matrix((np.ones(len(row), np.int8), (row, column)), shape=(3 * count, 3 * count))
    return components(graph)[1]


def corner_colors(mesh: RenderMesh) -> NDArray[np.float64]:
    """Linear colors (T, 3, 3) at triangle corners, sampled from textures where there are any."""
    colors = np.array(
        np.broadcast_to(np.asarray(mesh.colors, dtype=np.float64), (len(mesh.triangles), 3, 3))
    )
    if mesh.uvs is None or mesh.triangle_textures is None:
        return colors
    uvs = np.asarray(mesh.uvs)
    for index, texture in enumerate(mesh.textures):
        textured = np.asarray(mesh.triangle_textures) == index
        colors[textured] = _sample_nearest_texel(texture, uvs[textured])
    return colors


def _sample_nearest_texel(texture: Texture, uv: Floats) -> NDArray[np.float64]:
    """Linear color (..., 3) of the nearest texel; v = 0 is the bottom row."""
    height, width = texture.pixels.shape[:2]
    column = _wrap_to_texel(uv[..., 0], width, texture.wrap_s)
    row = _wrap_to_texel(1.0 - uv[..., 1], height, texture.wrap_t)
    code = texture.pixels[row, column] / 255.0
    return np.asarray(srgb_to_linear(code) if texture.srgb else code, dtype=np.float64)


def _wrap_to_texel(coordinate: Floats, size: int, kind: str) -> NDArray[np.int64]:
    coordinate = np.where(np.isfinite(coordinate), coordinate, 0.0)
    if kind == "mirror":
        coordinate = 1.0 - np.abs(np.mod(coordinate, 2.0) - 1.0)
    elif kind == "repeat":
        coordinate = np.mod(coordinate, 1.0)
    return np.clip(np.floor(coordinate * size), 0, size - 1).astype(np.int64)

"""A mesh as a graphics card draws it: vertices split at creases and where the color changes.

What is left out so that a page stays small: frames, vertices, Gaussians.
"""

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


@dataclass(frozen=True, kw_only=True)
class Skin:
    """All meshes of a recording as one, thinned; nothing here moves."""

    kept: NDArray[np.int64]  # (K,) into the points of all meshes, end to end
    corners: NDArray[np.int64]  # (S, 3) triangles into the display vertices
    source: NDArray[np.int64]  # (D,) into kept: where a display vertex is
    shade: NDArray[np.int64]  # (D,) display vertices of one number share a normal
    colors: NDArray[np.uint8]  # (D, 3) sRGB
    vertices: int  # before thinning
    triangles: int


def make_skin(meshes: Sequence[RenderMesh], most: int) -> Skin:
    """Join, thin and split the meshes; `most` bounds the vertices that move."""
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
    part = np.repeat(np.arange(len(meshes)), sizes)
    kept, corners, faces = cluster(points, triangles, part, most)
    group = smooth_groups(points[kept], corners, crease[faces])
    flat = corners.reshape(-1)
    code = linear_to_srgb(np.clip(colors[faces].reshape(-1, 3), 0.0, 1.0))
    # 5 bits a channel tell colors apart that an eye would see as an edge
    tint = np.floor(code * 31.0 + 0.5).astype(np.int64) @ np.array([1, 32, 1024])
    rows = np.column_stack([flat, group, tint])
    _, first, where = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    _, shade = np.unique(group[first], return_inverse=True)
    return Skin(
        kept=kept,
        corners=where.reshape(-1, 3),
        source=flat[first],
        shade=shade.reshape(-1),
        colors=np.round(code[first] * 255.0).astype(np.uint8),
        vertices=len(points),
        triangles=len(triangles),
    )


def smooth_groups(points: Floats, triangles: Ints, crease: Floats) -> Ints:
    """(3 T,) a number for each corner; corners with the same share a normal.

    Two triangles over an edge are joined where their planes meet at less than the crease angle.

    Parameters
    ----------
    points : (V, 3).   triangles : (T, 3).   crease : (T,) [deg].
    """
    count = len(triangles)
    corner = np.arange(3 * count).reshape(-1, 3)
    spots = np.asarray(points)[np.asarray(triangles)]
    normal = np.cross(spots[:, 1] - spots[:, 0], spots[:, 2] - spots[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    ends = np.concatenate([np.asarray(triangles)[:, [i, (i + 1) % 3]] for i in range(3)])
    at = np.concatenate([corner[:, [i, (i + 1) % 3]] for i in range(3)])
    swap = ends[:, 0] > ends[:, 1]
    ends[swap], at[swap] = ends[swap, ::-1], at[swap, ::-1]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, at = ends[order], at[order]
    face = at[:, 0] // 3
    same = np.flatnonzero((ends[1:] == ends[:-1]).all(axis=1))
    cosine = np.einsum("ij,ij->i", normal[face[same]], normal[face[same + 1]])
    limit = np.minimum(np.asarray(crease)[face[same]], np.asarray(crease)[face[same + 1]])
    joined = same[cosine >= np.cos(np.radians(limit)) - 1e-9]
    row, column = at[joined].reshape(-1), at[joined + 1].reshape(-1)
    graph = coo_matrix((np.ones(len(row), np.int8), (row, column)), shape=(3 * count, 3 * count))
    return components(graph)[1]


def corner_colors(mesh: RenderMesh) -> NDArray[np.float64]:
    """(T, 3, 3) linear colors at triangle corners; textures are looked up there."""
    colors = np.array(
        np.broadcast_to(np.asarray(mesh.colors, dtype=np.float64), (len(mesh.triangles), 3, 3))
    )
    if mesh.uvs is None or mesh.triangle_textures is None:
        return colors
    uvs = np.asarray(mesh.uvs)
    for number, texture in enumerate(mesh.textures):
        mine = np.asarray(mesh.triangle_textures) == number
        colors[mine] = _texel(texture, uvs[mine])
    return colors


def _texel(texture: Texture, uv: Floats) -> NDArray[np.float64]:
    """(..., 3) linear color of the nearest texel; v = 0 is the bottom row."""
    height, width = texture.pixels.shape[:2]
    column = _wrap(uv[..., 0], width, texture.wrap_s)
    row = _wrap(1.0 - uv[..., 1], height, texture.wrap_t)
    code = texture.pixels[row, column] / 255.0
    return np.asarray(srgb_to_linear(code) if texture.srgb else code, dtype=np.float64)


def _wrap(place: Floats, size: int, kind: str) -> NDArray[np.int64]:
    place = np.where(np.isfinite(place), place, 0.0)
    if kind == "mirror":
        place = 1.0 - np.abs(np.mod(place, 2.0) - 1.0)
    elif kind == "repeat":
        place = np.mod(place, 1.0)
    return np.clip(np.floor(place * size), 0, size - 1).astype(np.int64)


STEPS = 40  # halvings of the interval of cell sizes; a double has no more than 53


def spread(count: int, most: int) -> NDArray[np.int64]:
    """Up to `most` of 0..count-1, evenly spread, first and last included."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(np.int64))


def sample(count: int, most: int) -> NDArray[np.int64]:
    """Up to `most` of 0..count-1 at random, ascending, the same every time."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def cluster(
    points: Floats, triangles: Ints, part: Ints, most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Thin a mesh by vertex clustering [Rossignac and Borrel 1993].

    Vertices of one part, in one cell of a grid and facing the same octant become one: the vertex
    nearest to their mean, which keeps its own motion.  The cell is the smallest that leaves no
    more than `most`.

    Parameters
    ----------
    points : (V, 3).   triangles : (T, 3).   part : (V,) vertices of different parts stay apart.

    Returns
    -------
    kept : (K,) vertices that are left.   corners : (S, 3) triangles into `kept`.
    faces : (S,) which triangle each was.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) <= most:
        return np.arange(len(points)), np.asarray(triangles), np.arange(len(triangles))
    octant = _octants(points, triangles)
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    fine, coarse = 0.0, size

    def group(cell: float) -> NDArray[np.int64]:
        index = np.floor((points - low) / cell).astype(np.int64)
        rows = np.column_stack([index, np.asarray(part), octant])
        return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)

    label = group(coarse)
    for _ in range(STEPS):
        middle = 0.5 * (fine + coarse)
        found = group(middle)
        count = int(found.max()) + 1
        if count <= most:
            coarse, label = middle, found
            if count > 0.9 * most:
                break
        else:
            fine = middle
    kept = _nearest_to_mean(points, label)
    corners = label[np.asarray(triangles)]
    a, b, c = corners.T
    faces = np.flatnonzero((a != b) & (b != c) & (c != a))
    # of triangles on the same three vertices the first is enough
    _, first = np.unique(np.sort(corners[faces], axis=1), axis=0, return_index=True)
    faces = faces[np.sort(first)]
    return kept, corners[faces], faces


def _octants(points: Floats, triangles: Ints) -> NDArray[np.int64]:
    """(V,) 0..7: signs of the vertex normals, so that the two sides of a thin wall stay apart."""
    corners = points[np.asarray(triangles)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, np.asarray(triangles)[:, corner], normal)
    return (total > 0.0).astype(np.int64) @ np.array([1, 2, 4])


def _nearest_to_mean(points: Floats, label: Ints) -> NDArray[np.int64]:
    """(K,) the member of each group that is nearest to the group's mean."""
    size = np.bincount(label)
    mean = np.stack([np.bincount(label, points[:, i]) for i in range(3)], axis=1) / size[:, None]
    away = np.linalg.norm(points - mean[label], axis=1)
    order = np.lexsort((away, label))
    return order[np.concatenate([[0], np.cumsum(size)[:-1]])]

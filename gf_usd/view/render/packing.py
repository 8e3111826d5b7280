"""Packing of a scene's surfaces into the flat arrays that the kernels read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Texture
from gf_usd.core.scene import RenderEllipsoids, RenderMesh, RenderSplats, Scene, to_frame
from gf_usd.view.render.normals import corner_normals
from gf_usd.view.render.textures import Atlas, make_atlas

Floats32 = NDArray[np.float32]
Ints32 = NDArray[np.int32]

# times the radius of the focus: what is farther away, such as the ends of a large ground, has no
# shadows, so that their maps are fine enough
AROUND = 3.0
SHADOW_SIGMAS = 1.5  # a Gaussian casts the shadow of an ellipse of this many standard deviations
SHADOW_OPACITY = 0.3  # those of lower opacity cast none


@dataclass(frozen=True, kw_only=True)
class SurfaceArrays:
    """All surfaces of a scene, relative to `origin`.

    Arrays are never empty, because Taichi accepts no empty arrays: where a scene has no triangles
    or no ellipsoids there is one of zeros, which the counts exclude.
    """

    origin: NDArray[np.float64]  # (3,) [m] center of what is shown
    radius: float  # [m] of a sphere about the origin that contains it: it has shadows
    n_triangles: int
    n_ellipsoids: int
    points: Floats32  # (V, 3) [m]
    triangles: Ints32  # (T, 3)
    normals: Floats32  # (T, 9)
    colors: Floats32  # (T, 9) linear
    uvs: Floats32  # (T, 6)
    roughness_metallic: Floats32  # (T, 2) roughness, metallic
    texture_indices: Ints32  # (T,) into the atlas; -1: none
    atlas: Atlas
    centers: Floats32  # (N, 3) [m] of ellipsoids
    inverses: Floats32  # (N, 9) [1/m]
    radius_bound: Floats32  # (N,) [m] longest semi-axis
    ellipsoid_colors: Floats32  # (N, 3) linear
    occluder_centers: Floats32  # (B, 3) [m] of ellipsoids and Gaussians that cast shadows
    occluder_covariances: Floats32  # (B, 6) [m^2] xx xy xz yy yz zz


def extent_points(scene: Scene) -> Floats:
    """Points (K, 3) [m] whose bounding box contains the scene; (0, 3) for an empty scene.

    Outliers of captured Gaussians (`core.scene.to_frame`) are excluded.
    """
    parts: list[Floats] = [np.asarray(mesh.points, dtype=np.float64) for mesh in scene.meshes]
    for cloud in scene.ellipsoids:
        radius_bound = np.linalg.norm(cloud.axes, axis=2)
        parts += [cloud.positions - radius_bound, cloud.positions + radius_bound]
    for splats in scene.splats:
        framed = slice(None) if splats.lit else to_frame(splats.positions, splats.opacities)
        radius_bound = 2.0 * np.linalg.norm(splats.axes[framed], axis=2)
        parts += [splats.positions[framed] - radius_bound, splats.positions[framed] + radius_bound]
    return np.concatenate([np.zeros((0, 3)), *parts])


def splat_covariances(axes: Floats) -> NDArray[np.float64]:
    """Covariances Sigma = A A', (N, 3, 3) [m^2], of axes A (N, 3, 3) [m]."""
    axes = np.asarray(axes, dtype=np.float64)
    return axes @ np.swapaxes(axes, 1, 2)


def pack_surfaces(scene: Scene) -> SurfaceArrays:
    """Concatenate the surfaces of a scene; normals that are not authored are computed."""
    extent = extent_points(scene)
    low, high = (extent.min(axis=0), extent.max(axis=0)) if len(extent) else (np.zeros(3),) * 2
    origin = 0.5 * (low + high)
    radius = 1.02 * float(np.linalg.norm(extent - origin, axis=1).max(initial=0.0)) or 1.0
    if scene.focus is not None and AROUND * 0.5 * scene.focus.diagonal < radius:
        origin = scene.focus.corners.mean(axis=0)
        radius = AROUND * 0.5 * scene.focus.diagonal or radius
    meshes = [mesh for mesh in scene.meshes if len(mesh.triangles)]
    vertex_base = np.cumsum([0] + [len(mesh.points) for mesh in meshes])
    texture_base = np.cumsum([0] + [len(mesh.textures) for mesh in meshes])
    clouds = [cloud for cloud in scene.ellipsoids if len(cloud.positions)]
    axes = _join([np.asarray(c.axes, dtype=np.float64) for c in clouds], (3, 3), np.float64)
    occluders = [_ellipsoid_occluders(c) for c in clouds] + [
        _splat_occluders(s) for s in scene.splats
    ]
    triangles = _join([m.triangles + b for m, b in zip(meshes, vertex_base)], (3,), np.int32)
    centers = _join([c.positions - origin for c in clouds], (3,))
    return SurfaceArrays(
        origin=origin,
        radius=radius,
        n_triangles=sum(len(mesh.triangles) for mesh in meshes),
        n_ellipsoids=sum(len(cloud.positions) for cloud in clouds),
        points=_join([mesh.points - origin for mesh in meshes], (3,)),
        triangles=triangles,
        normals=_join([_normals(mesh) for mesh in meshes], (9,)),
        colors=_join([_per_triangle(mesh, mesh.colors, (3, 3)) for mesh in meshes], (9,)),
        uvs=_join([_uvs(mesh) for mesh in meshes], (6,)),
        roughness_metallic=_join([_roughness_metallic(mesh) for mesh in meshes], (2,)),
        texture_indices=_join(
            [_texture_indices(m, b) for m, b in zip(meshes, texture_base)], (), np.int32
        ),
        atlas=make_atlas(_textures(meshes)),
        centers=centers,
        inverses=_join([np.linalg.inv(axes).reshape(-1, 9)] if clouds else [], (9,)),
        radius_bound=_join([np.linalg.norm(axes, ord=2, axis=(1, 2))] if clouds else [], ()),
        ellipsoid_colors=_join([cloud.colors for cloud in clouds], (3,)),
        occluder_centers=_join([p - origin for p, _ in occluders], (3,), at_least=0),
        occluder_covariances=_join([c for _, c in occluders], (6,), at_least=0),
    )


def _join(parts: list, shape: tuple[int, ...], dtype: type = np.float32, at_least: int = 1):
    """Concatenate arrays of rows of a shape; zeros where there are fewer than `at_least` rows."""
    rows = [np.asarray(part).reshape(-1, *shape) for part in parts]
    joined = np.concatenate([np.zeros((0, *shape), dtype), *rows])
    if len(joined) < at_least:
        joined = np.zeros((at_least, *shape))
    return np.ascontiguousarray(joined, dtype=dtype)


def _per_triangle(mesh: RenderMesh, value: Floats, shape: tuple[int, ...]) -> Floats:
    return np.broadcast_to(value, (len(mesh.triangles), *shape))


def _normals(mesh: RenderMesh) -> Floats:
    if mesh.normals is not None:
        return mesh.normals
    return corner_normals(mesh.points, mesh.triangles, mesh.crease_angle)


def _uvs(mesh: RenderMesh) -> Floats:
    return np.zeros((len(mesh.triangles), 6)) if mesh.uvs is None else mesh.uvs


def _roughness_metallic(mesh: RenderMesh) -> Floats:
    values = (mesh.roughness, mesh.metallic)
    return np.stack([_per_triangle(mesh, value, ()) for value in values], axis=1)


def _texture_indices(mesh: RenderMesh, first: int) -> Ints32:
    if mesh.triangle_textures is None or mesh.uvs is None:
        return np.full(len(mesh.triangles), -1, dtype=np.int32)
    own = np.asarray(mesh.triangle_textures)
    return np.where(own >= 0, own + first, -1).astype(np.int32)


def _textures(meshes: list[RenderMesh]) -> tuple[Texture, ...]:
    return tuple(texture for mesh in meshes for texture in mesh.textures)


def _upper_triangle(matrices: Floats) -> Floats:
    """Upper triangles (N, 6) of symmetric matrices (N, 3, 3)."""
    i, j = np.triu_indices(3)
    return matrices[:, i, j]


def _ellipsoid_occluders(cloud: RenderEllipsoids) -> tuple[Floats, Floats]:
    return cloud.positions, _upper_triangle(splat_covariances(cloud.axes))


def _splat_occluders(splats: RenderSplats) -> tuple[Floats, Floats]:
    solid = np.asarray(splats.opacities) >= SHADOW_OPACITY
    return splats.positions[solid], SHADOW_SIGMAS**2 * _upper_triangle(
        splat_covariances(splats.axes[solid])
    )

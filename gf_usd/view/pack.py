"""A scene's surfaces as the flat arrays that kernels read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.framing import to_frame
from gf_usd.model import Floats, Texture
from gf_usd.scene import RenderEllipsoids, RenderMesh, RenderSplats, Scene
from gf_usd.view.normals import corner_normals
from gf_usd.view.texture import Atlas, make_atlas

Single = NDArray[np.float32]
Index = NDArray[np.int32]

SHADOW_SIGMAS = 1.5  # a Gaussian shades like an ellipse of this many standard deviations
SHADOW_OPACITY = 0.3  # fainter ones do not shade


@dataclass(frozen=True, kw_only=True)
class Packed:
    """Every surface of a scene, relative to `origin`; never empty: absent kinds have one dummy."""

    origin: NDArray[np.float64]  # (3,) [m] middle of the content
    radius: float  # [m] of a sphere about the origin that holds it
    n_triangles: int
    n_ellipsoids: int
    points: Single  # (V, 3) [m]
    triangles: Index  # (T, 3)
    normals: Single  # (T, 9)
    colours: Single  # (T, 9) linear
    uvs: Single  # (T, 6)
    finish: Single  # (T, 2) roughness, metallic
    skin: Index  # (T,) into the atlas, or -1
    atlas: Atlas
    centres: Single  # (N, 3) [m] of ellipsoids
    inverses: Single  # (N, 9) [1/m]
    reach: Single  # (N,) [m] longest semi-axis
    tint: Single  # (N, 3) linear
    blob_centres: Single  # (B, 3) [m] of what shades as a flat ellipse
    blob_covariances: Single  # (B, 6) [m^2] xx xy xz yy yz zz


def content(scene: Scene) -> Floats:
    """(K, 3) [m] points whose bounding box holds everything in the scene but the strays of
    captures; (0, 3) where nothing.
    """
    parts: list[Floats] = [np.asarray(mesh.points, dtype=np.float64) for mesh in scene.meshes]
    for cloud in scene.ellipsoids:
        reach = np.linalg.norm(cloud.axes, axis=2)
        parts += [cloud.positions - reach, cloud.positions + reach]
    for splats in scene.splats:
        held = slice(None) if splats.lit else to_frame(splats.positions, splats.opacities)
        reach = 2.0 * np.linalg.norm(splats.axes[held], axis=2)
        parts += [splats.positions[held] - reach, splats.positions[held] + reach]
    return np.concatenate([np.zeros((0, 3)), *parts])


def covariances(axes: Floats) -> NDArray[np.float64]:
    """Sigma = A A', (N, 3, 3), of axes A (N, 3, 3)."""
    axes = np.asarray(axes, dtype=np.float64)
    return axes @ np.swapaxes(axes, 1, 2)


def pack(scene: Scene) -> Packed:
    """Join the surfaces of a scene, with normals computed where none are authored."""
    extent = content(scene)
    low, high = (extent.min(axis=0), extent.max(axis=0)) if len(extent) else (np.zeros(3),) * 2
    origin = 0.5 * (low + high)
    offsets = np.linalg.norm(extent - origin, axis=1)
    meshes = [mesh for mesh in scene.meshes if len(mesh.triangles)]
    vertex_base = np.cumsum([0] + [len(mesh.points) for mesh in meshes])
    texture_base = np.cumsum([0] + [len(mesh.textures) for mesh in meshes])
    clouds = [cloud for cloud in scene.ellipsoids if len(cloud.positions)]
    axes = _join([np.asarray(c.axes, dtype=np.float64) for c in clouds], (3, 3), np.float64)
    blobs = [_ellipsoid_blobs(c) for c in clouds] + [_splat_blobs(s) for s in scene.splats]
    triangles = _join([m.triangles + b for m, b in zip(meshes, vertex_base)], (3,), np.int32)
    centres = _join([c.positions - origin for c in clouds], (3,))
    return Packed(
        origin=origin,
        radius=1.02 * float(offsets.max(initial=0.0)) or 1.0,
        n_triangles=sum(len(mesh.triangles) for mesh in meshes),
        n_ellipsoids=sum(len(cloud.positions) for cloud in clouds),
        points=_join([mesh.points - origin for mesh in meshes], (3,)),
        triangles=triangles,
        normals=_join([_normals(mesh) for mesh in meshes], (9,)),
        colours=_join([_per_triangle(mesh, mesh.colours, (3, 3)) for mesh in meshes], (9,)),
        uvs=_join([_uvs(mesh) for mesh in meshes], (6,)),
        finish=_join([_finish(mesh) for mesh in meshes], (2,)),
        skin=_join([_skin(m, b) for m, b in zip(meshes, texture_base)], (), np.int32),
        atlas=make_atlas(_textures(meshes)),
        centres=centres,
        inverses=_join([np.linalg.inv(axes).reshape(-1, 9)] if clouds else [], (9,)),
        reach=_join([np.linalg.norm(axes, ord=2, axis=(1, 2))] if clouds else [], ()),
        tint=_join([cloud.colours for cloud in clouds], (3,)),
        blob_centres=_join([p - origin for p, _ in blobs], (3,), at_least=0),
        blob_covariances=_join([c for _, c in blobs], (6,), at_least=0),
    )


def _join(parts: list, shape: tuple[int, ...], dtype: type = np.float32, at_least: int = 1):
    """The parts end to end, each row of a shape; zeros where there are none."""
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


def _finish(mesh: RenderMesh) -> Floats:
    values = (mesh.roughness, mesh.metallic)
    return np.stack([_per_triangle(mesh, value, ()) for value in values], axis=1)


def _skin(mesh: RenderMesh, base: int) -> Index:
    if mesh.triangle_textures is None or mesh.uvs is None:
        return np.full(len(mesh.triangles), -1, dtype=np.int32)
    own = np.asarray(mesh.triangle_textures)
    return np.where(own >= 0, own + base, -1).astype(np.int32)


def _textures(meshes: list[RenderMesh]) -> tuple[Texture, ...]:
    return tuple(texture for mesh in meshes for texture in mesh.textures)


def _upper(matrices: Floats) -> Floats:
    """(N, 6) of symmetric (N, 3, 3)."""
    i, j = np.triu_indices(3)
    return matrices[:, i, j]


def _ellipsoid_blobs(cloud: RenderEllipsoids) -> tuple[Floats, Floats]:
    return cloud.positions, _upper(covariances(cloud.axes))


def _splat_blobs(splats: RenderSplats) -> tuple[Floats, Floats]:
    solid = np.asarray(splats.opacities) >= SHADOW_OPACITY
    return splats.positions[solid], SHADOW_SIGMAS**2 * _upper(covariances(splats.axes[solid]))

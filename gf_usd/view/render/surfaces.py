"""The surface pass: meshes, ellipsoids, floor and shadows into a linear picture.

A scene's surfaces as the flat arrays that kernels read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Texture
from gf_usd.core.scene import RenderEllipsoids, RenderMesh, RenderSplats, Scene, to_frame
from gf_usd.view.render import lighting, raster, shading
from gf_usd.view.render.camera import Lens
from gf_usd.view.render.lights import BOUNCE, SKY, Rig
from gf_usd.view.render.textures import Atlas, corner_normals, make_atlas

OVERSAMPLING = 2  # samples a pixel, each way
KEY_TEXELS = 256  # a side of the depth map of each direction of the key
DOME_TEXELS = 128  # ... of the dome, whose shadows are fainter
FLOOR_TEXELS = 384  # a side of the floor's light map; half of it for the dome
FLOOR_BLUR = 2.5  # [texels] joins the hard shadows of the sampled lights
FAR = np.float32(3e38)

BACKDROP = (0.80, 0.79, 0.775)  # linear, in the middle
BACKDROP_EDGE = (0.50, 0.505, 0.52)  # in the corners


@dataclass(frozen=True, kw_only=True)
class Lit:
    """What a point of the scene can see of its lights."""

    uniforms: NDArray[np.float32]  # (UNIFORM_COUNT,) see gf_usd.view.render.lighting
    rig: Rig
    key: NDArray[np.float32]  # (K, S, S) [m] depth map of each direction of the key
    dome: NDArray[np.float32]  # (D, s, s) [m] ... of the dome
    floor: NDArray[np.float32]  # (G, G, 2) key and dome seen by the floor


def light_up(scene: Scene, packed: Packed, rig: Rig) -> Lit:
    """Draw the depth maps of all lights and the light map of the floor."""
    key = _depths(packed, rig.frames[: rig.key_samples], KEY_TEXELS)
    dome = _depths(packed, rig.frames[rig.key_samples :], DOME_TEXELS)
    uniforms = _uniforms(scene, packed, rig)
    floor = np.ones((FLOOR_TEXELS, FLOOR_TEXELS, 2), dtype=np.float32)
    if scene.ground is not None:
        half = np.empty((FLOOR_TEXELS // 2, FLOOR_TEXELS // 2), dtype=np.float32)
        full = np.empty((FLOOR_TEXELS, FLOOR_TEXELS), dtype=np.float32)
        lighting.shade_floor(uniforms, rig.frames, rig.key_samples, key, dome, full, half)
        for layer, light in enumerate((full, half.repeat(2, axis=0).repeat(2, axis=1))):
            floor[..., layer] = gaussian_filter(light, FLOOR_BLUR, mode="nearest")
    return Lit(uniforms=uniforms, rig=rig, key=key, dome=dome, floor=floor)


def _depths(packed: Packed, frames: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(L, size, size) [m] how far each light of frames (L, 10) sees."""
    depth = np.full((len(frames), size, size), FAR, dtype=np.float32)
    if packed.n_triangles:
        raster.shadow_triangles(packed.points, packed.triangles, frames, packed.radius, depth)
    if len(packed.blob_centers):
        raster.shadow_blobs(
            packed.blob_centers, packed.blob_covariances, frames, packed.radius, depth
        )
    return depth


def draw_surfaces(
    packed: Packed, lit: Lit, lens: Lens, oversampling: int = OVERSAMPLING
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Draw everything but the splats.

    Parameters
    ----------
    lens : of the oversampled picture, width and height multiples of `oversampling`.

    Returns
    -------
    color (H, W, 3) linear, and depth (H, W) [m] behind which each pixel hides everything.
    """
    height, width = lens.height // oversampling, lens.width // oversampling
    key = np.full((lens.height, lens.width), raster.EMPTY, dtype=np.int64)
    clip, camera = lens.clip(packed.points), lens.packed()
    if packed.n_triangles:
        raster.draw_triangles(clip, packed.triangles, lens.near, lens.skew, key)
    if packed.n_ellipsoids:
        raster.draw_ellipsoids(
            packed.centers, packed.inverses, packed.reach, camera, len(packed.triangles), key
        )
    out = np.empty((height, width, 3), dtype=np.float32)
    seen = np.empty((height, width), dtype=np.float32)
    shading.shade(
        key, oversampling, camera,
        clip, packed.triangles, packed.points, packed.normals, packed.colors, packed.uvs,
        packed.finish, packed.skin,
        packed.atlas.texels, packed.atlas.levels, packed.atlas.kinds,
        packed.centers, packed.inverses, packed.tint,
        lit.uniforms, lit.rig.frames, lit.rig.key_samples, lit.key, lit.dome, lit.floor,
        out, seen,
    )  # fmt: skip
    return out, seen


def irradiance(lit: Lit, points: Floats, normals: Floats) -> NDArray[np.float32]:
    """Diffuse light / pi (N, 3) at points (N, 3) [m, from the origin] with unit normals (N, 3)."""
    out = np.zeros((len(points), 3), dtype=np.float32)
    if len(points):
        lighting.shade_points(
            lit.uniforms, lit.rig.frames, lit.rig.key_samples, lit.key, lit.dome, lit.floor,
            np.ascontiguousarray(points, dtype=np.float32),
            np.ascontiguousarray(normals, dtype=np.float32), out,
        )  # fmt: skip
    return out


def _uniforms(scene: Scene, packed: Packed, rig: Rig) -> NDArray[np.float32]:
    """Lights, backdrop and floor as the kernels read them."""
    uniforms = np.zeros(lighting.UNIFORM_COUNT, dtype=np.float32)
    up, key = np.array(scene.up, dtype=np.float64), np.array(rig.key.direction)

    def put(slot: int, value: Floats | tuple[float, float, float]) -> None:
        uniforms[slot : slot + 3] = value

    put(lighting.UP, up)
    put(lighting.KEY_DIR, key)
    put(lighting.KEY, rig.key.radiance)
    put(lighting.FILL_DIR, rig.fill.direction if rig.fill else up)
    put(lighting.FILL, rig.fill.radiance if rig.fill else (0.0, 0.0, 0.0))
    put(lighting.SKY, SKY)
    put(lighting.BOUNCE, BOUNCE)
    put(lighting.CENTER, BACKDROP)
    put(lighting.EDGE, BACKDROP_EDGE)
    uniforms[lighting.RADIUS] = packed.radius
    uniforms[lighting.KEY_SPREAD] = np.tan(np.radians(rig.key.angle))

    # the floor's map holds the footprint and the key's shadow, which falls away from the light
    center_height = float(packed.origin @ up)
    ground = FAR if scene.ground is None else scene.ground - center_height
    uniforms[lighting.FLOOR] = ground
    slope = max(float(key @ up), 0.1)
    drop = 0.0 if scene.ground is None else max(-float(ground), 0.0)
    shadow = -(key - (key @ up) * up) / slope * drop
    x_axis = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    x_axis = x_axis / np.linalg.norm(x_axis)
    put(lighting.MAP_X, x_axis)
    put(lighting.MAP_Y, np.cross(up, x_axis))
    put(lighting.MAP_O, 0.5 * shadow - drop * up)
    uniforms[lighting.MAP_HALF] = 2.6 * packed.radius + 0.5 * float(np.linalg.norm(shadow))
    return uniforms


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
    colors: Single  # (T, 9) linear
    uvs: Single  # (T, 6)
    finish: Single  # (T, 2) roughness, metallic
    skin: Index  # (T,) into the atlas, or -1
    atlas: Atlas
    centers: Single  # (N, 3) [m] of ellipsoids
    inverses: Single  # (N, 9) [1/m]
    reach: Single  # (N,) [m] longest semi-axis
    tint: Single  # (N, 3) linear
    blob_centers: Single  # (B, 3) [m] of what shades as a flat ellipse
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
    centers = _join([c.positions - origin for c in clouds], (3,))
    return Packed(
        origin=origin,
        radius=1.02 * float(offsets.max(initial=0.0)) or 1.0,
        n_triangles=sum(len(mesh.triangles) for mesh in meshes),
        n_ellipsoids=sum(len(cloud.positions) for cloud in clouds),
        points=_join([mesh.points - origin for mesh in meshes], (3,)),
        triangles=triangles,
        normals=_join([_normals(mesh) for mesh in meshes], (9,)),
        colors=_join([_per_triangle(mesh, mesh.colors, (3, 3)) for mesh in meshes], (9,)),
        uvs=_join([_uvs(mesh) for mesh in meshes], (6,)),
        finish=_join([_finish(mesh) for mesh in meshes], (2,)),
        skin=_join([_skin(m, b) for m, b in zip(meshes, texture_base)], (), np.int32),
        atlas=make_atlas(_textures(meshes)),
        centers=centers,
        inverses=_join([np.linalg.inv(axes).reshape(-1, 9)] if clouds else [], (9,)),
        reach=_join([np.linalg.norm(axes, ord=2, axis=(1, 2))] if clouds else [], ()),
        tint=_join([cloud.colors for cloud in clouds], (3,)),
        blob_centers=_join([p - origin for p, _ in blobs], (3,), at_least=0),
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

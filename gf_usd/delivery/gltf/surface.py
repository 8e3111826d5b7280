"""The surface of a mesh in the form of glTF: a primitive per material, with unique vertices."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Texture
from gf_usd.core.radiance import linear_to_srgb
from gf_usd.core.scene import RenderMesh
from gf_usd.view.report.surface import smooth_groups

DIGITS = 4  # of normals, so that those of one surface are one vertex
QUALITY = 92  # of a picture as JPEG


@dataclass(frozen=True, kw_only=True)
class Primitive:
    """Triangles of one material."""

    points: Ints  # (N,) the point of the mesh that each vertex is
    triangles: Ints  # (T, 3) into the vertices
    normals: Floats  # (N, 3) at the first frame
    uvs: Floats | None  # (N, 2), v = 0 is the top row
    colors: Floats | None  # (N, 3) linear; None where the material's color is all
    texture: int  # into the textures of the mesh; -1 none
    color: tuple[float, float, float]  # linear
    roughness: float
    metallic: float


def primitives_of(mesh: RenderMesh) -> list[Primitive]:
    """The triangles of a mesh by texture, roughness, metallic and whether corners have colors."""
    count = len(mesh.triangles)
    texture = np.full(count, -1) if mesh.triangle_textures is None else mesh.triangle_textures
    colors = np.broadcast_to(np.asarray(mesh.colors, np.float64), (count, 3, 3))
    finish = np.column_stack(
        [
            texture,
            np.broadcast_to(mesh.roughness, count),
            np.broadcast_to(mesh.metallic, count),
        ]
    )
    rows, of = np.unique(finish, axis=0, return_inverse=True)
    found = []
    for number, (image, roughness, metallic) in enumerate(rows.tolist()):
        mine = np.flatnonzero(of.reshape(-1) == number)
        painted = image < 0 and bool(np.ptp(colors[mine].reshape(-1, 3), axis=0).any())
        found.append(
            _primitive(mesh, mine, colors, int(image), float(roughness), float(metallic), painted)
        )
    return found


def _primitive(
    mesh: RenderMesh,
    mine: Ints,
    colors: Floats,
    texture: int,
    roughness: float,
    metallic: float,
    painted: bool,
) -> Primitive:
    corners = np.asarray(mesh.triangles)[mine].reshape(-1)
    shading = mesh.normals
    if shading is None:
        shading = _smooth_normals(mesh)
    normals = np.round(np.asarray(shading, np.float64)[mine].reshape(-1, 3), DIGITS)
    uvs = None
    if texture >= 0 and mesh.uvs is not None:
        uvs = np.asarray(mesh.uvs)[mine].reshape(-1, 2) * (1.0, -1.0) + (0.0, 1.0)
    paint = colors[mine].reshape(-1, 3) if painted else None
    parts = [corners[:, None], *(a for a in (normals, uvs, paint) if a is not None)]
    table = np.concatenate(parts, axis=1).astype(np.float32)
    table[:, 0] = 0.0  # a point number may not fit single precision
    keyed = np.column_stack([corners, table.view(np.int32).astype(np.int64)])
    _, first, of = np.unique(keyed, axis=0, return_index=True, return_inverse=True)
    plain = colors[mine[0], 0] if texture < 0 and not painted else np.ones(3)
    return Primitive(
        points=corners[first],
        triangles=of.reshape(-1, 3),
        normals=_unit(normals[first]),
        uvs=None if uvs is None else uvs[first],
        colors=None if paint is None else paint[first],
        texture=texture if uvs is not None else -1,
        color=(float(plain[0]), float(plain[1]), float(plain[2])),
        roughness=roughness,
        metallic=metallic,
    )


def _smooth_normals(mesh: RenderMesh) -> Floats:
    """(T, 3, 3) area-weighted normals at corners, one for the corners between two creases."""
    spots = np.asarray(mesh.points, np.float64)[np.asarray(mesh.triangles)]
    across = np.cross(spots[:, 1] - spots[:, 0], spots[:, 2] - spots[:, 0])
    crease = np.full(len(spots), mesh.crease_angle)
    group = smooth_groups(mesh.points, mesh.triangles, crease)
    corners = np.repeat(across, 3, axis=0)
    total = np.stack([np.bincount(group, corners[:, k]) for k in range(3)], axis=1)
    return _unit(total)[group].reshape(-1, 3, 3)


def _unit(rows: Floats) -> Floats:
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0])  # of a triangle without area
    return np.where(length > 0.0, rows / np.where(length > 0.0, length, 1.0), up)


def encoded(texture: Texture) -> tuple[bytes, str]:
    """A picture and its media type: PNG or JPEG, whichever is smaller."""
    from PIL import Image

    pixels = np.asarray(texture.pixels)
    if not texture.srgb:
        pixels = np.rint(255.0 * linear_to_srgb(pixels / 255.0)).astype(np.uint8)
    image = Image.fromarray(pixels)
    found = []
    for kind, options in (("png", {"optimize": True}), ("jpeg", {"quality": QUALITY})):
        file = BytesIO()
        image.save(file, kind, **options)
        found.append((file.getvalue(), f"image/{kind}"))
    return min(found, key=lambda made: len(made[0]))


WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648, "black": 33071}


def sampler_of(texture: Texture) -> dict[str, Any]:
    """The glTF sampler of a texture; wrap mode black, which glTF lacks, becomes clamp."""
    return {"wrapS": WRAPS[texture.wrap_s], "wrapT": WRAPS[texture.wrap_t]}

"""The unit sphere and its deformed sibling: one cube-sphere topology, one UV layout."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tools.samples.quads import Quads, cube_sphere
from tools.samples.uv import Atlas, gather, pack

Floats = NDArray[np.float64]

CELLS = 16  # per cube edge: 6 * 16^2 = 1536 quads

X, Y, Z = np.eye(3)
# (outward, right, up) of each cube face; the three of a row share edges in the texture
STRIPS = (
    ((-X, Z, Y), (Z, X, Y), (X, -Z, Y)),
    ((Y, -Z, -X), (-Z, -Y, -X), (-Y, Z, -X)),
)


def radius(direction: Floats) -> Floats:
    """R(d) = 1 + sum c_k H_k(d) over solid harmonics of degree 2, 3 and 4: a lopsided peanut."""
    x, y, z = np.moveaxis(direction, -1, 0)
    waist = 0.5 * (3.0 * x * x - 1.0)
    lean = 0.5 * (5.0 * x**3 - 3.0 * x)
    ridge = y * (3.0 * z * z - y * y)
    saddle = x * z
    lobes = y**4 - 6.0 * y * y * z * z + z**4
    return 1.0 + 0.24 * waist + 0.10 * lean + 0.09 * ridge + 0.16 * saddle + 0.05 * lobes


def level(p: Floats) -> Floats:
    """|p| - R(p / |p|): zero on the deformed sphere, before it is scaled."""
    distance = np.linalg.norm(p, axis=-1)
    return distance - radius(p / distance[..., None])


def enclosed_volume(mesh: Quads) -> float:
    """Volume inside the quads, each taken as two triangles: sum of det(a, b, c) / 6."""
    a, b, c, d = mesh.points[mesh.faces].transpose(1, 0, 2)
    tetrahedra = np.einsum("ij,ij->i", a, np.cross(b, c) + np.cross(c, d))
    return float(tetrahedra.sum() / 6.0)


def deformed(sphere: Quads) -> tuple[Quads, float]:
    """The deformed sphere with the volume of ``sphere``, and the scale that made it so."""
    raw = Quads(
        points=sphere.points * radius(sphere.points)[:, None],
        faces=sphere.faces,
        parts=sphere.parts,
    )
    scale = (enclosed_volume(sphere) / enclosed_volume(raw)) ** (1.0 / 3.0)
    return Quads(points=scale * raw.points, faces=raw.faces, parts=raw.parts), scale


def sphere_quads() -> Quads:
    """The unit sphere, centered on the origin."""
    return cube_sphere(CELLS)


def sphere_atlas(mesh: Quads) -> Atlas:
    """Two strips of three cube faces; the equiangular grid keeps texel density within 1.5."""
    centers = mesh.points[mesh.faces].mean(axis=1)
    outward = np.array([out for strip in STRIPS for out, _, _ in strip])
    cube_face = np.argmax(centers @ outward.T, axis=1)
    charts = []
    for row, strip in enumerate(STRIPS):
        numbers = np.flatnonzero(cube_face // 3 == row)
        vertices, quads = np.unique(mesh.faces[numbers], return_inverse=True)
        quads = quads.reshape(-1, 4)
        flat = np.empty(len(vertices), dtype=complex)
        for column, (out, right, up) in enumerate(strip):
            local = np.unique(quads[cube_face[numbers] == 3 * row + column])
            p = mesh.points[vertices[local]]
            angle = np.arctan2(p @ right, p @ out) + 1j * np.arctan2(p @ up, p @ out)
            flat[local] = column + 2.0 / np.pi * angle
        charts.append((flat, numbers, quads))
    placed = pack([[flat] for flat, _, _ in charts], margin=0.05)
    pairs = zip(placed, charts)
    return gather(
        [(flat, numbers, quads) for [flat], (_, numbers, quads) in pairs], len(mesh.faces)
    )

"""Moments of meshes by tetrahedra, and bodies that lie across any grid."""

from __future__ import annotations

import numpy as np
import trimesh
from solids import sphere, surface


def of_mesh(points, triangles):
    """Volume, first moments (3,) and second moments (3, 3) about the origin.

    By tetrahedra between the origin and the triangles.
    """
    p = points[triangles]
    V = np.einsum("ti,ti->t", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0
    total = p.sum(1)
    C = np.einsum("t,tki,tkj->ij", V, p, p) + np.einsum("t,ti,tj->ij", V, total, total)
    return V.sum(), (V[:, None] * total).sum(0) / 4.0, C / 20.0


def slanted(size):
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.5, 0.7))
    return surface(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def torus():
    mesh = trimesh.creation.torus(1.0, 0.3)
    return surface(np.asarray(mesh.vertices) + 0.37, np.asarray(mesh.faces))


BODIES = {"ball": sphere(), "bar": slanted((2.0, 0.3, 0.3)), "torus": torus()}

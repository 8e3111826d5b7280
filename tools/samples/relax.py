"""Quads drawn onto an implicit surface and evened out along it.

Each pass moves every vertex toward the area-weighted mean of its quads' centers (large quads pull,
so areas even out) and back to f = 0 by Newton's method.  Vertices on a seam between two parts
slide along the curve f = g = 0 only, so that the border between materials is that smooth curve;
where two seams meet, f = g = h = 0 pins the vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tools.samples.implicit import Field, value_and_slope
from tools.samples.quads import Quads

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Seam:
    """The curve g = 0 on the surface, followed by the edges between two groups of parts."""

    between: tuple[set[str], set[str]]
    field: Field


def edges_between(mesh: Quads, left: set[str], right: set[str]) -> Ints:
    """(n, 2) edges with a face of ``left`` on one side and a face of ``right`` on the other."""
    edges = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    sides = [np.repeat(np.isin(mesh.parts, sorted(group)), 4) for group in (left, right)]
    one, other = (np.sort(edges[side], axis=1) @ [1, len(mesh.points)] for side in sides)
    shared = np.intersect1d(one, other).astype(np.int64)
    return np.stack([shared % len(mesh.points), shared // len(mesh.points)], axis=1)


def quad_areas(points: Floats, faces: Ints) -> Floats:
    """Areas (F,) by the diagonals: |d1 x d2| / 2."""
    a, b, c, d = points[faces].transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(c - a, d - b), axis=1)


def newton(points: Floats, fields: Sequence[Field], limit: float) -> Floats:
    """One least-norm step p - J^T (J J^T)^-1 f onto all f = 0, no longer than ``limit``."""
    pairs = [value_and_slope(field, points) for field in fields]
    values = np.stack([value for value, _ in pairs], axis=1)
    jacobian = np.stack([slope for _, slope in pairs], axis=1)
    gram = np.einsum("nik,njk->nij", jacobian, jacobian)
    step = np.einsum("nik,ni->nk", jacobian, np.linalg.solve(gram, values[..., None])[..., 0])
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return points - step * np.minimum(1.0, limit / np.maximum(length, 1e-12))


class Relaxation:
    """Evens out one mesh that is symmetric in x, on a surface that is symmetric in x.

    Parameters
    ----------
    mesh : the topology; its points, exactly symmetric, pair each vertex with its mirror image.
    field : f of the surface.
    seams : curves that the borders between parts follow.
    """

    def __init__(self, mesh: Quads, field: Field, seams: Sequence[Seam] = ()) -> None:
        self.faces, self.field, self.seams = mesh.faces, field, seams
        count = len(mesh.points)
        columns = np.repeat(np.arange(len(mesh.faces)), 4)
        self.incidence = sparse.csr_matrix(
            (np.ones(len(columns)), (mesh.faces.ravel(), columns)), shape=(count, len(mesh.faces))
        )
        edges = [edges_between(mesh, *seam.between) for seam in seams]
        on_seam = np.zeros((count, len(seams)), dtype=bool)
        for k, ends in enumerate(edges):
            on_seam[ends.ravel(), k] = True
        self.groups = [
            (np.flatnonzero((on_seam == kind).all(axis=1)), [s for s, on in zip(seams, kind) if on])
            for kind in np.unique(on_seam, axis=0)
        ]
        both = np.concatenate([np.empty((0, 2), dtype=np.int64), *edges])
        both = np.concatenate([both, both[:, ::-1]])
        self.along = sparse.csr_matrix((np.ones(len(both)), tuple(both.T)), shape=(count, count))
        self.partner = np.empty(count, dtype=np.int64)
        self.partner[np.lexsort(mesh.points.T)] = np.lexsort((mesh.points * MIRROR).T)

    def even(self, points: Floats, passes: int, limit: float) -> Floats:
        """``passes`` sweeps from ``points``; no projection moves a vertex beyond ``limit``."""
        degree = np.asarray(self.along.sum(axis=1))
        seam = degree[:, 0] > 0
        for _ in range(passes):
            area = quad_areas(points, self.faces)
            weight = area + area.mean()  # the mean keeps a collapsed quad from staying collapsed
            pull = self.incidence @ (weight[:, None] * points[self.faces].mean(axis=1))
            goal = pull / (self.incidence @ weight)[:, None]
            goal[seam] = (self.along @ points)[seam] / degree[seam]
            points = self.settle(0.5 * (points + goal), limit)
        return points

    def settle(self, points: Floats, limit: float) -> Floats:
        """One Newton step to the surface, and to the curves for the seams; exactly symmetric."""
        moved = points.copy()
        for members, seams in self.groups:
            fields = [self.field, *(seam.field for seam in seams)]
            moved[members] = newton(points[members], fields, limit)
        return 0.5 * (moved + moved[self.partner] * MIRROR)

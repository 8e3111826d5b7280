"""Cages of subdivision surfaces: reading from a stage, and refinement until their edges are short.

A refined cage has the same limit surface.  The rendered surface therefore does not change, and the
simulated polygons approximate it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats, Ints, lengths
from gf_usd.core.asset import LimitSurface
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.readers.mesh.divide.catmull_clark import (
    INFINITE,
    Cage,
    Level,
    boundary,
    edge_keys,
    limit,
    refine,
    sharp_edges,
)
from gf_usd.readers.mesh.divide.faces import CORNERS, FACES, POINTS

FIRST = Usd.TimeCode.EarliestTime()  # for attributes that have time samples only
NEAR = 0.005  # of the size of a mesh: a distance well below the spacing of any bake
LARGE = 40_000  # corners, whose refinement takes 0.1 s


def cage_of(mesh: UsdGeom.Mesh, counts: Ints, indices: Ints, points: int) -> Cage | None:
    """The cage of a Catmull-Clark surface; None: the mesh has another scheme, or faces with fewer
    than three corners.

    Creases and corners of points or edges that do not exist are ignored.
    """
    counts, indices = np.asarray(counts, np.int64), np.asarray(indices, np.int64)
    if str(mesh.GetSubdivisionSchemeAttr().Get()) != UsdGeom.Tokens.catmullClark:
        return None
    if len(counts) == 0 or counts.min() < 3:
        return None
    cage = Cage(
        counts=counts, indices=indices, points=points,
        edge_sharpness=np.zeros(len(indices)), point_sharpness=np.zeros(points),
    )  # fmt: skip
    ends, sharpness = _creases(mesh, points)
    if len(ends):
        sharp, where = np.unique(edge_keys(ends, points), return_inverse=True)
        most = np.zeros(len(sharp))
        np.maximum.at(most, where.reshape(-1), sharpness)
        edges = cage.edges()
        keys = edge_keys(edges.ends, points)
        at = np.searchsorted(sharp, keys).clip(max=len(sharp) - 1)
        cage.edge_sharpness[:] = np.where(sharp[at] == keys, most[at], 0.0)[edges.of]
    at, sharpness = _corners(mesh, points)
    np.maximum.at(cage.point_sharpness, at, sharpness)
    if str(mesh.GetInterpolateBoundaryAttr().Get(FIRST)) != UsdGeom.Tokens.edgeOnly:
        outer = boundary(cage)
        alone = np.bincount(indices, minlength=points)[outer] == 1
        cage.point_sharpness[outer[alone]] = INFINITE
    return cage


def unknown_rule(mesh: UsdGeom.Mesh, counts: Ints) -> str:
    """The reason why the cage of a Catmull-Clark surface cannot be refined; "" where it can.

    counts : (P,) corners of the faces.
    """
    if str(mesh.GetSubdivisionSchemeAttr().Get()) != UsdGeom.Tokens.catmullClark:
        return ""
    if np.min(counts, initial=3) < 3:
        return "it is the cage of a subdivision surface with faces of fewer than three corners"
    if str(mesh.GetInterpolateBoundaryAttr().Get(FIRST)) == UsdGeom.Tokens.none:
        return "it is the cage of a subdivision surface with interpolateBoundary = none"
    smooth = str(mesh.GetTriangleSubdivisionRuleAttr().Get(FIRST)) == UsdGeom.Tokens.smooth
    if smooth and np.min(counts, initial=4) == 3:
        return "it is the cage of a subdivision surface with triangleSubdivisionRule = smooth"
    return ""


def limit_surface(cage: Cage, points: Floats) -> LimitSurface | None:
    """The limit surface of a cage with points (V, 3) [m].

    None where it is within NEAR of all the points, which is assumed of cages with more than LARGE
    corners or with short edges.
    """
    size = float(np.ptp(points, axis=0).max(initial=0.0))
    edges = points[cage.edges().ends]
    longest = lengths(edges[:, 1] - edges[:, 0]).max(initial=0.0)
    if len(cage.indices) > LARGE or longest <= NEAR * size:
        return None
    level = refine(cage)
    refined = level.points(points)
    shift = float(lengths(limit(level, refined, cage.points) - points).max())
    if shift <= NEAR * size:
        return None
    finer = refine(level.cage)
    there = finer.points(refined)
    triangles = triangulate(there, finer.cage.counts, finer.cage.indices)[0]
    return LimitSurface(shift=shift, volume=abs(signed_volume(there, triangles)))


@dataclass(frozen=True, kw_only=True)
class RefinedCage:
    """A cage after some levels of refinement."""

    cage: Cage
    levels: tuple[Level, ...]

    @property
    def last(self) -> Cage:
        """The most refined cage."""
        return self.levels[-1].cage if self.levels else self.cage

    @property
    def counts(self) -> Ints:
        """(P',) corner count of each face."""
        return self.last.counts

    @property
    def indices(self) -> Ints:
        """(C',) point of each corner."""
        return self.last.indices

    @property
    def face(self) -> Ints:
        """(P',) original face of each refined face."""
        face = np.arange(len(self.cage.counts))
        for level in self.levels:
            face = face[level.face]
        return face

    def values(self, given: Any, elements: str, width: int = 1) -> Any:
        """Refined values (n', ...) of points, faces or corners, from the original ones (n, ...).

        Floating-point values of points are subdivided like the points, others are interpolated;
        integers and other types are taken from the nearest element.  width : values per element.
        """
        given = given.reshape(-1, width, *given.shape[1:])
        out = given if given.dtype.kind != "f" or elements == FACES else given.astype(float)
        for level in self.levels:
            if elements == FACES:
                out = out[level.face]
            elif elements == CORNERS and given.dtype.kind == "f":
                out = level.corners(out)
            elif elements == CORNERS:
                out = np.repeat(out, 4, axis=0)
            elif given.dtype.kind != "f":
                out = out[level.first]
            else:
                out = level.points(out) if elements == POINTS else level.linear(out)
        return out.reshape(-1, *given.shape[2:]).astype(given.dtype)

    def faces(self, given: Ints) -> Ints:
        """The refined faces of some original faces."""
        return np.flatnonzero(np.isin(self.face, given))

    def smooth_corners(self, given: Floats, linear: str) -> Floats:
        """Refined face-varying values (C, ...), smooth within the regions between seams.

        linear : faceVaryingLinearInterpolation of the mesh; `all` is `values`.
        """
        table, cage = _regions(self.cage, given.astype(float), linear)
        for _ in self.levels:
            level = refine(cage)
            table, cage = level.points(table), level.cage
        return table[cage.indices].astype(given.dtype)

    def author(self, mesh: UsdGeom.Mesh) -> None:
        """Author the creases and corners that remain sharp after refinement, if there were any."""
        last = self.last
        if mesh.GetCreaseIndicesAttr().HasAuthoredValue():
            edges, sharpness = sharp_edges(last)
            mesh.GetCreaseIndicesAttr().Set(edges.astype(np.int32).ravel())
            mesh.CreateCreaseLengthsAttr().Set(np.full(len(edges), 2, np.int32))
            mesh.CreateCreaseSharpnessesAttr().Set(sharpness.astype(np.float32))
        if mesh.GetCornerIndicesAttr().HasAuthoredValue():
            at = np.flatnonzero(last.point_sharpness > 0.0)
            mesh.GetCornerIndicesAttr().Set(at.astype(np.int32))
            mesh.CreateCornerSharpnessesAttr().Set(last.point_sharpness[at].astype(np.float32))


def refine_until(
    cage: Cage, points: Floats, short: Callable[[Floats, Ints, Ints], bool], most: int
) -> RefinedCage | None:
    """Refine a cage with points (V, 3) until its faces are short; None: more than `most` quads."""
    levels: list[Level] = []
    now = cage
    while not short(points, now.counts, now.indices):
        if len(now.indices) > most:
            return None
        levels.append(refine(now))
        points, now = levels[-1].points(points), levels[-1].cage
    return RefinedCage(cage=cage, levels=tuple(levels))


def _creases(mesh: UsdGeom.Mesh, points: int) -> tuple[Ints, Floats]:
    """(K, 2) points of the crease edges, and (K,) their sharpness."""
    along = np.asarray(mesh.GetCreaseIndicesAttr().Get(FIRST) or (), np.int64)
    sizes = np.asarray(mesh.GetCreaseLengthsAttr().Get(FIRST) or (), np.int64)
    sharpness = np.asarray(mesh.GetCreaseSharpnessesAttr().Get(FIRST) or (), float)
    nothing = np.zeros((0, 2), np.int64), np.zeros(0)
    if len(sizes) == 0 or sizes.min() < 2 or sizes.sum() != len(along):
        return nothing
    last = np.cumsum(sizes) - 1
    begin = np.setdiff1d(np.arange(len(along)), last)
    crease = np.repeat(np.arange(len(sizes)), sizes)[begin]
    if len(sharpness) == len(sizes):
        sharpness = sharpness[crease]
    elif len(sharpness) != len(begin):
        return nothing
    ends = np.stack([along[begin], along[begin + 1]], 1)
    there = ((ends >= 0) & (ends < points)).all(1) & (sharpness > 0.0)
    return ends[there], np.minimum(sharpness[there], INFINITE)


def _corners(mesh: UsdGeom.Mesh, points: int) -> tuple[Ints, Floats]:
    """(K,) points of sharp corners, and (K,) their sharpness."""
    at = np.asarray(mesh.GetCornerIndicesAttr().Get(FIRST) or (), np.int64)
    sharpness = np.asarray(mesh.GetCornerSharpnessesAttr().Get(FIRST) or (), float)
    if len(at) != len(sharpness):
        return np.zeros(0, np.int64), np.zeros(0)
    there = (at >= 0) & (at < points) & (sharpness > 0.0)
    return at[there], np.minimum(sharpness[there], INFINITE)


def _regions(cage: Cage, given: Floats, linear: str) -> tuple[Floats, Cage]:
    """Values of corners as a table (n, ...), and a cage of its rows that seams cut open.

    What stays where it is at seams is as USD defines it: nothing (none), values that a region has
    in one face alone (cornersOnly), those at points with three and more values, too (cornersPlus1
    and cornersPlus2), or all values at seams (boundaries).
    """
    flat = np.column_stack([cage.indices, given.reshape(len(given), -1)])
    _, first, row = np.unique(flat, axis=0, return_index=True, return_inverse=True)
    row = row.reshape(-1)
    point = cage.indices[first]
    sharpness = cage.point_sharpness[point].copy()
    regions = Cage(
        counts=cage.counts, indices=row, points=len(first),
        edge_sharpness=cage.edge_sharpness, point_sharpness=sharpness,
    )  # fmt: skip
    tokens = UsdGeom.Tokens
    if linear != tokens.none:
        sharpness[np.bincount(row, minlength=len(first)) == 1] = INFINITE
    if linear in (tokens.cornersPlus1, tokens.cornersPlus2):
        sharpness[np.bincount(point, minlength=cage.points)[point] > 2] = INFINITE
    if linear == tokens.boundaries:
        sharpness[boundary(regions)] = INFINITE
    return given[first], regions

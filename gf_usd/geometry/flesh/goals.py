"""Goal springs: positions of flesh in the skinned pose, and the stiffness of springs to them.

The skinned pose is that of `linear_blend`.  Weights are authored on the surface.  A point inside
the body takes those of the nearest surface samples, averaged with w ~ 1 / (d^2 + e^2)^2, where e is
a share of the sample spacing.

A goal weight g in 0..1 gives springs of the frequency f sqrt(g / (1 - g)): 0 at g = 0, f at
g = 1/2, infinite at g = 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints, cross
from gf_usd.core.asset import Surface
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.neighbors import nearest
from gf_usd.core.stage import FleshLimits, Goals, Skeleton
from gf_usd.geometry.flesh.linear_blend import bone_transforms, skinned
from gf_usd.geometry.solid import Solid

NEAR = 16  # surface samples that are averaged for a point inside
SMOOTH = 0.5  # of the sample spacing: e
UNPAINTED = 0.5  # goal weight of a mesh without painted goals: frequency f


@dataclass(frozen=True, kw_only=True)
class SkinSamples:
    """Samples of the surface, with their bone weights and goal weights."""

    X: Floats  # (n, 3) [m] at rest
    weights: sparse.csr_matrix  # (n, bones) rows sum to 1, or are empty
    goal: Floats  # (n,) 0..1
    spacing: float  # [m] of the samples

    def around(self, X: Floats) -> sparse.csr_matrix:
        """(m, n) averaging weights of the samples near points X (m, 3) [m]."""
        k = min(NEAR, len(self.X))
        distance, near = nearest(self.X, X, k)
        w = 1.0 / (distance**2 + (SMOOTH * self.spacing) ** 2) ** 2
        w /= w.sum(1, keepdims=True)
        rows = np.repeat(np.arange(len(X)), k)
        return sparse.csr_matrix((w.ravel(), (rows, near.ravel())), shape=(len(X), len(self.X)))


def flesh_goals(
    solid: Solid,
    samples: SurfaceSamples,
    skeleton: Skeleton,
    painted: Mapping[str, Floats],
    *,
    frequency: float,
    damping: float,
    spacing: float,
    limits: FleshLimits | None = None,
    keys: Sequence[Mapping[str, Floats]] = (),
    key_of_frame: Sequence[int] = (),
) -> Goals:
    """Springs to the skinned pose.  A surface without bone weights has no springs.

    painted : (C,) goal weights at face corners, by prim path; NaN: not authored.
    frequency : [Hz] at a goal weight of 1/2; 0: no springs.
    damping : damping ratio.
    spacing : [m] of the samples.
    limits : constraints that are passed on.
    keys, key_of_frame : goal weights over time, as `painted`, and the index of those in effect at
        each frame; empty: they are constant.
    """
    skin = on_skin(solid, samples.X)
    linear, offset = bone_transforms(skeleton)
    offsets = skeleton.samples.offsets if skeleton.samples else ()
    moving = bool((linear != np.eye(3)).any() or offset.any())
    moving = moving or any(one.any() for one in offsets)
    springs = _Springs(
        drawn=_skin_samples(solid, samples, skeleton, painted, spacing, skin),
        linear=linear,
        offset=offset,
        offsets=tuple(offsets),
        frequency=frequency,
        keyed=tuple(_painted_goal(solid, skin, key, len(samples.X)) for key in keys),
        key_of_frame=tuple(key_of_frame),
    )
    return Goals(
        pose=springs.pose,
        rate=springs.rate,
        rates=springs.rates if keys else None,
        damping=damping,
        moving=moving or len(keys) > 1,
        limits=limits,
    )


@dataclass(frozen=True, kw_only=True)
class _Springs:
    """The functions of `Goals`; a class, because plans with closures cannot be pickled."""

    drawn: SkinSamples
    linear: Floats  # (F, bones, 3, 3) as in `bone_transforms`
    offset: Floats  # (F, bones, 3) [m]
    offsets: tuple[Floats, ...]  # of each frame, (n, 3) [m] added to the samples
    frequency: float  # [Hz]
    keyed: tuple[Floats, ...]  # (n,) goal weights of the samples over time
    key_of_frame: tuple[int, ...]

    def pose(self, X: Floats) -> Callable[[float], Floats]:
        """See `Goals`."""
        around = self.drawn.around(X)
        weights = around @ self.drawn.weights
        known = np.asarray(weights.sum(1)).ravel()
        weights = sparse.csr_matrix(sparse.diags_array(1.0 / np.where(known, known, 1.0)) @ weights)

        def at(frame: float) -> Floats:
            k = int(np.clip(round(frame), 0, len(self.linear) - 1))
            moved = skinned(weights, self.linear[k], self.offset[k], X)
            if len(self.offsets):
                moved += around @ self.offsets[k]
            return np.where(known[:, None] > 0.0, moved, X)

        return at

    def rate(self, X: Floats) -> Floats:
        """See `Goals`."""
        return self._of_goal(self.drawn.around(X), self.drawn.goal)

    def rates(self, X: Floats) -> Callable[[float], Floats]:
        """See `Goals`."""
        around = self.drawn.around(X)

        def at(frame: float) -> Floats:
            k = int(np.clip(round(frame), 0, len(self.key_of_frame) - 1))
            return self._of_goal(around, self.keyed[self.key_of_frame[k]])

        return at

    def _of_goal(self, around: sparse.csr_matrix, goal: Floats) -> Floats:
        """(n,) [rad/s]; around : (n, samples) of `SkinSamples.around`; goal : of the samples."""
        posed = np.asarray((around @ self.drawn.weights).sum(1)).ravel()
        g = np.clip(around @ goal, 0.0, 1.0)
        if self.frequency == 0.0:
            return np.zeros(around.shape[0])
        with np.errstate(divide="ignore"):
            return np.asarray(2.0 * np.pi * self.frequency * posed * np.sqrt(g / (1.0 - g)))


def _skin_samples(
    solid: Solid,
    samples: SurfaceSamples,
    skeleton: Skeleton,
    painted: Mapping[str, Floats],
    spacing: float,
    skin: Sequence[OnSkin],
) -> SkinSamples:
    """The samples, with the weights at the nearest surface points."""
    bones, count = len(skeleton.bones), len(samples.X)
    total = sparse.csr_matrix((count, bones))
    goal = _painted_goal(solid, skin, painted, count)
    for surface, near in zip(solid.surfaces, skin):
        known = skeleton.weights.get(surface.path)
        if known is not None:
            total += near.to_points(len(surface.points)) @ weights_with_thickened(surface, known)
    if skeleton.samples is not None:
        total = skeleton.samples.weights
    return SkinSamples(X=samples.X, weights=sparse.csr_matrix(total), goal=goal, spacing=spacing)


def weights_with_thickened(surface: Surface, weights: sparse.csr_matrix) -> sparse.csr_matrix:
    """Weights (V, bones) of all points of a surface, from those of its authored ones.

    A thickened surface has more points, after the authored ones: each takes the weights of the
    nearest of these.
    """
    count = weights.shape[0]
    more = surface.points[count:]
    if not len(more):
        return weights
    rows = nearest(surface.points[:count], more, 1)[1].ravel()
    return sparse.csr_matrix(sparse.vstack([weights, weights[rows]]))


def _painted_goal(
    solid: Solid, skin: Sequence[OnSkin], painted: Mapping[str, Floats], count: int
) -> NDArray[np.float64]:
    """(count,) goal weights of the samples, from those painted at the face corners."""
    goal = np.full(count, UNPAINTED)
    for surface, near in zip(solid.surfaces, skin):
        if (values := painted.get(surface.path)) is not None:
            weight = np.asarray(values)[surface.triangle_corners[near.source]]
            weight = np.where(np.isnan(weight), UNPAINTED, weight)
            goal[near.rows] = (near.share * weight).sum(1)
    return goal


@dataclass(frozen=True, kw_only=True)
class OnSkin:
    """Closest points on one surface, for the query points that are nearest to it."""

    rows: Ints  # (k,) indices of the query points
    count: int  # of all query points
    corners: Ints  # (k, 3) vertices of the closest triangle
    share: Floats  # (k, 3) barycentric coordinates
    source: Ints  # (k,) row of the triangle in Surface.triangles

    def to_points(self, points: int) -> sparse.csr_matrix:
        """(count, points) interpolation from the surface's points; empty rows for other queries."""
        rows = np.repeat(self.rows, 3)
        values = (self.share.ravel(), (rows, self.corners.ravel()))
        return sparse.csr_matrix(values, shape=(self.count, points))


def on_skin(solid: Solid, X: Floats) -> list[OnSkin]:
    """Closest points of X (n, 3) [m] on the surfaces, grouped by surface."""
    best, of = np.full(len(X), np.inf), np.zeros(len(X), np.int64)
    found = []
    for s, (surface, triangles) in enumerate(zip(solid.surfaces, solid.triangles)):
        points = np.ascontiguousarray(surface.points, dtype=float)
        squared, face, at = igl.point_mesh_squared_distance(X, points, triangles)
        squared, face = np.asarray(squared).reshape(-1), np.asarray(face).reshape(-1)
        closer = squared < best
        best[closer], of[closer] = squared[closer], s
        found.append((triangles[face], _barycentric(np.asarray(at), points[triangles[face]]), face))
    out = []
    for s, (corners, share, face) in enumerate(found):
        rows = np.flatnonzero(of == s)
        out.append(
            OnSkin(
                rows=rows,
                count=len(X),
                corners=corners[rows],
                share=share[rows],
                source=solid.sources[s][face[rows]],
            )
        )
    return out


def _barycentric(at: Floats, corners: Floats) -> NDArray[np.float64]:
    """(n, 3) barycentric coordinates of points (n, 3) in triangles of corners (n, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = cross(b - a, c - a)
    double = np.maximum((normal * normal).sum(1), np.finfo(float).tiny)
    u = (cross(c - b, at - b) * normal).sum(1) / double
    v = (cross(a - c, at - c) * normal).sum(1) / double
    out = np.clip(np.stack([u, v, 1.0 - u - v], 1), 0.0, 1.0)
    return np.asarray(out / out.sum(1, keepdims=True))

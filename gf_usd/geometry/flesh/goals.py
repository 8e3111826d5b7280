"""Goals of flesh: where the skeleton's skinning has it, and how strongly it is drawn there.

The skinned pose of a point with weights w_j of the bones is (linear blend skinning)

    x(X, t) = sum_j w_j (A_j(t) X + b_j(t))

Weights are known on the skin.  A point inside the body takes those of the samples of the skin
nearest to it, by w ~ 1 / (d^2 + e^2)^2 with e a part of their spacing.

A goal g in 0..1 stands for springs of the frequency f sqrt(g / (1 - g)): none at 0, f at 1/2, and
no end at 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import SurfaceSamples
from gf_usd.core.neighbors import nearest
from gf_usd.core.stage import FleshLimits, Goals, Skeleton
from gf_usd.geometry.solid import Solid

NEAR = 16  # samples of the skin that a point inside takes its weights of
SMOOTH = 0.5  # of their spacing: within it, distances count alike
UNPAINTED = 0.5  # goal of a mesh on which nothing is painted: the frequency asked for


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Samples of the skin."""

    X: Floats  # (n, 3) [m] at rest
    weights: sparse.csr_matrix  # (n, bones) each row 1 in all, or nothing
    goal: Floats  # (n,) 0..1
    spacing: float  # [m] between them

    def around(self, X: Floats) -> sparse.csr_matrix:
        """(m, n) averages over the samples near points X (m, 3)."""
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
    """Springs to the skinned pose.

    painted : (C,) goals at the corners of the faces, by prim path, NaN: nothing is said; frequency
    : [Hz] where the goal is 1/2, 0: no springs; damping : ratio; spacing : [m] of the samples;
    limits : besides.  keys : what is painted over time, as `painted`, and which of them counts at
    each frame; none: it stays.  A surface that no bone poses has no springs.
    """
    skin = on_skin(solid, samples.X)
    drawn = _drawn(solid, samples, skeleton, painted, spacing, skin)
    linear, offset = affine(skeleton)
    moving = bool((linear != np.eye(3)).any() or offset.any())

    offsets = skeleton.samples.offsets if skeleton.samples else ()
    moving = moving or any(one.any() for one in offsets)

    def pose(X: Floats) -> Callable[[float], Floats]:
        around = drawn.around(X)
        weights = around @ drawn.weights
        known = np.asarray(weights.sum(1)).ravel()
        weights = sparse.csr_matrix(sparse.diags_array(1.0 / np.where(known, known, 1.0)) @ weights)

        def at(frame: float) -> Floats:
            k = int(np.clip(round(frame), 0, len(linear) - 1))
            A = (weights @ linear[k].reshape(-1, 9)).reshape(-1, 3, 3)
            moved = np.einsum("nab,nb->na", A, X) + weights @ offset[k]
            if len(offsets):
                moved += around @ offsets[k]
            return np.where(known[:, None] > 0.0, moved, X)

        return at

    def of_goal(around: sparse.csr_matrix, goal: Floats) -> Floats:
        posed = np.asarray((around @ drawn.weights).sum(1)).ravel()
        g = np.clip(around @ goal, 0.0, 1.0)
        if frequency == 0.0:
            return np.zeros(around.shape[0])
        with np.errstate(divide="ignore"):
            return np.asarray(2.0 * np.pi * frequency * posed * np.sqrt(g / (1.0 - g)))

    keyed = [_painted_goal(solid, skin, key, len(samples.X)) for key in keys]

    def rates(X: Floats) -> Callable[[float], Floats]:
        around = drawn.around(X)

        def at(frame: float) -> Floats:
            k = int(np.clip(round(frame), 0, len(key_of_frame) - 1))
            return of_goal(around, keyed[key_of_frame[k]])

        return at

    return Goals(
        pose=pose,
        rate=lambda X: of_goal(drawn.around(X), drawn.goal),
        rates=rates if keys else None,
        damping=damping,
        moving=moving or len(keys) > 1,
        limits=limits,
    )


def affine(skeleton: Skeleton) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A (F, bones, 3, 3) and b (F, bones, 3) [m] of the bones at each frame."""
    rest = np.stack([bone.anchors for bone in skeleton.bones])  # (B, 4, 3)
    path = np.stack([bone.path for bone in skeleton.bones], 1)  # (F, B, 4, 3)
    edges = np.linalg.inv(rest[:, 1:] - rest[:, :1])
    linear = np.swapaxes(edges @ (path[:, :, 1:] - path[:, :, :1]), 2, 3)
    offset = path[:, :, 0] - np.einsum("fbac,bc->fba", linear, rest[:, 0])
    return linear, offset


def _drawn(
    solid: Solid,
    samples: SurfaceSamples,
    skeleton: Skeleton,
    painted: Mapping[str, Floats],
    spacing: float,
    skin: Sequence[OnSkin],
) -> Drawn:
    """The samples, each with what the skin has at the point nearest to it."""
    bones, count = len(skeleton.bones), len(samples.X)
    total = sparse.csr_matrix((count, bones))
    goal = _painted_goal(solid, skin, painted, count)
    for surface, near in zip(solid.surfaces, skin):
        known = skeleton.weights.get(surface.path)
        if known is not None:
            total += near.to_points(len(surface.points)) @ known
    if skeleton.samples is not None:
        total = skeleton.samples.weights
    return Drawn(X=samples.X, weights=sparse.csr_matrix(total), goal=goal, spacing=spacing)


def _painted_goal(
    solid: Solid, skin: Sequence[OnSkin], painted: Mapping[str, Floats], count: int
) -> NDArray[np.float64]:
    """(count,) goals of the samples, of what is painted at the corners of the faces."""
    goal = np.full(count, UNPAINTED)
    for surface, near in zip(solid.surfaces, skin):
        if (values := painted.get(surface.path)) is not None:
            said = np.asarray(values)[surface.triangle_corners[near.source]]
            said = np.where(np.isnan(said), UNPAINTED, said)
            goal[near.rows] = (near.share * said).sum(1)
    return goal


@dataclass(frozen=True, kw_only=True)
class OnSkin:
    """Those of some points that are nearest to one surface, and where on it they are."""

    rows: Ints  # (k,) of the points
    count: int  # of all points
    corners: Ints  # (k, 3) points of the triangle
    share: Floats  # (k, 3) of its corners
    source: Ints  # (k,) row of it in Surface.triangles

    def to_points(self, points: int) -> sparse.csr_matrix:
        """(count, points) shares of the points of the surface; empty rows for other points."""
        rows = np.repeat(self.rows, 3)
        values = (self.share.ravel(), (rows, self.corners.ravel()))
        return sparse.csr_matrix(values, shape=(self.count, points))


def on_skin(solid: Solid, X: Floats) -> list[OnSkin]:
    """Where on the nearest of the surfaces points X (n, 3) [m] are; a part for each surface."""
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
    """(n, 3) shares of the corners (n, 3, 3) in points (n, 3) of their triangles."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    double = np.maximum((normal * normal).sum(1), np.finfo(float).tiny)
    u = (np.cross(c - b, at - b) * normal).sum(1) / double
    v = (np.cross(a - c, at - c) * normal).sum(1) / double
    out = np.clip(np.stack([u, v, 1.0 - u - v], 1), 0.0, 1.0)
    return np.asarray(out / out.sum(1, keepdims=True))

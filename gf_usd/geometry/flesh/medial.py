"""Bones from the medial axis, for an animated mesh without a skeleton.

Let d be the distance to the surface.  A lattice point Y of the body is medial where d does not grow
at its maximal slope of 1 in any direction, and where no deeper medial point is near, so that the
branches of the medial axis into edges are left out:

    (d(Z) - d(Y)) / |Z - Y| < STEEP      for all neighbors Z of Y
    d(Y) >= SHALLOW d(Z)                 for all medial Z with |Z - Y| < d(Z)

Medial points are grouped into pieces, deepest first, whose distances are about their depths.  A
surface sample x has weights w ~ sum over the points Y of a piece of (u + e)^-4, with u = |x - Y| -
d(Y) the distance to the inscribed ball at Y and e the sample spacing.  A piece has the rigid motion
that fits its samples best (Kabsch 1976).  The residuals are stored as offsets of the samples, so
that the skinned pose reproduces the animated points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.distance import cdist

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Surface
from gf_usd.core.errors import InputError, listed_paths
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.matrices import signed_polar
from gf_usd.core.neighbors import nearest
from gf_usd.core.stage import Bone, SampledSkin, Skeleton
from gf_usd.geometry.flesh.cores import WIDER, Core, Cores
from gf_usd.geometry.flesh.goals import on_skin
from gf_usd.geometry.flesh.linear_blend import bone_transforms, skinned
from gf_usd.geometry.regions import Shape
from gf_usd.geometry.solid import Solid

STEEP, SHALLOW = 0.8, 0.75
NEIGHBORS = 27  # of a lattice point, including itself
MOST = 8000  # lattice points at most
PIECES = 48  # at most
BALLS = 6  # of a piece's core
BETWEEN = 0.4  # of the distance to the next piece, at which a core ends, so that the rest can bend
FEW = 24  # least number of samples that a rigid motion is fitted to
LEAST = 1e-3  # weights below it are ignored
MOST_NAMED = 3  # meshes in a message


def medial_skeleton(
    solid: Solid,
    X: Floats,
    samples: SurfaceSamples,
    frames: Iterable[Mapping[str, Floats]],
    *,
    share: float,
    cell: float,
    spacing: float,
    where: str,
) -> tuple[Skeleton, Cores]:
    """The bones of a body whose surface is animated, and their cores.

    X : (n, 3) [m] lattice points of the body.
    frames : points (V, 3) [m] of the surfaces at each frame, by prim path.
    share, cell : as in `bone_cores`.
    spacing : [m] of the samples.
    where : the file, for messages.

    Raises InputError where the numbers of points differ from those of the surfaces.
    """
    points, depth = medial_points(solid, X[:: max(1, len(X) // MOST)])
    piece, count = _pieces(points, depth, cell)
    weights = _weights(samples.X, points, depth, piece, count, spacing)
    path = _paths(solid, samples.X, frames, where)
    bones = tuple(
        _bone(k, points[piece == k], np.asarray(weights[:, [k]].todense()).ravel(), samples.X, path)
        for k in range(count)
    )
    linear, offset = bone_transforms(Skeleton(bones=bones))
    offsets = [now - skinned(weights, A, b, samples.X) for now, A, b in zip(path, linear, offset)]
    skin = SampledSkin(weights=weights, offsets=offsets)
    return Skeleton(bones=bones, samples=skin), _cores(points, depth, piece, count, share, cell)


def medial_points(solid: Solid, X: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(m, 3) [m] the medial points among lattice points X (n, 3), and their depths (m,) [m].

    Sorted by descending depth.
    """
    skins = [Shape(s.points, t) for s, t in zip(solid.surfaces, solid.triangles, strict=True)]
    depth = np.min([skin.closest(X)[0] for skin in skins], axis=0)
    distance, near = nearest(X, X, min(NEIGHBORS, len(X)))
    rise = depth[near] - depth[:, None]
    slope = np.max(rise / np.where(distance > 0.0, distance, np.inf), axis=1)
    medial = np.flatnonzero((slope < STEEP) | (depth == depth.max()))
    order = medial[np.argsort(-depth[medial], kind="stable")]
    points, deep = np.asarray(X[order], float), np.asarray(depth[order], float)
    most = np.concatenate(
        [
            np.where(cdist(part, points) < deep, deep, 0.0).max(1)
            for part in np.array_split(points, len(points) // 1000 + 1)
        ]
    )
    kept = deep >= SHALLOW * most
    return points[kept], deep[kept]


def _pieces(points: Floats, depth: Floats, cell: float) -> tuple[Ints, int]:
    """(m,) the piece of each medial point, and the number of pieces."""
    centers: list[int] = []
    apart = 1.5 * cell
    while True:
        for k in range(len(points)):
            away = np.linalg.norm(points[centers] - points[k], axis=1)
            if (away > np.maximum(depth[centers], apart)).all():
                centers.append(k)
        if len(centers) <= PIECES:
            return cdist(points, points[centers]).argmin(1), len(centers)
        centers, apart = [], 1.5 * apart


def _weights(
    x: Floats, points: Floats, depth: Floats, piece: Ints, count: int, spacing: float
) -> sparse.csr_matrix:
    """(n, pieces) weights of samples x (n, 3) [m]."""
    member = sparse.csr_matrix((np.ones(len(piece)), (np.arange(len(piece)), piece)),
                               shape=(len(piece), count))  # fmt: skip
    rows = []
    for part in np.array_split(x, max(1, len(x) * len(points) // 4_000_000)):
        away = np.maximum(cdist(part, points) - depth, 0.0)
        w = (away + spacing) ** -4.0 @ member
        w /= w.sum(1, keepdims=True)
        w[w < LEAST] = 0.0
        rows.append(sparse.csr_matrix(w / w.sum(1, keepdims=True)))
    return sparse.csr_matrix(sparse.vstack(rows))


def _paths(
    solid: Solid, x: Floats, frames: Iterable[Mapping[str, Floats]], where: str
) -> NDArray[np.float64]:
    """(F, n, 3) [m] positions of surface samples x (n, 3) at each frame."""
    parts = [
        (surface, near.to_points(len(surface.points)))
        for surface, near in zip(solid.surfaces, on_skin(solid, x))
    ]
    rest = sum(to_points @ surface.points for surface, to_points in parts)
    out = []
    for frame in frames:
        now = np.zeros_like(x)
        for surface, to_points in parts:
            points = frame[surface.path]
            if len(points) != len(surface.points):
                raise _cannot_follow(solid.surfaces, frame, surface, where)
            now += to_points @ points
        out.append(x + now - rest)
    return np.stack(out)


def _cannot_follow(
    surfaces: Sequence[Surface], frame: Mapping[str, Floats], first: Surface, where: str
) -> InputError:
    """The refusal of surfaces of other numbers of points than a frame has, the first of which is
    given.
    """
    # The faces of a thickened sheet are authored ones, and its points are more than those have.
    thick = [
        s.path
        for s in surfaces
        if s.own_points is None and s.face_indices.max() < len(frame[s.path]) < len(s.points)
    ]
    if thick:
        them, they = ("it", "its") if len(thick) == 1 else ("them", "their")
        return InputError(
            f"{where}: {listed_paths(thick, MOST_NAMED)}"
            f" {'is' if len(thick) == 1 else 'are'} open or thin, and --repair made {them} one"
            f" spacing thick; with --flesh the added points cannot follow {they} animated ones",
            "merge meshes that close each other into one whose common points are welded, or close"
            " the holes; make thin parts thicker",
        )
    return InputError(
        f"{where}: --flesh: <{first.path}> has {len(frame[first.path])} points at a frame of its"
        f" animation, and {len(first.points)} at rest",
        "give a cache of a mesh whose number of points does not change",
    )


def _bone(number: int, at: Floats, weight: Floats, x: Floats, path: Floats) -> Bone:
    """The bone of the piece with medial points `at` (k, 3), from weighted samples x (n, 3)."""
    near = nearest(x, at.mean(0, keepdims=True), min(FEW, len(x)))[1].ravel()
    w = weight**2
    if (weight > 0.5).sum() < FEW:
        w[near] += 1.0
    w = w / w.sum()
    P, Q = w @ x, np.einsum("n,fna->fa", w, path)
    R = signed_polar(np.einsum("n,fna,nb->fab", w, path - Q[:, None], x - P))
    size = float(np.linalg.norm(np.ptp(x, axis=0)))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    anchors = at.mean(0) + 0.25 * size * corners
    return Bone(
        name=f"medial:{number}",
        segments=np.zeros((0, 2, 3)),
        free=(),
        anchors=anchors,
        path=np.einsum("fab,kb->fka", R, anchors - P) + Q[:, None],
    )


def _cores(
    points: Floats, depth: Floats, piece: Ints, count: int, share: float, cell: float
) -> Cores:
    """Balls around the medial points of each piece, up to `BETWEEN` of the distance to the next."""
    centers = np.stack([points[piece == k][0] for k in range(count)])
    way = np.sort(cdist(points, centers), axis=1)
    inner = np.ones(len(points), bool)
    if count > 1:
        inner = way[:, 0] <= BETWEEN * (way[:, 0] + way[:, 1])
    cores = []
    for k in range(count):
        mine = np.flatnonzero((piece == k) & inner)
        chosen = mine[np.unique(np.linspace(0, len(mine) - 1, BALLS).astype(int))]
        cores += [
            Core(bone=k, points=points[[i]], radius=share * depth[[i]] + WIDER * cell)
            for i in chosen
        ]
    return Cores(cores=tuple(cores))

"""Meshes bound to a single joint, such as shoes, which can be made rigid.

Grid nodes in such a mesh, and up to `WIDER` cells around it, are constrained to the joint's motion
like those of a bone core, and the points of the mesh follow the joint exactly.  Those that are
apart from the flesh, such as a sword next to a hand, are always rigid, and so are those that are
too thin for the grid, as limbs are (see `cores.bone_cores`).  Accessories, such as hair or eyes,
are rigid unless springs hold them: only the flesh around a bone would, which is in another mesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.stage import Pin, Skeleton
from gf_usd.geometry.flesh.cores import WIDER, Cores, itself
from gf_usd.geometry.regions import Shape
from gf_usd.geometry.solid import Solid


def single_joint_meshes(skeleton: Skeleton) -> dict[str, int]:
    """The bone of each mesh all of whose points are bound to one joint, by prim path.

    Empty where every mesh is bound to a single joint, as in a character of rigid parts: none of
    them is then an accessory of a deformable mesh.
    """
    found = {}
    for path, weights in skeleton.weights.items():
        bones = np.unique(weights.tocoo().col[weights.tocoo().data > 0.0])
        whole = (np.diff(weights.indptr) > 0).all()
        if len(bones) == 1 and whole:
            found[path] = int(bones[0])
    return found if len(found) < len(skeleton.weights) else {}


def named_single_joint_meshes(
    names: Sequence[str], bound: Mapping[str, int], paths: Sequence[str]
) -> list[str]:
    """The names that are prim paths of single-joint meshes, or of prims with such meshes only.

    paths : of all meshes.
    """
    below = {n: [p for p in paths if p == n or p.startswith(f"{n}/")] for n in names}
    return [n for n, found in below.items() if found and all(p in bound for p in found)]


# [cells] from the flesh, beyond which a mesh shares no grid nodes with it that could carry it.
APART = 2.0


def meshes_apart(
    paths: Sequence[str], bound: Mapping[str, int], solid: Solid, cores: Cores, cell: float
) -> list[str]:
    """Those of some single-joint meshes without support by flesh or a core: they would fall.

    cell : [m] edge of a cell.
    """
    filled = {s.path: (s.points, t) for s, t in zip(solid.surfaces, solid.triangles, strict=True)}
    flesh = [(p, Shape(p, t)) for path, (p, t) in filled.items() if path not in bound]
    return [
        path
        for path in paths
        if path in filled
        and not _held(filled[path][0], Shape(*filled[path]), flesh, cores, APART * cell)
    ]


def accessories(
    paths: Sequence[str], bound: Mapping[str, int], solid: Solid, cores: Cores
) -> list[str]:
    """Those of some filled single-joint meshes in which no core is, or mostly in other flesh too.

    They are on a part of the body or in it, and are none themselves, as a head or a foot is.
    """
    if not paths:
        return []
    filled = {s.path: (s.points, t) for s, t in zip(solid.surfaces, solid.triangles, strict=True)}
    inner = _inner(cores)
    elsewhere = np.zeros(len(inner), bool)
    for path, (points, triangles) in filled.items():
        if path not in bound:
            elsewhere |= Shape(points, triangles).encloses(inner)
    return [
        path
        for path in paths
        if path in filled and not _has_own(Shape(*filled[path]).encloses(inner), elsewhere)
    ]


def _inner(cores: Cores) -> Floats:
    """(n, 3) [m] the points of cores that are inside flesh."""
    inside = (core.points[core.radius > 0.0] for core in cores.cores)
    return np.concatenate([np.zeros((0, 3)), *inside])


def _has_own(here: Floats, elsewhere: Floats) -> bool:
    """Whether more than half of the points of cores in a mesh are in no other flesh.

    here, elsewhere : (n,) which of all points are in the mesh, and in other flesh.
    """
    return bool(2 * (here & ~elsewhere).sum() > here.sum())


def thin_meshes(
    paths: Sequence[str], solid: Solid, X: Floats, share: float, cell: float
) -> list[str]:
    """Those of some filled meshes whose core would be as thick as the mesh.

    X : (n, 3) [m] of the particles; share : radius of a core over the distance from its axis, where
    particles are deepest in the mesh, to the surface; cell : [m] edge of a cell.
    """
    filled = {s.path: (s.points, t) for s, t in zip(solid.surfaces, solid.triangles, strict=True)}
    return [
        path
        for path in paths
        if path in filled and (1.0 - share) * Shape(*filled[path]).deepest(X) <= WIDER * cell
    ]


def _held(
    points: Floats,
    shape: Shape,
    flesh: Sequence[tuple[Floats, Shape]],
    cores: Cores,
    reach: float,
) -> bool:
    """Whether the flesh is within reach [m] of a mesh or around it, or a core is in the mesh."""
    if any(shape.encloses(core.points[core.radius > 0.0]).any() for core in cores.cores):
        return True
    return any(
        min(other.closest(points)[0].min(), shape.closest(own)[0].min()) < reach
        or other.encloses(points).any()
        for own, other in flesh
    )


# [cells] from supported flesh, beyond which flesh of several joints is not supported by it.
REACH = 1.0


def loose_meshes(
    skeleton: Skeleton, bound: Mapping[str, int], solid: Solid, cores: Cores, cell: float
) -> tuple[list[str], dict[str, float]]:
    """Meshes bound to several joints that neither a core of their own nor flesh with one holds, and
    the share of the points of each other one without such a core that is near the flesh that holds
    it.

    cell : [m] edge of a cell.
    """
    shapes = {
        s.path: (s.points, Shape(s.points, t))
        for s, t in zip(solid.surfaces, solid.triangles, strict=True)
        if s.path in skeleton.weights and s.path not in bound
    }
    held = _with_cores({path: shape for path, (_, shape) in shapes.items()}, cores)
    if not held:
        return [], {}
    left = [path for path in shapes if path not in held]
    near: dict[str, float] = {}
    for path in held:  # which grows
        for one in left:
            near[one] = _near_share(shapes[one], shapes[path], REACH * cell)
        held += [one for one in left if near[one] > 0.0]
        left = [one for one in left if near[one] == 0.0]
    return left, {path: share for path, share in near.items() if share > 0.0}


def _with_cores(shapes: Mapping[str, Shape], cores: Cores) -> list[str]:
    """The meshes with cores of their own: more than half of the points of cores in one are in none
    of those with more.  The others are around flesh, as a coat whose wall an arm goes through.
    """
    inner = _inner(cores)
    within = {path: shape.encloses(inner) for path, shape in shapes.items()}
    taken, found = np.zeros(len(inner), bool), []
    for path, here in sorted(within.items(), key=lambda one: -int(one[1].sum())):
        if _has_own(here, taken):
            found.append(path)
            taken |= here
    return found


def _near_share(mesh: tuple[Floats, Shape], other: tuple[Floats, Shape], reach: float) -> float:
    """The share of the points of a mesh that are in another one or within reach [m] of it.

    It is not 0 where points of the other one alone are near.
    """
    (a, mine), (b, theirs) = mesh, other
    if (a.min(0) - reach > b.max(0)).any() or (b.min(0) - reach > a.max(0)).any():
        return 0.0
    near = (theirs.closest(a)[0] < reach) | theirs.encloses(a)
    any_near = near.any() or (mine.closest(b)[0] < reach).any() or mine.encloses(b).any()
    return max(float(near.mean()), 1.0 / len(a)) if any_near else 0.0


def single_joint_pins(
    names: Sequence[str], bound: Mapping[str, int], skeleton: Skeleton, solid: Solid, cell: float
) -> tuple[Pin, ...]:
    """A pin for each single-joint mesh at or below one of the names; cell : [m] edge of a cell."""
    mine = [p for p in bound if any(p == n or p.startswith(f"{n}/") for n in names)]
    filled = {s.path: (s.points, t) for s, t in zip(solid.surfaces, solid.triangles, strict=True)}
    return tuple(
        Pin(
            name=path,
            inside=partial(_around, Shape(*filled[path]), WIDER * cell)
            if path in filled
            else _nothing,
            nearest=itself,
            anchors=skeleton.bones[bound[path]].anchors,
            path=skeleton.bones[bound[path]].path,
            sharp=False,
            meshes=frozenset([path]),
        )
        for path in mine
    )


def _around(shape: Shape, width: float, X: Floats) -> Floats:
    """(n,) whether points X (n, 3) [m] are in a shape, or within a width [m] of it."""
    return np.asarray(shape.encloses(X) | (shape.closest(X)[0] < width))


def _nothing(X: Floats) -> Floats:
    """The inside test of an open mesh, which contains no nodes."""
    return np.zeros(len(X), bool)

"""Bones of a UsdSkel skeleton: line segments in the bind pose, and the motion of their joints.

The segments of a joint run from it to each of its children.  A joint whose skinned points are far
from all segments has a segment toward their mean; a leaf joint has one toward the mean of those
beyond it as seen from its parent.

At a frame, a point X of the bind pose that is bound to joint j is at (row vectors)

    x = X W0^-1 B_j^-1 J_j(t) W(t)

with B_j the joint's bind transform, J_j its animated transform, both in the skeleton's space, and W
the skeleton's local-to-world transform, W0 that of the first frame.  The bind pose as a whole is
aligned rigidly with the first frame at the topmost joint with skinned points.

Points without joint weights, such as captured Gaussians, follow the nearest segments of the only
skeleton of the stage, by weights w_j ~ (d_j + e)^-4 with d_j the distance to those of joint j and e
a share of the skeleton's size.  The segment of a leaf joint continues that of its parent, with the
same length and direction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.mesh.triangulation import triangulate
from gf_usd.core.stage import Bone, Skeleton
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.skeleton.joint_motion import joint_motion, skeleton_world, skeleton_worlds
from gf_usd.readers.usd.skeleton.rig import Rig, read_rig
from gf_usd.readers.usd.skeleton.segments import (
    FleshPoints,
    beyond,
    connected_parts,
    direction,
    distance,
    into_flesh,
    near_flesh,
    point_areas,
    slender,
    to_segment,
)
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.stage import open_stage, reading, upwards

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

AWAY = 0.5  # of a joint's longest segment: a mean farther from all of them gets its own segment
SHORT = 1e-6  # of the skeleton's size: a shorter segment is a point
SOFT = 0.01  # of the skeleton's size: e of the weights of points without joint weights
LEAST = 0.02  # smaller ones of these weights are dropped


def animation_range(
    file: Path, paths: Sequence[str], facts: StageFacts, loose: Mapping[str, Floats] | None = None
) -> tuple[float, float]:
    """First and last time code of the skeletal animation of some meshes.

    The stage's own if it authors both, else those of the time samples.  loose : as in
    `read_skeleton`, whose errors it raises.
    """
    with reading(file):
        stage = open_stage(file)
        codes: set[float] = set()
        for rig in _rigs(stage, paths, facts, 0.0, loose):
            animation = rig.query.GetAnimQuery()
            if animation:
                codes.update(animation.GetJointTransformTimeSamples())
                codes.update(animation.GetBlendShapeWeightTimeSamples())
            for one in upwards(rig.prim):
                if placed := UsdGeom.Xformable(one):
                    codes.update(placed.GetTimeSamples())
    first = facts.start_time_code
    last = facts.end_time_code
    if first is None:
        first = min(codes, default=1.0)
    if last is None:
        last = max(codes, default=first)
    return first, max(first, last)


def skeletons(file: Path, paths: Sequence[str], facts: StageFacts) -> dict[str, tuple[str, str]]:
    """By prim path, the Skeleton that each mesh is bound to, and the nearest SkelRoot above it.

    Meshes that are not bound to a skeleton are left out.
    """
    with reading(file):
        stage, time = open_stage(file), Usd.TimeCode.EarliestTime()
        skins = Skins(time, UsdGeom.XformCache(time), Notes(), bind=True)
        out = {}
        for path in paths:
            found = skins.skeleton(named_prim(stage, facts.path, path))
            if found is not None and found[1].HasJointInfluences():
                above = found[0]
                while above and not above.IsA(UsdSkel.Root):
                    above = above.GetParent()
                root = (above or found[0]).GetPath()
                out[path] = str(found[0].GetPath()), str(root)
        return out


def lone_skeleton(file: Path) -> str:
    """Prim path of the only skeleton of a stage, if it is under a SkelRoot; else ""."""
    with reading(file):
        time = Usd.TimeCode.EarliestTime()
        found = Skins(time, UsdGeom.XformCache(time), Notes()).lone(open_stage(file))
        return "" if found is None else str(found.GetPath())


def read_skeleton(
    file: Path,
    paths: Sequence[str],
    facts: StageFacts,
    *,
    first: float,
    times: Sequence[float],
    loose: Mapping[str, Floats] | None = None,
) -> Skeleton:
    """The bones of the skeletons that some meshes are bound to, in the bind pose, and their motion.

    file : the USD file; facts.path is its name in messages.
    paths : prim paths of the meshes.
    first : time code of the first frame of the animation.
    times : (F,) time codes; those before `first` are a pre-roll from the bind pose.
    loose : (V, 3) [m] world points of prims without joint weights, which are skinned to the nearest
        bones of the only skeleton.

    Raises InputError where none of the meshes is bound to a skeleton, and for an invalid skeleton.
    """
    with reading(file):
        stage = open_stage(file)
        bones, weights = [], {}
        for rig in _rigs(stage, paths, facts, first, loose):
            found = _bones(rig, facts, first, np.asarray(times, float))
            weights |= {path: (len(bones), w[:, list(found)]) for path, w in rig.weights.items()}
            bones += found.values()
    return Skeleton(
        bones=tuple(bones),
        weights={path: _placed(w, before, len(bones)) for path, (before, w) in weights.items()},
    )


def _placed(weights: Floats, before: int, count: int) -> csr_matrix:
    """(V, count) matrix with weights (V, k) in the columns from `before`."""
    from scipy.sparse import csr_matrix

    out = np.zeros((len(weights), count))
    out[:, before : before + weights.shape[1]] = weights
    return csr_matrix(out)


def _rigs(
    stage: Usd.Stage,
    paths: Sequence[str],
    facts: StageFacts,
    first: float,
    loose: Mapping[str, Floats] | None,
) -> list[Rig]:
    time, notes = Usd.TimeCode(first), Notes()
    skins = Skins(time, UsdGeom.XformCache(time), notes, bind=True)
    rigs: dict[str, Rig] = {}
    for path in paths:
        prim = named_prim(stage, facts.path, path)
        found = skins.skeleton(prim)
        if found is None or not found[1].HasJointInfluences():
            continue
        skeleton, skin = found
        where = str(skeleton.GetPath())
        if where not in rigs:
            rigs[where] = read_rig(skeleton, skins.query(skeleton), facts)
            rigs[where].bind[:] = rigs[where].bind @ skins.alignment(skeleton)
        _add_flesh(rigs[where], prim, skin, skins, facts)
    if rigs:
        return list(rigs.values())
    lone = skins.lone(stage) if loose else None
    if loose and lone:
        rig = read_rig(lone, skins.query(lone), facts)
        for path, points in loose.items():
            _add_loose(rig, path, points, facts, first)
        return [rig]
    here = f"<{paths[0]}>" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")
    raise InputError(
        f"{facts.path}: --flesh: no skeleton poses {here}",
        "bind the mesh to a Skeleton under a SkelRoot (UsdSkel), with joint indices and weights, or"
        " bake it without --flesh",
    )


def _add_flesh(
    rig: Rig, prim: Usd.Prim, skin: UsdSkel.SkinningQuery, skins: Skins, facts: StageFacts
) -> None:
    """Add the points of a mesh, with their weights and the joint of the largest weight."""
    authored = UsdGeom.PointBased(prim).GetPointsAttr().Get(skins.time)
    points = np.asarray([] if authored is None else authored, np.float64).reshape(-1, 3)
    place = skins.placement(prim)
    found = skin.ComputeVaryingJointInfluences(len(points), skins.time)
    per_point = skin.GetNumInfluencesPerComponent()
    order = skin.GetJointOrder() or rig.joints
    rows = {name: row for row, name in enumerate(rig.joints)}
    known = np.array([rows.get(str(name), -1) for name in order])
    sound = place is not None and found and len(found[0]) == len(points) * per_point
    index = np.asarray(found[0] if sound else [], int).reshape(-1, max(per_point, 1))
    if not sound or not len(points) or index.min() < 0 or index.max() >= len(known):
        raise InputError(
            f"{facts.path}: --flesh: the joint influences of <{prim.GetPath()}> do not fit its"
            f" {len(points)} points and the {len(rig.joints)} joints of <{rig.path}>",
            "bind the mesh again in the program that made it, or bake without --flesh",
        )
    assert place is not None
    weights = np.asarray(found[1], float).reshape(index.shape)
    most = weights.argmax(1)
    owner = known[index[np.arange(len(index)), most]]
    dense = np.zeros((len(points), len(rig.joints)))
    np.add.at(dense, (np.arange(len(points))[:, None], known[index]), np.maximum(weights, 0.0))
    total = dense.sum(1, keepdims=True)
    rig.weights[str(prim.GetPath())] = dense / np.where(total > 0.0, total, 1.0)
    placed = place.points(points) * facts.units.length
    rig.points.append(placed)
    triangles = _triangles(prim, placed, skins.time)
    rig.area.append(point_areas(placed, triangles))
    rig.part.append(connected_parts(placed, triangles))
    rig.owner.append(owner)


def _triangles(prim: Usd.Prim, points: Floats, time: Usd.TimeCode) -> NDArray[np.int64]:
    """(T, 3) the triangles of a mesh with points (V, 3); (0, 3) of a prim without faces."""
    if not prim.IsA(UsdGeom.Mesh):
        return np.zeros((0, 3), np.int64)
    mesh = UsdGeom.Mesh(prim)
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get(time), np.int64)
    corners = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(time), np.int64)
    return triangulate(points, counts, corners)[0]


def _add_loose(rig: Rig, path: str, points: Floats, facts: StageFacts, first: float) -> None:
    """Add world points (V, 3) [m], with weights of the nearest bones."""
    at = _through(rig.bind[:, 3, :3], skeleton_world(rig, first, facts)) * facts.units.length
    size = float(np.linalg.norm(np.ptp(np.concatenate([at, points]), axis=0)))
    away = np.empty((len(points), len(at)))
    for j, start in enumerate(at):
        ends = [at[c] for c in np.flatnonzero(rig.parents == j)]
        if not ends and rig.parents[j] >= 0:
            ends = [2.0 * start - at[rig.parents[j]]]
        ends = [end for end in ends if np.linalg.norm(end - start) > SHORT * size]
        each = [to_segment(points, start, end) for end in ends]
        away[:, j] = np.min(each or [np.linalg.norm(points - start, axis=1)], axis=0)
    weights = (away + SOFT * size) ** -4.0
    weights /= weights.sum(1, keepdims=True)
    weights[weights < LEAST] = 0.0
    rig.weights[path] = weights / weights.sum(1, keepdims=True)
    rig.points.append(np.asarray(points, np.float64))
    rig.area.append(np.ones(len(points)))
    rig.part.append(np.zeros(len(points), np.int64))
    rig.owner.append(weights.argmax(1))


def _bones(rig: Rig, facts: StageFacts, first: float, times: Floats) -> dict[int, Bone]:
    """One bone per joint with a weight, without segments where no point has its largest there."""
    unit = facts.units.length
    rest = skeleton_world(rig, first, facts)
    at = _through(rig.bind[:, 3, :3], rest) * unit
    flesh = FleshPoints(at=np.concatenate(rig.points), area=np.concatenate(rig.area))
    owner = np.concatenate(rig.owner)
    part, joined = _parts(rig, owner)
    size = float(np.linalg.norm(np.ptp(np.concatenate([at, flesh.at]), axis=0)))
    motion = joint_motion(rig, facts, first, times)  # (F, J, 4, 4)
    worlds = skeleton_worlds(rig, facts, first, times)  # (F, 4, 4)
    corners = 0.25 * size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    weighted = np.any([w.any(0) for w in rig.weights.values()], axis=0)
    out = {}
    for j in np.flatnonzero(weighted).tolist():
        own = np.flatnonzero(owner == j)
        own = own[near_flesh(flesh.at[own], part[own], joined[own], at[j])]
        mine = flesh.subset(own)
        ends = [at[c] for c in np.flatnonzero(rig.parents == j)]
        ends = [end for end in ends if np.linalg.norm(end - at[j]) > SHORT * size and len(mine)]
        free = [False] * len(ends)
        middle = mine.mean() if len(mine) else at[j]
        longest = max((float(np.linalg.norm(end - at[j])) for end in ends), default=0.0)
        if len(mine) and (not ends or distance(middle, at[j], ends) > AWAY * longest):
            if rig.parents[j] >= 0:
                mine = beyond(mine, at[j], at[rig.parents[j]])
            ends.append(into_flesh(mine, at[j]))
            free.append(True)
        elif len(ends) == 1 and rig.parents[j] < 0:
            # Behind a root with one child, such as the head of a fish whose root is in its neck.
            behind = mine.subset((mine.at - at[j]) @ (at[j] - ends[0]) > 0.0)
            reach = slender(behind, at[j]) if len(behind) else 0.0
            if reach > SHORT * size:
                ends.append(at[j] + reach * direction(behind, at[j]))
                free.append(True)
        anchors = at[j] + corners
        local = _through(anchors / unit, np.linalg.inv(rest))
        carried = np.linalg.inv(rig.bind[j]) @ motion[:, j] @ worlds
        path = np.stack([_through(local, M) for M in carried]) * unit
        if len(times) and times[0] < first:
            path[0] = anchors
        out[j] = Bone(
            name=f"{rig.path}:{rig.joints[j]}",
            segments=np.array([(at[j], end) for end in ends]).reshape(-1, 2, 3),
            free=tuple(free),
            anchors=anchors,
            path=path,
        )
    return out


def _parts(rig: Rig, owner: Ints) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The connected part of each point (V,) of all meshes, and whether that has points of several
    owners (V,).
    """
    counts = [int(one.max(initial=-1)) + 1 for one in rig.part]
    starts = np.cumsum([0, *counts])
    part = np.concatenate([one + at for one, at in zip(rig.part, starts)])
    least, most = np.full(starts[-1], len(rig.joints)), np.full(starts[-1], -1)
    np.minimum.at(least, part, owner)
    np.maximum.at(most, part, owner)
    return part, (least != most)[part]


def _through(points: Floats, matrix: Floats) -> Floats:
    return np.asarray(points @ matrix[:3, :3] + matrix[3, :3])

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

Times before the first frame are a pre-roll from the bind pose into the animation.  The transform
of each joint, relative to the next ancestor with skinned points, is interpolated from the bind pose
to an extrapolation of the animation, separately in rotation, stretch and translation, with weights
s = 3 r^2 - 2 r^3.  Position and velocity are continuous at the first frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.matrices import signed_polar
from gf_usd.core.stage import Bone, Skeleton
from gf_usd.core.units import code_text
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.skeleton import Skins
from gf_usd.readers.usd.stage import open_stage, reading

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

INTO_FLESH = 1.5  # length of a segment toward the mean of a joint's points, over their distance
AWAY = 0.5  # of a joint's longest segment: a mean farther from all of them gets its own segment
MEMORY = 4.0  # [frames] by which the pre-roll extrapolates the animation backward
SHORT = 1e-6  # of the skeleton's size: a shorter segment is a point
SOFT = 0.01  # of the skeleton's size: e of the weights of points without joint weights
LEAST = 0.02  # smaller ones of these weights are dropped


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A skeleton and the points skinned to it."""

    path: str  # prim path of the Skeleton
    prim: Usd.Prim
    query: UsdSkel.SkeletonQuery
    joints: tuple[str, ...]
    parents: Ints  # (J,) -1: a root
    bind: Floats  # (J, 4, 4) skeleton space, row vectors, aligned: see `Skins.alignment`
    points: list[Floats] = field(default_factory=list)  # (V, 3) [m] bind pose, world
    owner: list[Ints] = field(default_factory=list)  # (V,) joint of the largest weight
    weights: dict[str, Floats] = field(default_factory=dict)  # (V, J) of each mesh, by path


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
            above = rig.prim
            while above and not above.IsPseudoRoot():
                if placed := UsdGeom.Xformable(above):
                    codes.update(placed.GetTimeSamples())
                above = above.GetParent()
    first = facts.start_time_code
    last = facts.end_time_code
    if first is None:
        first = min(codes, default=1.0)
    if last is None:
        last = max(codes, default=first)
    return first, max(first, last)


def has_skeleton(file: Path, paths: Sequence[str], facts: StageFacts) -> bool:
    """Whether any of some meshes is bound to a skeleton."""
    with reading(file):
        stage, time = open_stage(file), Usd.TimeCode.EarliestTime()
        skins = Skins(time, UsdGeom.XformCache(time), Notes(), bind=True)
        found = (skins.skeleton(named_prim(stage, facts.path, path)) for path in paths)
        return any(one is not None and one[1].HasJointInfluences() for one in found)


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
            rigs[where] = _rig(skeleton, skins.query(skeleton), facts)
            rigs[where].bind[:] = rigs[where].bind @ skins.alignment(skeleton)
        _add_flesh(rigs[where], prim, skin, skins, facts)
    if rigs:
        return list(rigs.values())
    lone = skins.lone(stage) if loose else None
    if loose and lone:
        rig = _rig(lone, skins.query(lone), facts)
        for path, points in loose.items():
            _add_loose(rig, path, points, facts, first)
        return [rig]
    here = f"<{paths[0]}>" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")
    raise InputError(
        f"{facts.path}: --flesh: no skeleton poses {here}",
        "bind the mesh to a Skeleton under a SkelRoot (UsdSkel), with joint indices and weights, or"
        " bake it without --flesh",
    )


def _rig(skeleton: Usd.Prim, query: UsdSkel.SkeletonQuery, facts: StageFacts) -> Rig:
    where = f"{facts.path}: --flesh: <{skeleton.GetPath()}>"
    hint = "repair the skeleton in the program that made it, or bake without --flesh"
    if not query:
        raise InputError(f"{where} is no valid skeleton", hint)
    topology = query.GetTopology()
    valid, reason = topology.Validate()
    if not valid:
        raise InputError(f"{where} has joints in an invalid order: {reason}", hint)
    joints = tuple(str(name) for name in query.GetJointOrder())
    given = query.GetJointWorldBindTransforms() if query.HasBindPose() else None
    if not joints or given is None or len(given) != len(joints):
        raise InputError(
            f"{where} has {len(joints)} joints but not a bind transform for each of them",
            "author bindTransforms, one matrix for each joint; they define the rest shape",
        )
    bind = np.array(given, dtype=np.float64).reshape(-1, 4, 4)
    finite = np.where(np.isfinite(bind).all((1, 2), keepdims=True), bind, 0.0)
    flat = np.abs(np.linalg.det(finite[:, :3, :3])) <= 1e-12
    if flat.any():
        raise InputError(
            f"{where}: the bind transforms of {int(flat.sum())} of {len(joints)} joints cannot "
            f"be inverted; the first is {joints[int(flat.argmax())]}",
            hint,
        )
    return Rig(
        path=str(skeleton.GetPath()), prim=skeleton, query=query, joints=joints,
        parents=np.array([topology.GetParent(j) for j in range(len(joints))]), bind=bind,
    )  # fmt: skip


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
    rig.points.append(place.points(points) * facts.units.length)
    rig.owner.append(owner)


def _add_loose(rig: Rig, path: str, points: Floats, facts: StageFacts, first: float) -> None:
    """Add world points (V, 3) [m], with weights of the nearest bones."""
    at = _through(rig.bind[:, 3, :3], _world(rig, first, facts)) * facts.units.length
    size = float(np.linalg.norm(np.ptp(np.concatenate([at, points]), axis=0)))
    away = np.empty((len(points), len(at)))
    for j, start in enumerate(at):
        ends = [at[c] for c in np.flatnonzero(rig.parents == j)]
        if not ends and rig.parents[j] >= 0:
            ends = [2.0 * start - at[rig.parents[j]]]
        ends = [end for end in ends if np.linalg.norm(end - start) > SHORT * size]
        each = [_to_segment(points, start, end) for end in ends]
        away[:, j] = np.min(each or [np.linalg.norm(points - start, axis=1)], axis=0)
    weights = (away + SOFT * size) ** -4.0
    weights /= weights.sum(1, keepdims=True)
    weights[weights < LEAST] = 0.0
    rig.weights[path] = weights / weights.sum(1, keepdims=True)
    rig.points.append(np.asarray(points, np.float64))
    rig.owner.append(weights.argmax(1))


def _to_segment(points: Floats, start: Floats, end: Floats) -> NDArray[np.float64]:
    """(n,) [m] distances of points (n, 3) from a segment."""
    way = end - start
    t = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - t[:, None] * way, axis=1))


def _bones(rig: Rig, facts: StageFacts, first: float, times: Floats) -> dict[int, Bone]:
    """One bone per joint with a weight, without segments where no point has its largest there."""
    unit = facts.units.length
    rest = _world(rig, first, facts)
    at = _through(rig.bind[:, 3, :3], rest) * unit
    flesh, owner = np.concatenate(rig.points), np.concatenate(rig.owner)
    size = float(np.linalg.norm(np.ptp(np.concatenate([at, flesh]), axis=0)))
    motion = _motion(rig, facts, first, times)  # (F, J, 4, 4)
    worlds = _worlds(rig, facts, first, times)  # (F, 4, 4)
    corners = 0.25 * size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    weighted = np.any([w.any(0) for w in rig.weights.values()], axis=0)
    out = {}
    for j in np.flatnonzero(weighted).tolist():
        mine = flesh[owner == j]
        ends = [at[c] for c in np.flatnonzero(rig.parents == j)]
        ends = [end for end in ends if np.linalg.norm(end - at[j]) > SHORT * size and len(mine)]
        free = [False] * len(ends)
        middle = mine.mean(0) if len(mine) else at[j]
        longest = max((float(np.linalg.norm(end - at[j])) for end in ends), default=0.0)
        if len(mine) and (not ends or _distance(middle, at[j], ends) > AWAY * longest):
            if rig.parents[j] >= 0:
                mine = _beyond(mine, at[j], at[rig.parents[j]])
            ends.append(_into_flesh(mine, at[j]))
            free.append(True)
        elif len(ends) == 1 and rig.parents[j] < 0:
            # Behind a root with one child, such as the head of a fish whose root is in its neck.
            behind = mine[(mine - at[j]) @ (at[j] - ends[0]) > 0.0]
            reach = _slender(behind, at[j]) if len(behind) else 0.0
            if reach > SHORT * size:
                ends.append(at[j] + reach * _direction(behind, at[j]))
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


def _beyond(points: Floats, joint: Floats, parent: Floats) -> Floats:
    """Those of points (n, 3) that lie beyond a joint as seen from its parent; all if none does.

    The others lie along the segment of the parent, and would shorten a segment toward the mean or
    turn it back.
    """
    beyond = points[(points - joint) @ (joint - parent) > 0.0]
    return beyond if len(beyond) else points


def _into_flesh(points: Floats, joint: Floats) -> Floats:
    """End (3,) of a segment from a joint toward the mean of points (n, 3), also where these are
    slender: then it ends before the last of them by half of their width.
    """
    reach = INTO_FLESH * float(np.linalg.norm(points.mean(0) - joint))
    return np.asarray(joint + max(reach, _slender(points, joint)) * _direction(points, joint))


def _direction(points: Floats, joint: Floats) -> Floats:
    """(3,) unit vector from a joint to the mean of points (n, 3), and then to that of their farther
    half: those around the joint, such as the skull behind a snout, would turn it.  0 where the
    mean is the joint.
    """
    way = points.mean(0) - joint
    along = (points - joint) @ way
    way = points[along >= np.median(along)].mean(0) - joint
    return np.asarray(way / max(float(np.linalg.norm(way)), np.finfo(float).tiny))


def _slender(points: Floats, joint: Floats) -> float:
    """[m] from a joint along the direction of points (n, 3) to the last one, less half their width:
    the median of their distances from this line.  What a gap of more than half of that distance
    separates, such as a mesh apart from the others, does not count.
    """
    way, at = _direction(points, joint), points - joint
    along = at @ way
    half = float(np.median(np.linalg.norm(at - along[:, None] * way, axis=1)))
    steps = np.sort(along)
    apart = np.flatnonzero(np.diff(steps) > max(2.0 * half, 0.5 * float(steps[-1])))
    return float(steps[apart[0] if len(apart) else -1]) - half


def _distance(point: Floats, start: Floats, ends: Sequence[Floats]) -> float:
    """[m] distance of a point from the nearest of the segments that begin at `start`."""
    return min((float(_to_segment(point[None], start, end)[0]) for end in ends), default=np.inf)


def _through(points: Floats, matrix: Floats) -> Floats:
    return np.asarray(points @ matrix[:3, :3] + matrix[3, :3])


def _world(rig: Rig, code: float, facts: StageFacts) -> NDArray[np.float64]:
    """(4, 4) local-to-world transform of the skeleton at a time code, stage units."""
    matrix = UsdGeom.Xformable(rig.prim).ComputeLocalToWorldTransform(Usd.TimeCode(code))
    rows = np.array(matrix, dtype=np.float64)
    if not np.isfinite(rows).all() or abs(np.linalg.det(rows[:3, :3])) == 0.0:
        raise InputError(
            f"{facts.path}: --flesh: the transform of <{rig.path}> cannot be inverted at time "
            f"code {code_text(code)}",
            "repair the animation of the skeleton, or of a prim above it",
        )
    return rows


def _posed(rig: Rig, code: float, facts: StageFacts) -> NDArray[np.float64]:
    """(J, 4, 4) transforms of the joints in the skeleton's space at a time code."""
    found = rig.query.ComputeJointSkelTransforms(Usd.TimeCode(code))
    rows = np.array(found if found is not None else [], dtype=np.float64).reshape(-1, 4, 4)
    bad = ~np.isfinite(rows).all((1, 2))
    if len(rows) != len(rig.joints) or bad.any():
        what = (
            f"has {len(rows)} transforms for {len(rig.joints)} joints"
            if len(rows) != len(rig.joints)
            else f"moves joint {rig.joints[int(bad.argmax())]} to a position that is not finite"
        )
        raise InputError(
            f"{facts.path}: --flesh: the animation of <{rig.path}> {what} at time code"
            f" {code_text(code)}",
            "repair the animation (SkelAnimation), or author restTransforms, one for each joint",
        )
    return rows


def _carriers(rig: Rig) -> Ints:
    """(J,) the nearest ancestor of each joint with skinned points; -1: none."""
    flesh = np.zeros(len(rig.joints), bool)
    flesh[np.unique(np.concatenate(rig.owner))] = True
    out = np.full(len(rig.joints), -1)
    for j, parent in enumerate(rig.parents):  # parents come first in a valid order
        if parent >= 0:
            out[j] = parent if flesh[parent] else out[parent]
    return out


def _relative(above: Ints, matrices: Floats) -> NDArray[np.float64]:
    """(J, 4, 4) transforms relative to the joints `above`, from those in the skeleton's space."""
    base = np.where((above >= 0)[:, None, None], matrices[np.maximum(above, 0)], np.eye(4))
    return np.asarray(matrices @ np.linalg.inv(base))


def _joined(above: Ints, relative: Floats) -> NDArray[np.float64]:
    """The inverse of `_relative`."""
    out = np.array(relative, float)
    for j, parent in enumerate(above):
        if parent >= 0:
            out[j] = out[j] @ out[parent]
    return out


def _motion(rig: Rig, facts: StageFacts, first: float, times: Floats) -> NDArray[np.float64]:
    """(F, J, 4, 4) transforms of the joints in the skeleton's space."""
    out = [_posed(rig, code, facts) for code in times if code >= first]
    before = times[times < first]
    if not len(before):
        return np.stack(out)
    above = _carriers(rig)
    step = float(times[1] - times[0]) if len(times) > 1 else 1.0
    rest, start, after = (
        _Parts.of(_relative(above, M))
        for M in (rig.bind, _posed(rig, first, facts), _posed(rig, first + step, facts))
    )
    lead = [
        _joined(above, rest.toward(start.toward(after, back), s).matrices)
        for s, back in lead_in(before, first, step)
    ]
    return np.stack([*lead, *out])


def _worlds(rig: Rig, facts: StageFacts, first: float, times: Floats) -> NDArray[np.float64]:
    """(F, 4, 4) local-to-world of the skeleton."""
    rest = _world(rig, first, facts)
    before = times[times < first]
    step = float(times[1] - times[0]) if len(times) > 1 else 1.0
    change = _world(rig, first + step, facts) - rest if len(before) else 0.0
    lead = [rest + back * s * change for s, back in lead_in(before, first, step)]
    return np.stack([*lead, *(_world(rig, code, facts) for code in times if code >= first)])


def lead_in(before: Floats, first: float, step: float) -> list[tuple[float, float]]:
    """(s, frames) of each time before the first frame.

    s is the weight of the animation, and `frames` how far it is extrapolated backward, with slope
    1 at the first frame.

    before : (B,) time codes; first : of the first frame; step : of one frame, in time codes.
    """
    out = []
    for code in before:
        r = (code - before[0]) / (first - before[0])
        frames = MEMORY * (np.exp((code - first) / (step * MEMORY)) - 1.0)
        out.append((3.0 * r**2 - 2.0 * r**3, float(frames)))
    return out


@dataclass(frozen=True)
class _Parts:
    """Transforms x -> R S x + t of joints, decomposed."""

    rotation: Floats  # (J, 3, 3)
    stretch: Floats  # (J, 3, 3)
    translation: Floats  # (J, 3)

    @classmethod
    def of(cls, matrices: Floats) -> _Parts:
        """Polar decomposition of matrices (J, 4, 4) for row vectors."""
        A = np.swapaxes(matrices[:, :3, :3], 1, 2)
        R = signed_polar(A)
        return cls(R, np.swapaxes(R, 1, 2) @ A, matrices[:, 3, :3])

    def toward(self, other: _Parts, s: float) -> _Parts:
        """Interpolation to other transforms by a fraction s; extrapolation for s < 0."""
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(np.swapaxes(self.rotation, 1, 2) @ other.rotation).as_rotvec()
        return _Parts(
            self.rotation @ Rotation.from_rotvec(s * turn).as_matrix(),
            (1.0 - s) * self.stretch + s * other.stretch,
            (1.0 - s) * self.translation + s * other.translation,
        )

    @property
    def matrices(self) -> NDArray[np.float64]:
        """(J, 4, 4) for row vectors."""
        out = np.broadcast_to(np.eye(4), (len(self.rotation), 4, 4)).copy()
        out[:, :3, :3] = np.swapaxes(self.rotation @ self.stretch, 1, 2)
        out[:, 3, :3] = self.translation
        return out

"""Pairs that pass through each other: filtered pairs and collision groups of UsdPhysics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

from pxr import Sdf, Usd, UsdPhysics

from gf_usd.assets.usd_physics_roles import apis

FILTER = "PhysicsFilteredPairsAPI"
Paths = Sequence[Sdf.Path]


def ignored_pairs(
    stage: Usd.Stage,
    prims: Iterable[Usd.Prim],
    bodies: Mapping[str, Paths],
    colliders: Sequence[str],
) -> tuple[tuple[str, str], ...]:
    """(body, body or collider) that do not collide, each pair once.

    bodies : path of each body and the paths that stand for it: its own and its colliders'.
    """
    pairs = [(prim.GetPath(), target) for prim in prims for target in _filtered(prim)]
    groups = _Groups(stage)
    if not pairs and not groups.disable:
        return ()
    stand_ins = {**bodies, **{path: (Sdf.Path(path),) for path in colliders}}
    asked = [*combinations(bodies, 2), *((body, one) for body in bodies for one in colliders)]
    return tuple(
        (one, other)
        for one, other in asked
        if _paired(pairs, stand_ins[one], stand_ins[other])
        or groups.apart(stand_ins[one], stand_ins[other])
    )


def _filtered(prim: Usd.Prim) -> list[Sdf.Path]:
    if FILTER not in apis(prim):
        return []
    relation = prim.GetRelationship("physics:filteredPairs")
    return list(relation.GetForwardedTargets()) if relation else []


def _paired(pairs: Sequence[tuple[Sdf.Path, Sdf.Path]], one: Paths, other: Paths) -> bool:
    """Whether a filter names both, itself or by a prim above, in either order."""
    return any(
        (_under(one, a) and _under(other, b)) or (_under(one, b) and _under(other, a))
        for a, b in pairs
    )


def _under(paths: Paths, root: Sdf.Path) -> bool:
    return any(path.HasPrefix(root) for path in paths)


class _Groups:
    """The collision groups of a stage, and which of them do not collide."""

    def __init__(self, stage: Usd.Stage) -> None:
        table = UsdPhysics.CollisionGroup.ComputeCollisionGroupTable(stage)
        self._members = {}
        for path in table.GetGroups():
            group = UsdPhysics.CollisionGroup(stage.GetPrimAtPath(path))
            self._members[path] = group.GetCollidersCollectionAPI().ComputeMembershipQuery()
        self.disable = {
            (a, b)
            for a in self._members
            for b in self._members
            if not table.IsCollisionEnabled(a, b)
        }

    def apart(self, one: Paths, other: Paths) -> bool:
        """Whether two sets of stand-ins are in groups that do not collide."""
        mine, theirs = self._of(one), self._of(other)
        return any((a, b) in self.disable for a in mine for b in theirs)

    def _of(self, paths: Paths) -> list[Sdf.Path]:
        return [
            group
            for group, query in self._members.items()
            if any(query.IsPathIncluded(path) for path in paths)
        ]

"""A skeleton of UsdSkel, and the points skinned to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from pxr import Usd, UsdSkel

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError


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
    area: list[Floats] = field(default_factory=list)  # (V,) [m^2] of the surface around each
    part: list[Ints] = field(default_factory=list)  # (V,) connected part of the mesh
    owner: list[Ints] = field(default_factory=list)  # (V,) joint of the largest weight
    weights: dict[str, Floats] = field(default_factory=dict)  # (V, J) of each mesh, by path


def read_rig(skeleton: Usd.Prim, query: UsdSkel.SkeletonQuery, facts: StageFacts) -> Rig:
    """A skeleton without points.  Raises InputError for an invalid one."""
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

"""UsdPhysics of a stage: gravity, fields, colliders, baked bodies, and collision filtering."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdPhysics

from gf_usd.core.asset import StageFacts, first_time_code
from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.stage import StagePhysics, Triple
from gf_usd.core.units import STRONGEST
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.stage import open_stage, reading
from gf_usd.readers.usd_physics.attachments import attachments_of
from gf_usd.readers.usd_physics.attributes import (
    apis,
    authored,
    body_of,
    invalid_value,
    switch,
    vector,
)
from gf_usd.readers.usd_physics.bodies import PhysicsMaterials, read_body
from gf_usd.readers.usd_physics.colliders import obstacles, read_colliders, without_instancers
from gf_usd.readers.usd_physics.motion import Readings


def read_physics(
    file: Path,
    facts: StageFacts,
    bodies: Sequence[str],
    *,
    rest: float | None,
    times: Sequence[float],
    elastic: bool = True,
) -> StagePhysics:
    """The physics of a USD file.

    facts : of the stage; facts.path is the file's name in messages.
    bodies : prim paths of the baked surfaces; all other enabled colliders are obstacles.
    rest : time code of the rest pose; None: the stage's startTimeCode, or 1.
    times : time codes of the frames.
    elastic : False: the materials of the bodies are not read.

    Raises InputError for invalid values, with the prim's path.
    """
    with reading(file):
        stage = open_stage(file)
        start = first_time_code(facts, rest)
        time = Usd.TimeCode(start)
        step = abs(times[1] - times[0]) if len(times) > 1 else 1.0
        notes = Notes()
        prims = without_instancers(stage, notes)
        gravity, scene = read_gravity(prims, facts, time, notes)
        codes = gravity_samples(stage, scene)
        keys = [
            (code, read_gravity(prims, facts, Usd.TimeCode(code), Notes())[0]) for code in codes
        ]
        materials, readings = PhysicsMaterials(facts, time, notes), Readings(facts)
        baked = [named_prim(stage, facts.path, path) for path in bodies]
        others, own = obstacles(prims, baked, time, notes)
        colliders = read_colliders(others, facts, materials, time, times, notes)
        hard, soft = attachments_of(prims, bodies, time, notes, file=facts.path)
        note_joints(prims, baked, time, notes)
        return StagePhysics(
            gravity=gravity,
            scene=scene,
            fields=read_fields(stage, scene, facts, time),
            attachments=hard,
            soft_attachments=soft,
            gravity_keys=tuple((code, g) for code, g in keys if g is not None),
            colliders=colliders,
            bodies=tuple(
                read_body(
                    prim,
                    readings,
                    materials if elastic else None,
                    time,
                    rest=start,
                    step=step,
                    notes=notes,
                )
                for prim in baked
            ),
            ignored=ignored_pairs(
                stage,
                prims,
                {str(prim.GetPath()): _stand_ins(prim, own, time) for prim in baked},
                [collider.path for collider in colliders],
            ),
            notes=notes.lines(),
        )


def _stand_ins(body: Usd.Prim, own: Sequence[Usd.Prim], time: Usd.TimeCode) -> tuple[Sdf.Path, ...]:
    """The paths that refer to a baked surface in collision filters: its own and its colliders'."""
    owner, path = body_of(body, time), body.GetPath()
    mine = [
        prim.GetPath()
        for prim in own
        if prim.GetPath().HasPrefix(path) or (owner and body_of(prim, time) == owner)
    ]
    return (path, *(one for one in mine if one != path))


def note_joints(
    prims: Iterable[Usd.Prim], baked: Sequence[Usd.Prim], time: Usd.TimeCode, notes: Notes
) -> None:
    """Note that enabled joints of baked surfaces, or of their bodies, are not simulated."""
    owners = [(one, body_of(one, time)) for one in baked]
    for prim in prims:
        if not prim.IsA(UsdPhysics.Joint):
            continue
        if not switch(prim, "physics:jointEnabled", time, otherwise=True):
            continue
        joint = UsdPhysics.Joint(prim)
        ends = [*joint.GetBody0Rel().GetForwardedTargets()]
        ends += joint.GetBody1Rel().GetForwardedTargets()
        bodies = [body_of(prim.GetStage().GetPrimAtPath(end), time) for end in ends]
        if any(
            (body is not None and body == owner) or end.HasPrefix(one.GetPath())
            for one, owner in owners
            for end, body in zip(ends, bodies)
        ):
            notes.add(
                "is a joint, and joints are not simulated: what it connects moves freely, unless"
                " --combine, or one RigidBodyAPI above its meshes, makes it one body; --pin holds"
                " regions in place",
                str(prim.GetPath()),
            )


FILTER = "PhysicsFilteredPairsAPI"
Paths = Sequence[Sdf.Path]


def ignored_pairs(
    stage: Usd.Stage,
    prims: Iterable[Usd.Prim],
    bodies: Mapping[str, Paths],
    colliders: Sequence[str],
) -> tuple[tuple[str, str], ...]:
    """Pairs (body, body or collider) that do not collide, without repetition.

    bodies : by the path of each body, the paths that refer to it (`_stand_ins`).
    """
    pairs = [(prim.GetPath(), target) for prim in prims for target in _filtered(prim)]
    groups = _Groups(stage)
    if not pairs and not groups.disable:
        return ()
    stand_ins = {**bodies, **{path: (Sdf.Path(path),) for path in colliders}}
    candidates = [*combinations(bodies, 2), *((body, one) for body in bodies for one in colliders)]
    return tuple(
        (one, other)
        for one, other in candidates
        if _paired(pairs, stand_ins[one], stand_ins[other])
        or groups.apart(stand_ins[one], stand_ins[other])
    )


def _filtered(prim: Usd.Prim) -> list[Sdf.Path]:
    if FILTER not in apis(prim):
        return []
    relation = prim.GetRelationship("physics:filteredPairs")
    return list(relation.GetForwardedTargets()) if relation else []


def _paired(pairs: Sequence[tuple[Sdf.Path, Sdf.Path]], one: Paths, other: Paths) -> bool:
    """Whether a filtered pair contains both, or ancestors of them, in either order."""
    return any(
        (_under(one, a) and _under(other, b)) or (_under(one, b) and _under(other, a))
        for a, b in pairs
    )


def _under(paths: Paths, root: Sdf.Path) -> bool:
    return any(path.HasPrefix(root) for path in paths)


class _Groups:
    """The collision groups of a stage, and the pairs of them that do not collide."""

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
        """Whether the paths of two bodies are in groups that do not collide."""
        mine, theirs = self._of(one), self._of(other)
        return any((a, b) in self.disable for a in mine for b in theirs)

    def _of(self, paths: Paths) -> list[Sdf.Path]:
        return [
            group
            for group, query in self._members.items()
            if any(query.IsPathIncluded(path) for path in paths)
        ]


FIELDS = "gaussianFlesh:fields"
DIRECTION, MAGNITUDE = "physics:gravityDirection", "physics:gravityMagnitude"


def read_fields(
    stage: Usd.Stage, scene: str, facts: StageFacts, time: Usd.TimeCode
) -> tuple[str, ...]:
    """The force fields of a scene, as strings.  Raises InputError for other types."""
    if not scene:
        return ()
    prim = stage.GetPrimAtPath(scene)
    value = authored(prim, FIELDS, time)
    texts = () if value is None else value
    if isinstance(texts, str) or not all(isinstance(text, str) for text in texts):
        raise invalid_value(
            facts.path, prim, FIELDS, value, 'author it as string[], such as ["wind:3,0,0"]'
        )
    return tuple(map(str, texts))


def gravity_samples(stage: Usd.Stage, scene: str) -> list[float]:
    """Time codes of the samples of a scene's gravity; empty where it is constant."""
    codes: set[float] = set()
    for name in (DIRECTION, MAGNITUDE) if scene else ():
        attribute = stage.GetPrimAtPath(scene).GetAttribute(name)
        codes.update(attribute.GetTimeSamples() if attribute else ())
    return sorted(codes) if len(codes) > 1 else []


def read_gravity(
    prims: Iterable[Usd.Prim], facts: StageFacts, time: Usd.TimeCode, notes: Notes
) -> tuple[Triple | None, str]:
    """World gravity [m/s^2], and the path of its PhysicsScene; (None, "") where there is none.

    As in UsdPhysics, the direction defaults to down, and the magnitude, if missing or negative, to
    earth gravity.  Of several scenes the first is used.

    Raises InputError for a direction or a magnitude that is not a number, or is too large.
    """
    scenes = [prim for prim in prims if prim.IsA(UsdPhysics.Scene)]
    if not scenes:
        return None, ""
    scene = scenes[0]
    for other in scenes[1:]:
        notes.add(
            f"is a second PhysicsScene: only <{scene.GetPath()}> is used", str(other.GetPath())
        )
    direction = vector(facts.path, scene, DIRECTION, time)
    length = 0.0 if direction is None else float(np.linalg.norm(direction))
    down = -facts.up if direction is None or length == 0.0 else direction / length
    value = authored(scene, MAGNITUDE, time)
    magnitude = -np.inf if value is None else value
    if not isinstance(magnitude, float | int) or not magnitude < np.inf:
        raise invalid_value(
            facts.path, scene, MAGNITUDE, value,
            "author a finite magnitude in stage units per second squared, or leave it out for "
            "Earth's gravity",
        )  # fmt: skip
    if magnitude * facts.units.length > STRONGEST:
        raise invalid_value(
            facts.path, scene, MAGNITUDE, value,
            f"author up to {STRONGEST / facts.units.length:g} (1 unit is {facts.units.length:g} m),"
            " or leave it out for Earth's gravity",
        )  # fmt: skip
    g = (G0 if magnitude < 0.0 else magnitude * facts.units.length) * down + 0.0
    return (float(g[0]), float(g[1]), float(g[2])), str(scene.GetPath())

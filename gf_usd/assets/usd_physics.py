"""What a stage says of physics: gravity, obstacles, and the bodies that are baked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pxr import Sdf, Usd

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_physics_body import read_body
from gf_usd.assets.usd_physics_collider import obstacles, read_colliders, without_instancers
from gf_usd.assets.usd_physics_filters import ignored_pairs
from gf_usd.assets.usd_physics_material import PhysicsMaterials
from gf_usd.assets.usd_physics_motion import Readings
from gf_usd.assets.usd_physics_roles import body_of
from gf_usd.assets.usd_physics_scene import read_gravity
from gf_usd.assets.usd_select import named_prim
from gf_usd.assets.usd_stage import open_stage, reading
from gf_usd.model import StageFacts
from gf_usd.playback import first_time_code
from gf_usd.stage_physics import StagePhysics


def read_physics(
    file: Path,
    facts: StageFacts,
    bodies: Sequence[str],
    *,
    rest: float | None,
    times: Sequence[float],
    elastic: bool = True,
) -> StagePhysics:
    """What the USD file says of physics; facts.path is what messages call it.

    bodies : prim paths of the surfaces that are baked; every other enabled collider is an obstacle.
    rest : time code of the rest pose; None: the stage's start, or 1.
    times : time codes of the frames.
    elastic : False: the materials of the bodies are not read, whatever they hold.

    Raises InputError for values that make no sense, with the prim's path.
    """
    with reading(file):
        stage = open_stage(file)
        start = first_time_code(facts, rest)
        time = Usd.TimeCode(start)
        step = abs(times[1] - times[0]) if len(times) > 1 else 1.0
        notes = Notes()
        prims = without_instancers(stage, notes)
        gravity, scene = read_gravity(prims, facts, time, notes)
        materials, readings = PhysicsMaterials(facts, time, notes), Readings(facts)
        baked = [named_prim(stage, facts.path, path) for path in bodies]
        others, own = obstacles(prims, baked, time, notes)
        colliders = read_colliders(others, facts, materials, time, times, notes)
        return StagePhysics(
            gravity=gravity,
            scene=scene,
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
    """The paths by which others may name a baked surface: its own and its colliders'."""
    owner, path = body_of(body, time), body.GetPath()
    mine = [
        prim.GetPath()
        for prim in own
        if prim.GetPath().HasPrefix(path) or (owner and body_of(prim, time) == owner)
    ]
    return (path, *(one for one in mine if one != path))

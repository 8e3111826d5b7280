"""Gravity of a stage, from its PhysicsScene."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from pxr import Usd, UsdPhysics

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_physics_values import authored, refuse, vector
from gf_usd.materials import G0
from gf_usd.model import StageFacts
from gf_usd.stage_physics import Triple

DIRECTION, MAGNITUDE = "physics:gravityDirection", "physics:gravityMagnitude"


def read_gravity(
    prims: Iterable[Usd.Prim], facts: StageFacts, time: Usd.TimeCode, notes: Notes
) -> tuple[Triple | None, str]:
    """Gravity [m/s^2] in the world, and the path of the scene that gives it; (None, "") where the
    prims have no scene.

    As UsdPhysics has it: without a direction it points down, and without a magnitude, or with a
    negative one, it is the earth's.  Of several scenes the first counts.

    Raises InputError for a direction or a magnitude that is not a number.
    """
    scenes = [prim for prim in prims if prim.IsA(UsdPhysics.Scene)]
    if not scenes:
        return None, ""
    scene = scenes[0]
    for other in scenes[1:]:
        notes.add(f"is another PhysicsScene: {scene.GetPath()} counts", str(other.GetPath()))
    direction = vector(facts.path, scene, DIRECTION, time)
    length = 0.0 if direction is None else float(np.linalg.norm(direction))
    down = -facts.up if direction is None or length == 0.0 else direction / length
    value = authored(scene, MAGNITUDE, time)
    magnitude = -np.inf if value is None else value
    if not isinstance(magnitude, float | int) or not magnitude < np.inf:
        raise refuse(
            facts.path, scene, MAGNITUDE, value,
            "author a finite magnitude in stage units per second squared, or none for the earth's",
        )  # fmt: skip
    g = (G0 if magnitude < 0.0 else magnitude * facts.units.length) * down + 0.0
    return (float(g[0]), float(g[1]), float(g[2])), str(scene.GetPath())

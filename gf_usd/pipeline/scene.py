"""A scene that is given as arrays, prepared for stepping: no file is read or written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.asset import Asset, StageFacts, Surface
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import (
    BodyPhysics,
    Collider,
    Pin,
    PrimBake,
    Region,
    StagePhysics,
    StageSpec,
    Triple,
)
from gf_usd.core.units import StageUnits, length_text
from gf_usd.pipeline.prepared import solver_of
from gf_usd.prepare.fill.fill import fill
from gf_usd.prepare.materials.table import Authored
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.outputs.outputs import outputs
from gf_usd.prepare.plan import Plan
from gf_usd.system.taichi_runtime import init_taichi, kernel_cache_notes

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

NAME = Path("scene")  # used in messages in place of a file name
BELOW = 1e-6  # of the scene's size: bodies that are less deep in the floor rest on it


@dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """Bodies, obstacles and pins, in SI and in the world frame."""

    surfaces: tuple[Surface, ...]  # one a body, by its path
    materials: Mapping[str, str | Material]  # of each body
    velocities: Mapping[str, tuple[Triple, Triple]]  # [m/s] and [rad/s] initial velocities
    colliders: tuple[Collider, ...] = ()
    pins: tuple[tuple[Region, tuple[bool, bool, bool]], ...] = ()  # and the prescribed axes
    gravity: Triple = (0.0, -9.81, 0.0)  # [m/s^2]
    floor: float | None = None  # [m] height along up; None: no floor
    up_axis: str = "Y"
    options: Mapping[str, Any] = field(default_factory=dict)  # fields of `Request`


def plan_scene(spec: SceneSpec) -> Plan:
    """The plan of a scene. Raises UsageError and InputError for an invalid one."""
    if not spec.surfaces:
        raise UsageError("the scene has no body", "add one: scene.add_body(points, faces)")
    gravity = ",".join(repr(float(g)) for g in spec.gravity)
    request = Request.of({**spec.options, "gravity": gravity, "floor": "none"})
    request.check()
    init_taichi(request.device, request.threads)
    facts = StageFacts(
        path=NAME, units=StageUnits(), up_axis=spec.up_axis, time_codes_per_second=None,
        start_time_code=None, end_time_code=None, root_prims=(), default_prim=None,
    )  # fmt: skip
    asset = Asset(facts=facts, surfaces=spec.surfaces)
    bodies = tuple(_physics(spec, surface.path) for surface in spec.surfaces)
    stage_spec = StageSpec(
        bakes={
            path: PrimBake(path=path, material=name)
            for path, name in spec.materials.items()
            if isinstance(name, str)
        },
        physics=StagePhysics(colliders=spec.colliders, bodies=bodies),
    )
    files = outputs(NAME.with_suffix(".usda"), ["simulated"], None)
    plan, _ = fill(
        asset, request, [Authored("simulated")], None, files, None, spec=stage_spec, repair=False,
        more_pins=partial(_pins, spec),
    )  # fmt: skip
    lowest = min(float((s.face_points @ facts.up).min()) for s in spec.surfaces)
    extent = float(np.ptp(np.concatenate([s.face_points for s in spec.surfaces]), axis=0).max())
    if spec.floor is not None and lowest < spec.floor - BELOW * extent:
        raise UsageError(
            f"a body starts {length_text(spec.floor - lowest)} below the floor, which is at"
            f" {length_text(spec.floor)}",
            "move the body up, or lower the floor",
        )
    settings = tuple(replace(one, floor=spec.floor) for one in plan.each)
    notes = (*plan.notes, *kernel_cache_notes())
    return replace(plan, notes=notes, settings=settings[0], each=settings)


def start_scene(plan: Plan) -> TotalLagrangian:
    """The solver of a planned scene, in its initial state."""
    return solver_of(plan, plan.variants[0])  # pyright: ignore[reportReturnType]


def _physics(spec: SceneSpec, path: str) -> BodyPhysics:
    velocity, spin = spec.velocities[path]
    material = spec.materials[path]
    return BodyPhysics(
        path=path, owner=path, velocity=velocity, angular_velocity=spin,
        material=material if isinstance(material, Material) else None,
    )  # fmt: skip


def _pins(spec: SceneSpec, solid: Solid) -> Sequence[Pin]:
    from gf_usd.geometry.regions import make_pin

    low = np.min([s.face_points.min(0) for s in solid.surfaces], axis=0)
    high = np.max([s.face_points.max(0) for s in solid.surfaces], axis=0)
    made = []
    for region, axes in spec.pins:
        if (region.points.max(0) < low).any() or (region.points.min(0) > high).any():
            raise InputError(
                f"the pin {region.name} touches no body: the bodies are between"
                f" {np.round(low, 4).tolist()} and {np.round(high, 4).tolist()} m",
                "give a box that overlaps one",
            )
        made.append(replace(make_pin(region, solid), axes=axes))
    return made

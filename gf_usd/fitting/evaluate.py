"""Simulations of one asset with varying material values; it is read and sampled once.

`serve` is the main function of the processes of `workers`: requests and replies are lines of JSON
over a socket, and large data is exchanged in files.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import socket
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import GfUsdError, InputError, SolverError
from gf_usd.core.materials.material import Material
from gf_usd.fitting.observation import Observation, Scene, TrackedPoints, rest_points, save
from gf_usd.fitting.unknowns import with_values
from gf_usd.pipeline.checkpoint import identity
from gf_usd.pipeline.measures.figures import Recorder
from gf_usd.pipeline.prepared import prepare, solver_of
from gf_usd.system import exchange
from gf_usd.system.processes import end_with_parent
from gf_usd.system.warm.workers import receive, send

NO_POINTS = np.zeros((0, 3))


class Simulator:
    """Simulates an asset with given values of its material.

    asset, options : of ``gf-usd bake``.

    Raises the errors of preparing a bake, and InputError where materials vary within the asset.
    """

    def __init__(self, asset: Path, options: Mapping[str, Any]) -> None:
        plan = prepare(asset, **options).plan
        if plan.particles.own is not None:
            raise InputError(
                f"{asset}: particles have individual material values, which are painted or blended",
                "fit an asset without painted values: gf-usd fit determines one material for "
                "all bodies",
            )
        table = plan.variants[0].table
        if len(table) > 1 and options.get("material") is None:
            raise InputError(
                f"{asset} has {len(table)} materials: {', '.join(m.name for m in table)}",
                "give the one that all bodies start with: --material NAME",
            )
        material = plan.materials[0]
        self._plan = replace(
            plan,
            particles=replace(plan.particles, material=np.zeros(len(plan.particles), np.int64)),
            tables=((material,),),
        )
        self._notes = plan.notes
        if len(table) > 1:
            note = f"all bodies must have one material, but {material.name} gives {len(table)}"
            self._notes = (*plan.notes, note)

    def scene(self) -> Scene:
        """The data that all simulations have in common."""
        plan = self._plan
        settings, lift = plan.settings, np.array(plan.settings.lift)
        surfaces = [s for s in plan.asset.surfaces if s.path in plan.points]
        variant = plan.variants[0]
        identity_values = identity(
            settings, variant.table, plan.choices, plan.particles,
            plan.contact_setup.colliders if plan.contact_setup else (),
            asset=plan.asset.facts.path, command=plan.command,
        )  # fmt: skip
        return Scene(
            material=plan.materials[0],
            radius=float(plan.bodies.radius.max()) if plan.bodies else plan.particles.radius,
            particles=len(plan.particles),
            fps=settings.fps,
            frames=settings.frames,
            start=settings.start,
            time_codes_per_second=settings.time_codes_per_second,
            unit=plan.asset.facts.units.length,
            up=np.array(settings.up),
            floor=settings.floor if settings.floor_normal is None else None,
            surfaces={s.path: rest_points(s) + lift for s in surfaces},
            triangles={s.path: np.asarray(s.triangles) for s in surfaces},
            lift=lift,
            notes=self._notes,
            identity=hashlib.sha256(
                json.dumps(identity_values, sort_keys=True).encode()
            ).hexdigest(),
        )

    def run(self, values: Mapping[str, float], tracked: Sequence[TrackedPoints]) -> Observation:
        """Simulate with material values [SI].  Raises SolverError where the solver fails."""
        plan = self._plan
        material: Material = with_values(plan.materials[0], values)
        plan = replace(plan, materials=(material,), tables=((material,),))
        solver = solver_of(plan, plan.variants[0])
        settings = plan.settings
        recorder = Recorder(settings.normal, settings.floor, np.array(settings.gravity))
        paths = [s.path for s in plan.asset.surfaces if s.path in plan.points]
        seconds: list[float] = []
        x: list[Floats] = []
        v: list[Floats] = []
        for frame in solver.frames():
            health, poses = frame.health, frame.embedded
            recorder.add(
                frame.time,
                np.concatenate([poses[path].x for path in paths]),
                np.concatenate([poses[path].v for path in paths]),
                center=health.center,
                velocity=tuple(p / health.mass for p in health.momentum),
                strain=max(health.max_stretch - 1.0, 1.0 - health.min_stretch),
                kinetic=health.kinetic,
                touching=health.penetration > 0.0 or health.overlap > 0.0,
                inverted=health.inverted,
            )
            seconds.append(frame.index / settings.fps)
            x.append(np.concatenate([NO_POINTS, *(f.of(poses[f.path].x) for f in tracked)]))
            v.append(np.concatenate([NO_POINTS, *(f.of(poses[f.path].v) for f in tracked)]))
        return Observation(
            seconds=np.array(seconds),
            x=np.array(x),
            v=np.array(v) * settings.time_scale,
            series=recorder.series(),
        )


def serve(descriptor: str) -> NoReturn:
    """Answer requests until the socket is closed, then exit the process."""
    end_with_parent()
    os.dup2(2, 1)  # stdout to stderr: libraries may print
    gc.set_threshold(100_000, 20, 20)  # as in the command line
    simulator: Simulator | None = None
    tracked: Sequence[TrackedPoints] = ()
    with socket.socket(fileno=int(descriptor)) as end:
        while (received := receive(end)) is not None:
            request = received[0]
            answer: dict[str, Any] = {"error": None}
            try:
                if request["task"] == "prepare":
                    message = exchange.read(Path(request["file"]).read_bytes())
                    simulator = Simulator(message["asset"], message["options"])
                    tracked = message["followed"]
                    with Path(request["reply"]).open("wb") as file:
                        exchange.write(simulator.scene(), file)
                else:
                    assert simulator is not None
                    save(Path(request["reply"]), simulator.run(request["values"], tracked))
            except GfUsdError as error:
                details = {k: v for k, v in vars(error).items() if k not in ("message", "hint")}
                answer["error"] = [type(error).__name__, error.message, error.hint, details]
                answer["failed"] = isinstance(error, SolverError)
            gc.collect()  # the solver's arrays
            send(end, answer)
    sys.stderr.flush()
    os._exit(0)

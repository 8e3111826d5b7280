"""A bake made ready, and a bake done: what `bake` hands in and out."""

from __future__ import annotations

import hashlib
import math
import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.core import __version__
from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError
from gf_usd.core.frames import (
    Choices,
    Health,
    Particles,
    Settings,
    SurfaceSamples,
    sampled,
    summary,
    written,
)
from gf_usd.core.materials import Material
from gf_usd.core.stage import Advice, Encounters, Pin
from gf_usd.prepare.bodies import BodyPlan
from gf_usd.prepare.options.table import words
from gf_usd.prepare.outputs import Outputs, SplatSequence
from gf_usd.system.taichi_runtime import epoch

if TYPE_CHECKING:
    from gf_usd.physics.frame_loop import Marcher
    from gf_usd.prepare.outputs import Stamp, Stamps
    from gf_usd.readers.mesh.to_usd import MeshSource


KEPT = 200_000  # particles of solvers that wait for their bake, at 4 kB each


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Everything known, nothing simulated or written yet."""

    asset: Asset
    particles: Particles
    samples: SurfaceSamples
    materials: tuple[Material, ...]  # the main one of each look: one bake and one variant each
    settings: Settings  # of the first material
    outputs: Outputs
    riders: tuple[tuple[str, str], ...]  # (prim path, reason) of meshes that only ride along
    drop: float  # [m] free fall before the floor
    notes: tuple[str, ...]
    pins: tuple[Pin, ...] = ()
    tables: tuple[tuple[Material, ...], ...] = ()  # of each look, what particles' materials index
    bodies: BodyPlan | None = None
    encounters: Encounters | None = None
    velocity: tuple[Any, ...] = ()  # at the start, of each body: see `TotalLagrangian`
    each: tuple[Settings, ...] = ()  # of each material, where they are not all the same
    converted: MeshSource | None = None  # of an asset that is not USD
    sequences: tuple[tuple[SplatSequence, ...], ...] = ()  # splat files of each material
    standing: tuple[Checkpoint | None, ...] = ()  # of each look, where it goes on; none: anew
    seen: Stamps = ()  # of the results and checkpoints that were there
    seen_source: Stamp = None  # of the layer of a mesh file
    command: str = ""  # that bakes the same again
    choices: Choices = field(default_factory=Choices)  # of the output
    advice: tuple[Advice, ...] = ()  # of --material auto, one a surface
    _ready: dict[str, Any] = field(init=False, repr=False, compare=False, default_factory=dict)

    @property
    def source(self) -> Path:
        """The USD file to lie over: the asset, or the layer that is made of it."""
        if self.outputs.source is None and self.converted is not None:
            return self.converted.layer  # of a flat bake, in a temporary folder
        return self.outputs.source or self.asset.facts.path

    @property
    def version(self) -> str:
        return __version__

    def settings_of(self, material: Material) -> Settings:
        """The settings of one material's bake."""
        named = zip(self.materials, self.each)
        return next((s for m, s in named if m.name == material.name), self.settings)

    def substeps(self, material: Material) -> int:
        """Substeps a frame, all samples together.

        The solver that knows is kept for `solver`: it is dear to build.
        """
        if material.name not in self._ready:
            solver = self.solver(material)
            kept = len(self.particles) * (1 + len(self._ready)) <= KEPT
            self._ready[material.name] = solver.substeps, solver if kept else None, epoch()
        return self._ready[material.name][0] * self.settings.samples_per_frame

    def solver(self, material: Material) -> Marcher:
        """The solver of one material, at its start."""
        from gf_usd.physics.solvers import make_solver

        substeps, solver, made = self._ready.get(material.name, (0, None, 0))
        if solver is not None:
            self._ready[material.name] = substeps, None, made  # it will have moved
            if made == epoch():
                return solver
        more: dict[str, Any] = {}
        if self.velocity:
            more["velocity"] = list(self.velocity) if self.velocity[1:] else self.velocity[0]
        if self.settings.solver == "tl" and self.bodies is not None:
            more |= {"encounters": self.encounters, "rider_body": self.bodies.riders}
        return make_solver(
            sampled(self.settings_of(material)),
            self.particles,
            self.table(material),
            samples=self.samples,
            riders=self.points if self.settings.skin == "embed" else {},
            pins=self.pins,
            **more,
        )

    def table(self, material: Material) -> tuple[Material, ...]:
        """The materials that particles have in the look whose main one this is."""
        named = zip(self.materials, self.tables)
        return next((t for m, t in named if m.name == material.name), (material,))

    @property
    def points(self) -> dict[str, Floats]:
        """Points (n, 3) [m] at rest that ride, by prim path: vertices, or captured Gaussians."""
        exported = any(self.sequences)
        return {
            s.path: s.points if s.splats is None else s.splats.riding
            for s in self.asset.surfaces
            if self.choices.mesh or (exported and s.splats is not None)
        }


def command_line(source: Path, **asked: Any) -> str:
    """The ``gf-usd bake`` that asks for this; what was left to its default is left out."""
    return shlex.join(["gf-usd", "bake", source.name, *words(asked)])


def input_hash(plan: Plan) -> str:
    """sha256 of the source file; raises BakeError where it is gone since it was read."""
    path = plan.asset.facts.path
    try:
        seen = path.stat()
        return _sha256(path.absolute(), seen.st_mtime_ns, seen.st_size)
    except OSError as error:
        raise BakeError(
            f"{path} cannot be read any more: {error.strerror}",
            "leave the asset where it is while it is baked; put it back and bake again",
        ) from error


@cache
def _sha256(path: Path, changed: int, size: int) -> str:
    """Read once, however often it is asked for, until the file's time or size is another."""
    del changed, size
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe(plan: Plan) -> dict[str, Any]:
    """What ``--dry-run`` shows, estimates aside, and every report repeats."""
    return {
        "command": plan.command,
        "version": plan.version,
        "input_sha256": input_hash(plan),
        "source": str(plan.asset.facts.path),
        "bodies": [s.path for s in plan.asset.surfaces],
        "separate_bodies": [list(paths) for paths in plan.bodies.surfaces] if plan.bodies else [],
        "obstacles": [c.path for c in plan.encounters.colliders] if plan.encounters else [],
        "riders": [list(r) for r in plan.riders],
        "particles": len(plan.particles),
        "spacing_m": plan.particles.spacing,
        "volume_m3": plan.particles.volume,
        "radius_m": plan.particles.radius,
        "materials": [asdict(m) for m in plan.materials],
        "tables": [[asdict(m) for m in plan.table(look)] for look in plan.materials],
        "advice": [asdict(one) for one in plan.advice],
        "own_values": summary(plan.particles, plan.table(plan.materials[0])),
        "frames": written(plan.settings),
        "fps": plan.settings.fps,
        "start": plan.settings.time_code(plan.settings.first),
        "drop_m": plan.drop,
        "pins": [p.name for p in plan.pins],
        "outputs": [str(p) for p in plan.outputs.all],
        "notes": list(plan.notes),
    }


def settings_json(settings: Settings) -> dict[str, Any]:
    """Plain values; an infinite one as the word "inf", since JSON has no number for it."""
    return {
        name: str(value) if value == math.inf else value for name, value in asdict(settings).items()
    }


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """One look at the end of a full clip."""

    identity: Mapping[str, str]  # what has to be the same, by its name: see `resuming.identity`
    index: int  # of the sample
    last: Health  # of the sample
    log: Mapping[str, Any]  # `HealthLog.state`
    cache: Mapping[str, Any]  # `CacheWriter.state`
    solver: Mapping[str, Any]
    track: Mapping[str, Floats]


# [bytes] of a sample
MESH_BYTES = 24  # points and velocities of a vertex, float32
NORMAL_BYTES = 12
SPLAT_BYTES = 52  # positions, velocities, orientation, scale
HALF_BYTES = 14  # less: orientation and scale in half precision
POINT_BYTES = 24
GRADIENT_BYTES, STRESS_BYTES = 72, 4


def frame_bytes(asset: Asset, particles: int, settings: Settings, choices: Choices) -> int:
    """[bytes] on the disk of a frame with all its samples."""
    size = 0
    for s in asset.surfaces if choices.mesh else ():
        if s.splats is not None:
            size += s.splats.frame_bytes
        else:
            normals = 0 if s.normals is None else len(s.normals)
            size += MESH_BYTES * len(s.points) + NORMAL_BYTES * normals
    if "gaussians" in choices.shapes:
        each = SPLAT_BYTES - HALF_BYTES * choices.half
        each += GRADIENT_BYTES * settings.deformation_gradients + STRESS_BYTES * settings.stress
        size += each * particles
    if "points" in choices.shapes:
        size += POINT_BYTES * particles
    return size * settings.samples_per_frame

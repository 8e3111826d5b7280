"""The plan of a bake, as plain values, and its description for a dry run."""

from __future__ import annotations

import hashlib
import math
import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core import __version__
from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.particles import Particles, SurfaceSamples, TetLattice
from gf_usd.core.frames.settings import Settings, written
from gf_usd.core.materials.laws import law_internals
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import summary
from gf_usd.core.stage import Advice, BlendShapes, ContactSetup, Goals, Pin
from gf_usd.prepare.bodies.plan import BodyPlan
from gf_usd.prepare.options.table import arguments
from gf_usd.prepare.outputs.outputs import Outputs, SplatSequence, Stamp, Stamps
from gf_usd.prepare.settings import Extension

if TYPE_CHECKING:
    from gf_usd.geometry.flesh.sheets import Sheet
    from gf_usd.geometry.repair import Repairs


@dataclass(frozen=True)
class Variant:
    """One bake of a plan, which is a variant of the root layer."""

    material: Material  # the main one, which it is named after
    table: tuple[Material, ...]  # what the particles' materials index
    settings: Settings
    cache: Path
    checkpoint: Path
    sequences: tuple[SplatSequence, ...]  # splat files

    @property
    def name(self) -> str:
        return self.material.name


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Everything that determines a bake; nothing is simulated or written yet."""

    asset: Asset
    particles: Particles
    samples: SurfaceSamples
    materials: tuple[Material, ...]  # the main one of each variant
    settings: Settings  # of the first material
    outputs: Outputs
    source: Path  # the USD file to lie over: the asset, or the layer that is made of it
    embedded: tuple[
        tuple[str, str], ...
    ]  # (prim path, reason) of meshes that are not filled and move with a body
    drop: float  # [m] free fall before the floor
    notes: tuple[str, ...]
    odd: str = ""  # how implausible its size is in an assumed unit; empty if it is plausible
    repairs: tuple[Repairs, ...] = ()  # of --repair, one for each mesh that it may change
    coarse: tuple[str, ...] = ()  # prim paths of meshes that a note says are too coarse to bend
    lost: str = ""  # how little of its volume faults of its meshes let be filled; one of the notes
    heavy: str = ""  # which of its densities no solid has, if any
    stated_heavy: str = ""  # what gives it that density, as "physics:mass of </Ball>"
    pins: tuple[Pin, ...] = ()
    goals: Goals | None = None
    sheets: Mapping[str, Sheet] = field(default_factory=dict)  # of characters, by prim path
    shapes: Mapping[str, BlendShapes] = field(default_factory=dict)  # of characters, by prim path
    cycle: int = 0  # frames of a period that is repeated before it is written; 0: none is
    repeats: int = 0  # times that it is, at most where it ends by itself
    until_periodic: bool = False  # only until it is periodic
    tables: tuple[tuple[Material, ...], ...] = ()  # of each variant; (): its main material
    bodies: BodyPlan | None = None
    embedded_copies: Mapping[str, Ints] = field(
        default_factory=dict
    )  # copies of cells: see `LimbPlan`
    tets: tuple[TetLattice, ...] = ()  # of the bodies, where they are to be written
    contact_setup: ContactSetup | None = None
    velocity: tuple[Any, ...] = ()  # at the start, of each body: see `start_velocities`
    each: tuple[Settings, ...] = ()  # of each variant, where they are not all the same
    sequences: tuple[tuple[SplatSequence, ...], ...] = ()  # splat files of each variant
    seen: Stamps = ()  # of the results and checkpoints that were there
    seen_source: Stamp = None  # of the layer of a mesh file
    command: str = ""  # that bakes the same again
    collider_files: tuple[Path, ...] = ()  # of obstacles, which the result does not contain
    choices: Choices = field(default_factory=Choices)  # of the output
    extension: Extension | None = None  # of its length; None: nothing moves for longer
    advice: tuple[Advice, ...] = ()  # of --material auto, one a surface

    @property
    def held(self) -> bool:
        """Whether pins or bones prescribe the motion of a part of the body."""
        return any(not pin.rigid for pin in self.pins)

    @property
    def has_flesh(self) -> bool:
        """Whether it is flesh around bones: these are the only pins without a sharp boundary."""
        return any(not (pin.sharp or pin.rigid) for pin in self.pins)

    @property
    def version(self) -> str:
        return __version__

    @property
    def variants(self) -> tuple[Variant, ...]:
        """Its bakes, one for each material."""
        rows = zip(
            self.materials,
            self.tables or [(material,) for material in self.materials],
            self.each or [self.settings] * len(self.materials),
            self.outputs.caches,
            self.outputs.checkpoints,
            self.sequences or [()] * len(self.materials),
            strict=True,
        )
        return tuple(Variant(*row) for row in rows)

    @property
    def used_tables(self) -> list[list[Material]]:
        """The materials that particles have, for each variant."""
        present = np.unique(self.particles.material)
        return [[variant.table[k] for k in present] for variant in self.variants]

    @property
    def points(self) -> dict[str, Floats]:
        """Embedded points (n, 3) [m] at rest: vertices and captured Gaussians, by prim path, and
        corners of tetrahedra, by `TetLattice.key`."""
        exported = any(self.sequences)
        every = embedded_points(self.asset, self.sheets)
        return {
            s.path: every[s.path]
            for s in self.asset.surfaces
            if self.choices.drawn(s.path) or (exported and s.splats is not None)
        } | {tets.key: tets.X for tets in self.tets}

    @property
    def frame_bytes(self) -> float:
        """[bytes] on the disk of a frame of one variant, with all its samples; a mean."""
        size = frame_bytes(self.asset, len(self.particles), self.settings, self.choices)
        return size / self.settings.frames if self.choices.settled else size


def embedded_points(asset: Asset, sheets: Mapping[str, Sheet] | None = None) -> dict[str, Floats]:
    """Points (n, 3) [m] at rest that move with bodies, by prim path, whatever is written.

    sheets : of characters, by prim path; those of the flesh that they are next to stand for theirs.
    """
    every = {
        s.path: s.points if s.splats is None else s.splats.embedded_points for s in asset.surfaces
    }
    return every | {path: sheet.near for path, sheet in (sheets or {}).items()}


def command_line(source: Path, **options: Any) -> str:
    """The ``gf-usd bake`` command of the plan, without options at their default."""
    return shlex.join(["gf-usd", "bake", source.name, *arguments(options)])


def input_hash(path: Path) -> str:
    """sha256 of the asset's file; raises BakeError where it no longer exists."""
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
    """The hash, cached until the file's time or size changes."""
    del changed, size
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe(plan: Plan) -> dict[str, Any]:
    """The description for ``--dry-run`` and every report, without estimates."""
    return {
        "command": plan.command,
        "version": plan.version,
        "input_sha256": input_hash(plan.asset.facts.path),
        "source": str(plan.asset.facts.path),
        "bodies": [s.path for s in plan.asset.surfaces],
        "separate_bodies": [list(paths) for paths in plan.bodies.surfaces] if plan.bodies else [],
        "obstacles": [c.path for c in plan.contact_setup.colliders] if plan.contact_setup else [],
        "embedded": [list(r) for r in plan.embedded],
        "riders": [list(r) for r in plan.embedded],  # its name before; until 1.0
        "particles": len(plan.particles),
        "spacing_m": plan.particles.spacing,
        "volume_m3": plan.particles.volume,
        "radius_m": plan.particles.radius,
        "materials": [m.values for m in plan.materials],
        "tables": [[m.values for m in variant.table] for variant in plan.variants],
        "advice": [asdict(one) for one in plan.advice],
        "own_values": summary(plan.particles, plan.variants[0].table),
        "frames": written(plan.settings),
        "fps": plan.settings.fps,
        "start": plan.settings.time_code(plan.settings.first),
        "drop_m": plan.drop,
        "pins": [p.name for p in plan.pins if not p.rigid],
        "rigid": [p.name for p in plan.pins if p.rigid],
        "outputs": [str(p) for p in plan.outputs.all],
        "notes": list(plan.notes),
    }


def settings_json(settings: Settings) -> dict[str, Any]:
    """Plain values; infinity as the word "inf", since JSON has no number for it."""
    return {
        name: str(value) if value == math.inf else value for name, value in asdict(settings).items()
    }


# [bytes] of a sample
MESH_BYTES = 24  # points and velocities of a vertex, float32
NORMAL_BYTES = VELOCITY_BYTES = 12
SPLAT_BYTES = 52  # positions, velocities, orientation, scale
HALF_BYTES = 14  # less: orientation and scale in half precision
POINT_BYTES = 24
TET_BYTES = 12  # of tetrahedra, for each particle: eight are in a cell, and half a corner is theirs
FLOW_BYTES = 80  # a vertex of a surface: four vectors and two triangles
FLOW_AREA = 60  # vertices of a surface over N^(2/3): 20 of a ball, some 6 times as many of spray
GRADIENT_BYTES, STRESS_BYTES = 72, 4
INTERNAL_BYTES = 4 * len(law_internals())  # of laws of every kind: no bake writes more


def frame_bytes(asset: Asset, particles: int, settings: Settings, choices: Choices) -> int:
    """[bytes] on the disk of a frame with all its samples."""
    size = 0
    rates = VELOCITY_BYTES * (not choices.velocities)
    for s in [s for s in asset.surfaces if choices.drawn(s.path)]:
        if s.splats is not None:
            size += s.splats.frame_bytes
        else:
            normals = 0 if s.normals is None else len(s.normals)
            size += (MESH_BYTES - rates) * len(s.points) + NORMAL_BYTES * normals
    if "gaussians" in choices.shapes:
        each = SPLAT_BYTES - HALF_BYTES * choices.half - rates
        each += GRADIENT_BYTES * settings.deformation_gradients + STRESS_BYTES * settings.stress
        each += INTERNAL_BYTES * settings.internal
        size += each * particles
    if "points" in choices.shapes:
        size += (POINT_BYTES - rates) * particles
    if choices.flows:
        size += int((FLOW_BYTES - 12 * (not choices.velocities)) * FLOW_AREA * particles ** (2 / 3))
    if choices.mesh and choices.replaced and not choices.flows:
        size += (POINT_BYTES - rates) * particles  # at most: solid ones are not among them
    if choices.tets:
        size += TET_BYTES * particles
    return size * settings.samples_per_frame

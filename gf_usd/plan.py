"""A bake made ready, and a bake done: what `bake` hands in and out."""

from __future__ import annotations

import hashlib
import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gf_usd
from gf_usd.advice import Advice
from gf_usd.body_plan import BodyPlan
from gf_usd.checkpoint import Checkpoint
from gf_usd.choices import Choices
from gf_usd.encounters import Encounters
from gf_usd.errors import BakeError
from gf_usd.judgement import Caution, cautions_json
from gf_usd.model import Asset, Floats, Material, Particles, Settings, SurfaceSamples
from gf_usd.output_files import Outputs
from gf_usd.own_values import summary
from gf_usd.pins import Pin
from gf_usd.runtime import epoch
from gf_usd.splat_sequence import SplatSequence
from gf_usd.timeline import sampled, written

if TYPE_CHECKING:
    from gf_usd.assets.usd_source import MeshSource
    from gf_usd.physics.marching import Marcher
    from gf_usd.writing import Stamp, Stamps

TWO_WAY = ("wls",)  # flags whose "no" overrides a preset
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
        return gf_usd.__version__

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
    words = ["gf-usd", "bake", source.name]
    for name, value in asked.items():
        option = f"--{name.replace('_', '-')}"
        if value is True:
            words.append(option)
        elif value is False and name in TWO_WAY:
            words.append(f"--no-{option[2:]}")
        elif value is not None and value is not False:
            words += [option, str(value).removesuffix(".0")]
    return shlex.join(words)


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


def report_json(
    plan: Plan,
    bakes: Sequence[LookResult],
    *,
    notes: Sequence[str],
    seconds: float,
    findings: Sequence[dict[str, str]],
) -> dict[str, Any]:
    """The report; its keys are documented in docs/guide.md."""
    warnings = [(bake.look, caution) for bake in bakes for caution in bake.warnings]
    return {
        **describe(plan),
        "outputs": [str(p) for p in (*plan.outputs.all, *(c for b in bakes for c in b.clips))],
        "notes": list(notes),
        "seconds": seconds,
        "settings": settings_json(plan.settings),
        "bakes": [bake.as_json(frames=True) for bake in bakes],
        "warnings": cautions_json(warnings),
        "check": list(findings),
    }


@dataclass(frozen=True, kw_only=True)
class LookResult:
    """One material's bake."""

    look: str  # name of the variant
    cache: Path
    material: Material
    frames: int
    health: dict[str, Any] = field(repr=False)  # see summary.HealthLog.summary
    per_frame: list[dict[str, Any]] = field(repr=False, default_factory=list)
    warnings: tuple[Caution, ...] = ()
    clips: tuple[Path, ...] = ()  # files beside the cache

    def as_json(self, *, frames: bool = False) -> dict[str, Any]:
        """Plain values; with every frame's health on request."""
        out = {
            "look": self.look,
            "cache": str(self.cache),
            "material": asdict(self.material),
            "frames": self.frames,
            "health": self.health,
        }
        return {**out, "per_frame": self.per_frame} if frames else out


@dataclass(frozen=True, kw_only=True)
class BakeResult:
    """A finished bake."""

    root: Path
    report: Path
    bakes: tuple[LookResult, ...]
    particles: int
    seconds: float
    settings: Settings
    notes: tuple[str, ...] = ()
    findings: tuple[dict[str, str], ...] = ()  # faults that `check` found and the source has not
    outputs: tuple[Path, ...] = ()  # every file, also those that bakes of a mesh file share

    @property
    def cache(self) -> Path:
        """The cache of the first material."""
        return self.bakes[0].cache

    @property
    def health(self) -> dict[str, Any]:
        """The health summary of the first material."""
        return self.bakes[0].health

    @property
    def frames(self) -> int:
        return self.bakes[0].frames

    @property
    def warnings(self) -> tuple[tuple[str, Caution], ...]:
        """(look, warning) of every bake."""
        return tuple((bake.look, caution) for bake in self.bakes for caution in bake.warnings)

    def as_json(self) -> dict[str, Any]:
        """Plain values, as ``bake --json`` prints them."""
        return {
            "root": str(self.root),
            "report": str(self.report),
            "particles": self.particles,
            "frames": self.frames,
            "seconds": self.seconds,
            "settings": settings_json(self.settings),
            "bakes": [b.as_json() for b in self.bakes],
            "warnings": cautions_json(self.warnings),
            "outputs": [str(path) for path in self.outputs],
            "notes": list(self.notes),
            "check": list(self.findings),
        }

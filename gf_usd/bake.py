"""The street: asset -> particles -> frames -> layers.  The only file that knows all of it."""

from __future__ import annotations

import hashlib
import json
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gf_usd
from gf_usd import materials as presets
from gf_usd.errors import UsageError
from gf_usd.model import (
    Asset,
    BakedFrame,
    BakeInfo,
    Frame,
    Material,
    MeshPose,
    Particles,
    Settings,
)  # fmt: skip
from gf_usd.output_files import Outputs, claim, outputs, require_free
from gf_usd.planning import DEFAULT_PARTICLES, Request, resolve
from gf_usd.publish import publish, publish_text
from gf_usd.summary import HealthLog

Progress = Callable[[int, int], None]  # (frames done, frames in all)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A bake made ready: everything known, nothing simulated or written yet."""

    asset: Asset
    particles: Particles
    material: Material
    settings: Settings
    outputs: Outputs
    solver: Any  # physics.solver.TotalLagrangian
    riders: tuple[tuple[str, str], ...]  # (prim path, reason) of meshes that only ride along
    drop: float  # [m] free fall before the floor
    notes: tuple[str, ...]

    def describe(self) -> dict[str, Any]:
        """What ``--dry-run`` shows, estimates included."""
        from gf_usd.estimate import estimate

        return {
            "source": str(self.asset.facts.path),
            "bodies": [s.path for s in self.asset.surfaces],
            "riders": [list(r) for r in self.riders],
            "particles": len(self.particles),
            "spacing_m": self.particles.spacing,
            "volume_m3": self.particles.volume,
            "radius_m": self.particles.radius,
            "material": asdict(self.material),
            "frames": self.settings.frames,
            "fps": self.settings.fps,
            "start": self.settings.start,
            "drop_m": self.drop,
            "substeps_per_frame": self.solver.substeps,
            **estimate(self),
            "outputs": [str(p) for p in self.outputs.all],
            "notes": list(self.notes),
        }


@dataclass(frozen=True, kw_only=True)
class BakeResult:
    """A finished bake."""

    root: Path
    cache: Path
    report: Path
    frames: int
    particles: int
    seconds: float
    settings: Settings
    material: Material
    health: dict[str, Any] = field(repr=False)  # see summary.HealthLog.summary
    notes: tuple[str, ...] = ()


def prepare(
    path: str | Path,
    *,
    material: str = "rubber",
    output: str | Path | None = None,
    law: str | None = None,
    prims: Sequence[str] = (),
    overwrite: bool = False,
    **options: Any,
) -> Plan:
    """Read, check and fill an asset; see `bake` for the parameters."""
    request = _request(options)
    look = presets.find_look(material)
    if law is not None:
        presets.check_law(law)
    source = Path(path)
    files = outputs(source, look.name, None if output is None else str(output))
    require_free(files, overwrite)

    from gf_usd.usd import schema  # noqa: F401, I001  (registers itself before any stage opens)
    from gf_usd.assets import read_asset
    from gf_usd.geometry.sampling import sample_solid, sample_surface
    from gf_usd.geometry.solid import build_solid
    from gf_usd.physics.solver import TotalLagrangian

    asset = read_asset(source, prims=tuple(prims), time_code=request.start)
    solid = build_solid(asset)
    unit = asset.facts.units.length
    particles = sample_solid(
        solid,
        particles=None if request.spacing else (request.particles or DEFAULT_PARTICLES),
        spacing=request.spacing * unit if request.spacing else None,
        seed=request.seed,
    )
    radius = particles.radius
    lowest = min(float((s.points @ asset.facts.up).min()) for s in asset.surfaces)
    settings = resolve(request, asset.facts, radius, lowest)
    made = look.material(radius, law)
    solver = TotalLagrangian(
        particles,
        [made],
        settings,
        samples=sample_surface(solid, particles.spacing, settings.seed),
        riders={s.path: s.points for s in asset.surfaces},
    )
    lift = sum(a * b for a, b in zip(settings.lift, settings.up))
    ridden = [f"<{p}> rides along and is not filled: {why}" for p, why in solid.riders]
    left = [f"<{p}> is left as it is: {why}" for p, why in asset.skipped]
    return Plan(
        asset=asset,
        particles=particles,
        material=made,
        settings=settings,
        outputs=files,
        solver=solver,
        riders=solid.riders,
        drop=lift + lowest,
        notes=(*asset.facts.notes, *ridden, *left),
    )


def bake(
    path: str | Path,
    *,
    material: str = "rubber",
    output: str | Path | None = None,
    law: str | None = None,
    prims: Sequence[str] = (),
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> BakeResult:
    """Fill an asset with particles, simulate it and write its layers.

    Parameters
    ----------
    path : the asset; it is never written to.
    material : a look, see ``gf-usd materials``.
    output : root layer, or a folder; default ``NAME.LOOK.usda`` in the current folder.
    law : constitutive law in place of the look's own: corotated or neoHookean.
    prims : prim paths to bake; default all under the default prim.
    overwrite : replace results of an earlier bake.
    progress : called after each frame with (frames done, frames in all).
    options : the fields of `planning.Request`: particles, spacing [stage units], frames, fps,
        start [time code], drop ("3r" or stage units), gravity [m/s^2], seed, device, threads.

    Raises
    ------
    UsageError : the options make no sense, or the output exists or cannot be written.
    InputError : the asset was refused; nothing was written.
    BakeError : the simulation failed; only ``*.partial.*`` files and the report remain.
    """
    plan = prepare(
        path, material=material, output=output, law=law, prims=prims, overwrite=overwrite, **options
    )
    return run(plan, progress)


def run(plan: Plan, progress: Progress | None = None) -> BakeResult:
    """Simulate and write a prepared bake."""
    from gf_usd.usd.cache import CacheWriter
    from gf_usd.usd.layout import write_root
    from gf_usd.usd.variants import BakedLook

    claim(plan.outputs)
    began = time.perf_counter()
    info = BakeInfo(
        look=plan.material.name,
        materials=(plan.material,),
        settings=plan.settings,
        command=_command(plan),
        version=gf_usd.__version__,
        input_hash=hashlib.sha256(plan.asset.facts.path.read_bytes()).hexdigest(),
    )
    log = HealthLog(plan.settings, plan.particles.spacing, plan.drop)
    with CacheWriter(plan.outputs.cache, plan.asset, plan.particles, info) as cache:
        for baked in _frames(plan):
            cache.write(baked)
            log.add(baked.health)
            if progress:
                progress(baked.index + 1, plan.settings.frames)
        summary = cache.close()
    health = log.summary()
    publish(plan.outputs.cache)
    look = BakedLook(name=info.look, cache=plan.outputs.cache, info=info, health=_plain(health))
    root = write_root(plan.outputs.root, plan.asset, [look])
    notes = (*plan.notes, *summary.notes, *root.notes)
    seconds = time.perf_counter() - began
    report = {
        "command": info.command, "version": info.version, "input_sha256": info.input_hash,
        **plan.describe(), "notes": list(notes), "seconds": seconds,
        "settings": asdict(plan.settings), "health": health, "per_frame": log.per_frame(),
    }  # fmt: skip
    publish_text(plan.outputs.report, json.dumps(report, indent=1) + "\n")
    return BakeResult(
        root=plan.outputs.root, cache=plan.outputs.cache, report=plan.outputs.report,
        frames=summary.frames, particles=len(plan.particles), seconds=seconds,
        settings=plan.settings, material=plan.material, health=health, notes=notes,
    )  # fmt: skip


def _frames(plan: Plan) -> Iterator[BakedFrame]:
    """Poses of meshes and Gaussians, frame by frame, in playback time."""
    from gf_usd.physics.gaussians import GaussianTrack

    track = GaussianTrack(plan.particles.orientation, plan.particles.scale)
    for frame in plan.solver.frames():
        yield _baked(plan, frame, track)


def _baked(plan: Plan, frame: Frame, track: Any) -> BakedFrame:
    from dataclasses import replace

    from gf_usd.physics.embedding import deform_normals

    s = plan.settings
    meshes = {}
    for surface in plan.asset.surfaces:
        pose = frame.riders[surface.path]
        normals = None
        if surface.normals is not None and surface.normal_points is not None:
            normals = deform_normals(surface.normals, surface.normal_points, pose.F)
        meshes[surface.path] = MeshPose(
            points=pose.x, velocities=pose.v * s.time_scale, normals=normals
        )
    gaussians = track.advance(frame.particles)
    return BakedFrame(
        index=frame.index,
        time_code=s.start + frame.index * s.time_codes_per_second / s.fps,
        meshes=meshes,
        gaussians=replace(gaussians, velocities=gaussians.velocities * s.time_scale),
        health=frame.health,
    )


def _request(options: dict[str, Any]) -> Request:
    known = Request.__dataclass_fields__
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise UsageError(
            f"bake() has no option {unknown[0]!r}", f"its options are {', '.join(sorted(known))}"
        )
    request = Request(**options)
    request.check()
    return request


def _command(plan: Plan) -> str:
    words = ["gf-usd", "bake", plan.asset.facts.path.name, "--material", plan.material.name]
    words += ["--particles", str(len(plan.particles)), "--frames", str(plan.settings.frames)]
    words += ["--fps", f"{plan.settings.fps:g}", "--seed", str(plan.settings.seed)]
    return shlex.join(words)


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Without None, which layer metadata cannot hold."""
    return {key: value for key, value in values.items() if value is not None}

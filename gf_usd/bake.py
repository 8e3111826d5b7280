"""The street: asset -> particles -> frames -> layers.  The only file that knows all of it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from gf_usd import materials as presets
from gf_usd.errors import UsageError
from gf_usd.model import BakedFrame, BakeInfo, Frame, Material, MeshPose, Pose, SurfaceSamples
from gf_usd.output_files import claim, outputs, require_free
from gf_usd.plan import BakeResult, LookResult, Plan, describe, input_hash
from gf_usd.planning import DEFAULT_PARTICLES, PAPER_PARTICLES, Request, resolve
from gf_usd.publish import publish, publish_text
from gf_usd.runtime import init_taichi
from gf_usd.summary import HealthLog

Progress = Callable[[int, int], None]  # (frames done, frames in all)


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
    material : a preset (see ``gf-usd materials``), a USD file with a material, or several with
        commas between them, which become variants of one root layer.
    output : root layer, or a folder; default ``NAME.MATERIAL.usda`` in the current folder.
    law : constitutive law in place of the material's own: corotated or neoHookean.
    prims : prim paths to bake; default all under the default prim.
    overwrite : replace results of an earlier bake.
    progress : called after each frame with (frames done, frames in all).
    options : the fields of `planning.Request`: particles, spacing [stage units], frames, fps,
        start [time code], drop ("3r" or stage units), gravity [m/s^2], seed, device, threads,
        filter_rate [1/T], damping_time [s], friction, restitution, time_scale, skin and so on.

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
    """Read, check and fill an asset; nothing is written.  See `bake` for the parameters."""
    request = _request(options)
    if law is not None:
        presets.check_law(law)
    from gf_usd.usd import schema  # noqa: F401  (registers itself before any stage opens)

    looks = [_find(name, request) for name in material.split(",")]
    source = Path(path)
    names = [look.name for look in looks]
    files = outputs(source, names, None if output is None else str(output))
    require_free(files, overwrite)

    # A device that is not there is found out before the asset is read.
    init_taichi(request.device, request.threads)
    from gf_usd.assets import read_asset
    from gf_usd.geometry.sampling import sample_solid, sample_surface
    from gf_usd.geometry.skinning import SKIN_NOTES
    from gf_usd.geometry.solid import build_solid

    asset = read_asset(source, prims=tuple(prims), time_code=request.start)
    solid = build_solid(asset)
    unit = asset.facts.units.length
    default = PAPER_PARTICLES if request.preset == "paper" else DEFAULT_PARTICLES
    particles = sample_solid(
        solid,
        particles=None if request.spacing else (request.particles or default),
        spacing=request.spacing * unit if request.spacing else None,
        seed=request.seed,
        uniform=request.preset == "paper",
    )
    if request.preset == "paper":
        # There every particle feels the floor; a mass of rho * area * spacing is its own.
        samples = SurfaceSamples(X=particles.X, area=particles.V0 / particles.spacing)
    else:
        samples = sample_surface(solid, particles.spacing, request.seed)
    lowest = min(float((s.points @ asset.facts.up).min()) for s in asset.surfaces)
    settings = resolve(request, asset.facts, particles.radius, lowest)
    lift = sum(a * b for a, b in zip(settings.lift, settings.up))
    ridden = [f"<{p}> rides along and is not filled: {why}" for p, why in solid.riders]
    left = [f"<{p}> is left as it is: {why}" for p, why in asset.skipped]
    return Plan(
        asset=asset,
        particles=particles,
        samples=samples,
        materials=tuple(_made(look, particles.radius, law, request) for look in looks),
        settings=settings,
        outputs=files,
        riders=solid.riders,
        drop=lift + lowest,
        notes=(*asset.facts.notes, *ridden, *left, *SKIN_NOTES.get(settings.skin, ())),
    )


def run(plan: Plan, progress: Progress | None = None) -> BakeResult:
    """Simulate and write a prepared bake."""
    from gf_usd.usd.layout import write_root
    from gf_usd.usd.review import review
    from gf_usd.usd.variants import BakedLook

    claim(plan.outputs)
    began = time.perf_counter()
    results, looks, notes = [], [], list(plan.notes)
    for number, material in enumerate(plan.materials):
        result, info, more = _run_look(plan, number, material, progress)
        results.append(result)
        notes += more
        looks.append(
            BakedLook(
                name=material.name, cache=result.cache, info=info, health=_plain(result.health)
            )
        )
    root = write_root(plan.outputs.root, plan.asset, looks)
    notes += root.notes
    findings = review(plan.outputs.root, plan.asset.facts.path)
    seconds = time.perf_counter() - began
    report = {
        **describe(plan),
        "notes": notes,
        "seconds": seconds,
        "settings": asdict(plan.settings),
        "bakes": [r.as_json(frames=True) for r in results],
        "check": findings,
    }
    publish_text(plan.outputs.report, json.dumps(report, indent=1) + "\n")
    return BakeResult(
        root=plan.outputs.root,
        report=plan.outputs.report,
        bakes=tuple(results),
        particles=len(plan.particles),
        seconds=seconds,
        settings=plan.settings,
        notes=tuple(notes),
        findings=tuple(findings),
    )


def _run_look(
    plan: Plan, number: int, material: Material, progress: Progress | None
) -> tuple[LookResult, BakeInfo, tuple[str, ...]]:
    """Simulate one material into its cache."""
    from gf_usd.usd.cache import CacheWriter

    total = plan.settings.frames
    info = BakeInfo(
        look=material.name,
        materials=(material,),
        settings=plan.settings,
        command=plan.command,
        version=plan.version,
        input_hash=input_hash(plan),
    )
    log = HealthLog(plan.settings, plan.particles.spacing, plan.drop)
    target = plan.outputs.caches[number]
    with CacheWriter(target, plan.asset, plan.particles, info) as cache:
        for baked in _frames(plan, material):
            cache.write(baked)
            log.add(baked.health)
            if progress:
                progress(number * total + baked.index + 1, total * len(plan.materials))
        summary = cache.close()
    publish(target)
    result = LookResult(
        look=material.name,
        cache=target,
        material=material,
        frames=summary.frames,
        health=log.summary(),
        per_frame=log.per_frame(),
    )
    return result, info, summary.notes


def _frames(plan: Plan, material: Material) -> Iterator[BakedFrame]:
    """Poses of meshes and Gaussians, frame by frame, in playback time."""
    from gf_usd.geometry.skinning import MeshSkin
    from gf_usd.physics.gaussians import GaussianTrack

    track = GaussianTrack(plan.particles.orientation, plan.particles.scale)
    skin = None
    if plan.settings.skin != "embed":
        skin = MeshSkin(plan.settings.skin, plan.points, plan.particles.X)
    for frame in plan.solver(material).frames():
        poses = skin.poses(frame.particles) if skin else frame.riders
        yield _baked(plan, frame, poses, track)


def _baked(plan: Plan, frame: Frame, poses: Mapping[str, Pose], track: Any) -> BakedFrame:
    from gf_usd.physics.embedding import deform_normals

    s = plan.settings
    meshes = {}
    for surface in plan.asset.surfaces:
        pose = poses[surface.path]
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
        gaussians=replace(
            gaussians,
            velocities=gaussians.velocities * s.time_scale,
            F=frame.particles.F if s.deformation_gradients else None,
            stress=frame.stress,
        ),
        health=frame.health,
    )


def _find(name: str, request: Request) -> Any:
    """A preset, or the material of a file in the clothes of one."""
    from gf_usd.usd.material_file import is_material_file, read_material

    if is_material_file(name):
        return presets.Fixed(read_material(Path(name)))
    look = presets.find_preset(name.strip())
    # The paper has every solid corotated.
    return replace(look, law="corotated") if request.preset == "paper" else look


def _made(look: Any, radius: float, law: str | None, request: Request) -> Material:
    """A material on a body of radius [m], with what the request says in place of its own."""
    own = {
        name: value
        for name in ("damping_time", "friction", "restitution")
        if (value := getattr(request, name)) is not None
    }
    return replace(look.material(radius, law), **own)


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


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Without None, which layer metadata cannot hold."""
    return {key: value for key, value in values.items() if value is not None}

"""The street: asset -> particles -> frames -> layers.  The only file that knows all of it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gf_usd.model import BakedFrame, BakeInfo, Frame, Material, MeshPose, Pose
from gf_usd.output_files import claim
from gf_usd.plan import BakeResult, LookResult, Plan, describe, input_hash, settings_json
from gf_usd.preflight import prepare
from gf_usd.publish import publish, publish_text
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
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    repair: bool = False,
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
    meters_per_unit, up_axis : in place of what the file says or omits.
    repair : mend the triangles that are filled (`geometry.repair`); the asset keeps its own.
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
        path, material=material, output=output, law=law, prims=prims, overwrite=overwrite,
        meters_per_unit=meters_per_unit, up_axis=up_axis, repair=repair, **options,
    )  # fmt: skip
    return run(plan, progress)


def run(plan: Plan, progress: Progress | None = None) -> BakeResult:
    """Simulate and write a prepared bake."""
    from gf_usd.usd.layout import write_root
    from gf_usd.usd.review import review
    from gf_usd.usd.variants import BakedLook

    claim(plan.outputs)
    began = time.perf_counter()
    if plan.converted is not None:
        plan.converted.write(plan.source)
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
    root = write_root(plan.outputs.root, plan.asset, looks, source=plan.source)
    notes += root.notes
    findings = review(plan.outputs.root, plan.source)
    seconds = time.perf_counter() - began
    report = {
        **describe(plan),
        "notes": notes,
        "seconds": seconds,
        "settings": settings_json(plan.settings),
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
    with CacheWriter(target, plan.asset, plan.particles, info, source=plan.source) as cache:
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


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Without None, which layer metadata cannot hold."""
    return {key: value for key, value in values.items() if value is not None}

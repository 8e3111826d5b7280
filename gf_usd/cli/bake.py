"""gf-usd bake: the main job."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from gf_usd.cli import exit
from gf_usd.cli.events import STDOUT, event_stream
from gf_usd.cli.options import (
    ClipFrames,
    Combine,
    Drop,
    Flatten,
    Fps,
    Frames,
    Half,
    Handles,
    LimitsOf,
    Material,
    MaterialBoxes,
    MaterialLabels,
    MetersPerUnit,
    Only,
    Particles,
    Prims,
    Range,
    Resume,
    SamplesPerFrame,
    Seed,
    Slice,
    Solver,
    Spacing,
    Start,
    UpAxis,
)
from gf_usd.core import __version__
from gf_usd.core.errors import UsageError


def bake(
    asset: Annotated[Path, typer.Argument(help="The asset; it is never written to.")],
    material: Material = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o",
            help="Root layer, a package (.usdz), or a folder if it ends in / or is one.",
            show_default="NAME.MATERIAL.usda in this folder",
        ),
    ] = None,
    particles: Particles = None,
    spacing: Spacing = None,
    frames: Frames = None,
    fps: Fps = None,
    start: Start = None,
    drop: Drop = None,
    gravity: Annotated[
        str | None,
        typer.Option(help="[m/s^2] downward, or x,y,z.", show_default="9.81"),
    ] = None,
    floor: Annotated[
        str | None,
        typer.Option(
            help="none, its height [stage units], its normal x,y,z, or both: 0.5:0.2,1,0.",
            show_default="0",
        ),
    ] = None,
    pin: Annotated[
        list[str] | None,
        typer.Option(
            help="Hold a region, moving as the asset is animated; repeatable. A GeomSubset, a mesh"
            " or a prim above meshes, or box:x0,y0,z0,x1,y1,z1 [stage units].",
            show_default="nothing",
        ),
    ] = None,
    law: Annotated[
        str | None,
        typer.Option(help="corotated or neoHookean.", show_default="the material's"),
    ] = None,
    seed: Seed = None,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    threads: Annotated[
        int | None, typer.Option(help="CPU threads.", show_default="all")
    ] = None,
    prim: Prims = None,
    export_ply: Annotated[
        str | None,
        typer.Option(
            help="Folder for a sequence of 3DGS PLY files, one for each frame.",
            show_default="none",
        ),
    ] = None,
    export_spz: Annotated[
        str | None,
        typer.Option(help="The same as SPZ files.", show_default="none"),
    ] = None,
    meters_per_unit: MetersPerUnit = None,
    up_axis: UpAxis = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="For the fill, close small holes, unify winding, drop faces that bound nothing,"
            " give sheets thickness; the mesh itself stays as it is.",
        ),
    ] = False,
    filter_rate: Annotated[
        float | None,
        typer.Option(help="Of the APIC filter [1/T]; inf or 0 are its limits.", show_default="10"),
    ] = None,
    damping_time: Annotated[
        float | None,
        typer.Option(help="Kelvin-Voigt damping [s].", show_default="the material's"),
    ] = None,
    friction: Annotated[
        float | None, typer.Option(help="Coulomb's.", show_default="the material's")
    ] = None,
    restitution: Annotated[
        float | None,
        typer.Option(help="Of the contact springs, 0 to 1.", show_default="the material's"),
    ] = None,
    blend_width: Annotated[
        float | None,
        typer.Option(
            help="Over which materials of one body turn into each other [stage units].",
            show_default="0",
        ),
    ] = None,
    material_box: MaterialBoxes = None,
    material_label: MaterialLabels = None,
    drag: Annotated[float | None, typer.Option(help="On velocity [1/s].", show_default="0")] = None,
    time_scale: Annotated[
        str | None,
        typer.Option(
            help="Simulated seconds per second of playback; auto plays any size like 1 m.",
            show_default="1",
        ),
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help="paper: the set-up of the GaussianFlesh paper.")
    ] = None,
    skin: Annotated[
        str | None,
        typer.Option(
            help="How meshes follow: embed (the solver's grid), idw (nearest particles), paper"
            " (all particles, GaussianFlesh eq. 6).",
            show_default="embed; paper with --preset paper",
        ),
    ] = None,
    combine: Combine = False,
    self_contact: Annotated[
        bool, typer.Option("--self-contact", help="A body meets itself, too.")
    ] = False,
    solver: Solver = None,
    no_shortcuts: Annotated[
        bool, typer.Option("--no-shortcuts", help="Simulate free flight and sleep, too.")
    ] = False,
    wls: Annotated[
        bool | None,
        typer.Option(
            "--wls/--no-wls",
            help="Compute F anew from the particles' places once a frame (the paper's).",
            show_default="no; wls with --preset paper",
        ),
    ] = None,
    procrustes: Annotated[
        float | None,
        typer.Option(
            help="Part of the way back to the rest shape a frame, 0 to 1 (the paper's).",
            show_default="0; 0.02 for rubber with --preset paper",
        ),
    ] = None,
    clamp: Annotated[
        str | None,
        typer.Option(
            help="LOW:HIGH, limits of the stretches that make stress, or none (the paper's).",
            show_default="none; 0.2:5 with --preset paper",
        ),
    ] = None,
    stress_cap: Annotated[
        str | None,
        typer.Option(
            help="Largest stress |P| [Pa], or none (the paper's).",
            show_default="none; 65 rho g r with --preset paper",
        ),
    ] = None,
    deformation_gradients: Annotated[
        bool, typer.Option("--deformation-gradients", help="Write F of every particle.")
    ] = False,
    stress: Annotated[
        bool, typer.Option("--stress", help="Write the von Mises stress of every particle.")
    ] = False,
    only: Only = None,
    flatten: Flatten = False,
    half: Half = False,
    samples_per_frame: SamplesPerFrame = None,
    range: Range = None,
    handles: Handles = None,
    clip_frames: ClipFrames = None,
    resume: Resume = False,
    slice: Slice = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be done and what it would cost.")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Warnings about the result are an error (status 4).")
    ] = False,
    max_hours: Annotated[
        float, typer.Option(min=0.0, help="Refuse a bake that is estimated to take longer [h].")
    ] = 1.0,
    limits: LimitsOf = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    events: Annotated[
        str | None,
        typer.Option(
            help="File for what happens, a JSON object a line; - is stdout, a number an open file"
            " descriptor.",
            show_default="none",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only errors and JSON.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show the plan first.")] = False,
) -> None:  # fmt: skip
    """Make an asset soft: fill it with particles, let it fall, write layers over it.

    Writes NAME.MATERIAL.usda (open this one), NAME.MATERIAL.cache.usdc and
    NAME.MATERIAL.report.json; the asset itself is left as it is.  A mesh file (obj, ply, stl, off,
    glb, gltf, fbx) also becomes NAME.source.usdc, with NAME.textures/ where pictures were in it.
    """
    from gf_usd.cli.console import announce, progress, show_plan, summarise
    from gf_usd.pipeline.result import require_healthy
    from gf_usd.pipeline.run import prepare, run
    from gf_usd.prepare.plan import describe
    from gf_usd.system.sandbox import parse_limits

    if as_json and events == STDOUT:
        raise UsageError("--json and --events - both want stdout", "give --events a file")
    with event_stream(events) as emit:
        emit("started", asset=str(asset), version=__version__, pid=os.getpid())
        prepared = prepare(
            asset, material=material, output=output, law=law, prims=prim or (),
            overwrite=overwrite or dry_run,  # a dry run replaces nothing
            particles=particles, spacing=spacing, frames=frames, fps=fps, start=start, drop=drop,
            gravity=gravity, floor=floor, pins=tuple(pin or ()), seed=seed, device=device,
            combine=combine, self_contact=self_contact, threads=threads, filter_rate=filter_rate,
            damping_time=damping_time, friction=friction, restitution=restitution, drag=drag,
            blend_width=blend_width, material_boxes=tuple(material_box or ()),
            material_labels=tuple(material_label or ()),
            time_scale=time_scale, preset=preset, deformation_gradients=deformation_gradients,
            stress=stress, skin=skin, solver=solver, no_shortcuts=no_shortcuts,
            wls=wls, procrustes=procrustes, clamp=clamp, stress_cap=stress_cap,
            export_ply=export_ply, export_spz=export_spz, meters_per_unit=meters_per_unit,
            up_axis=up_axis, repair=repair, only=only, flatten=flatten, half=half,
            samples_per_frame=samples_per_frame, range=range, handles=handles,
            clip_frames=clip_frames, resume=resume, limits=parse_limits(limits),
        )  # fmt: skip
        plan = prepared.plan
        exit.watch(plan.outputs.checkpoints)
        if events is not None:
            emit("plan", **describe(plan), **prepared.cost)
        for note in plan.notes:
            emit("note", message=note)
        if dry_run:
            if as_json or events != STDOUT:
                show_plan(prepared, as_json=as_json, max_hours=max_hours)
            return
        if verbose:
            show_plan(prepared, err=True, max_hours=max_hours)
        if not quiet:
            announce(prepared)
        with progress(plan, shown=not quiet) as advance:

            def on_frame(done: int, total: int) -> None:
                advance(done, total)
                emit("frame", done=done, total=total, particles=len(plan.particles))

            result = run(prepared, on_frame, max_hours=max_hours, slice=slice)
        for note in result.notes[len(plan.notes) :]:
            emit("note", message=note)
        for look, warning in result.warnings:
            emit("warning", look=look, **warning.as_json())
        emit("finished", **result.as_json())
        if as_json:
            typer.echo(json.dumps(result.as_json(), indent=1))
        elif not quiet and events != STDOUT:
            summarise(result, plan)
        if strict:
            require_healthy(result)

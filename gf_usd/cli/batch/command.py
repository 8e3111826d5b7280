"""gf-usd batch: many bakes; a failed one does not stop the others."""

from __future__ import annotations

import typer

from gf_usd.cli.batch import options
from gf_usd.cli.options import LimitsOf


def batch(
    sources: options.Sources,
    material: options.Material = None,
    seed: options.Seed = None,
    out: options.Out = None,
    name: options.Name = None,
    particles: options.Particles = None,
    frames: options.Frames = None,
    limits: LimitsOf = None,
    setting: options.Setting = None,
    at_once: options.AtOnce = None,
    memory: options.Memory = None,
    timeout: options.Timeout = None,
    retries: options.Retries = None,
    select: options.Select = None,
    failed: options.Failed = False,
    overwrite: options.Overwrite = False,
    warm: options.Warm = True,
    scheduler: options.Scheduler = None,
    resource: options.Resource = None,
    openjd: options.OpenJD = None,
    chunk: options.Chunk = None,
    slice: options.Slice = None,
    part: options.Part = None,
    program: options.Program = None,
    tasks: options.Tasks = None,
    path_mapping: options.PathMapping = None,
    openjd_lines: options.OpenJDLines = False,
    no_report: options.NoReport = False,
    report_only: options.ReportOnly = False,
    dry_run: options.DryRun = False,
    as_json: options.AsJSON = False,
    quiet: options.Quiet = False,
) -> None:
    """Bake many assets with many materials and settings, in parallel.

    Finished jobs whose inputs have not changed are skipped. The exit status is 1 if a job did not
    succeed, 5 if slices remain, 143 if terminated, 130 if interrupted; run the same command again
    to continue.
    """
    from gf_usd.batch.slices import parse_part
    from gf_usd.cli.batch.arguments import Arguments, parse_settings, plan_of, require_company
    from gf_usd.cli.batch.export import BundleOptions, export_bundle, list_jobs
    from gf_usd.cli.batch.results import ResultOptions, write_page_again
    from gf_usd.cli.batch.run import RunOptions, run_jobs
    from gf_usd.cli.batch.selection import Selection, selected_jobs

    require_company({"--resource": resource}, "--scheduler", scheduler)
    require_company({"--chunk": chunk, "--program": program}, "--openjd", openjd)
    whole_frames = int(frames) if frames and frames.isdecimal() else frames
    named = {"particles": particles, "limits": limits, "frames": whole_frames}
    arguments = Arguments(
        materials=material, seeds=seed, settings=parse_settings(setting or (), named), name=name,
        out=out, timeout=timeout, retries=retries, path_mapping=path_mapping,
    )  # fmt: skip
    plan = plan_of(sources, arguments)
    for note in plan.notes:
        typer.echo(f"note: {note}", err=True)
    jobs = selected_jobs(plan, Selection(names=tuple(select or ()), failed=failed, tasks=tasks))
    results = ResultOptions(
        report=not no_report, tasks=tasks is not None, as_json=as_json, openjd_lines=openjd_lines,
        part=None if part is None else parse_part(part, slice),
    )  # fmt: skip
    if dry_run:
        list_jobs(plan, jobs, as_json=as_json)
    elif openjd is not None:
        form = BundleOptions(folder=openjd, chunk=chunk, program=program, slice=slice)
        export_bundle(plan, jobs, form)
    elif report_only:
        write_page_again(plan, results)
    else:
        how = RunOptions(
            at_once=at_once, memory=memory, overwrite=overwrite, warm=warm, scheduler=scheduler,
            resources=tuple(resource or ()), quiet=quiet, slice=slice, results=results,
        )  # fmt: skip
        raise typer.Exit(run_jobs(plan, jobs, how))

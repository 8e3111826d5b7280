"""From the words of ``batch`` to its plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gf_usd.batch.bundle import is_bundle, mapped, moved_to, pieces, read_jobs
from gf_usd.batch.job import Job
from gf_usd.batch.manifest import OUT, SUFFIXES, Manifest, absolute, make_group, read_manifest
from gf_usd.batch.options import clean, parse
from gf_usd.batch.plan import BatchPlan, choose, make_plan
from gf_usd.batch.summary import SUMMARY, failed_in
from gf_usd.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the command line says beside the manifest or the assets."""

    materials: str | None = None
    seeds: str | None = None
    settings: Mapping[str, Any] | None = None  # --particles, --frames and --set
    name: str | None = None
    out: Path | None = None
    timeout: float | None = None
    retries: int | None = None
    path_mapping: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Choice:
    """Which jobs of a plan."""

    only: tuple[str, ...] = ()
    failed: bool = False
    tasks: str | None = None


def chosen(plan: BatchPlan, choice: Choice) -> tuple[Job, ...]:
    """The jobs that are asked for.  Raises UsageError for a name or number that none has."""
    jobs = choose(plan, choice.only) if choice.only else plan.jobs
    if choice.failed:
        names = set(failed_in(plan.out / f"{plan.title}{SUMMARY}"))
        jobs = tuple(job for job in jobs if job.name in names)
    if choice.tasks is not None:
        wanted = {plan.jobs[number].name for number in pieces(choice.tasks, len(plan.jobs))}
        jobs = tuple(job for job in jobs if job.name in wanted)
    return jobs


def plan_of(sources: Sequence[str], asked: Asked) -> BatchPlan:
    """The plan that a manifest, the jobs of a bundle, or assets come to.

    Raises UsageError, or InputError for a manifest that cannot be read.
    """
    kinds = [Path(source).suffix.lower() in SUFFIXES for source in sources]
    if any(kinds) and len(sources) > 1:
        raise UsageError(
            f"{len(sources)} files were given, and {sources[kinds.index(True)]} is a manifest",
            "give one manifest, or assets",
        )
    if kinds == [True] and is_bundle(Path(sources[0])):
        return _bundle(Path(sources[0]), asked)
    if asked.path_mapping is not None:
        raise UsageError(
            "--path-mapping goes with the jobs of a bundle", "give the bundle's jobs.json"
        )
    manifest = read_manifest(Path(sources[0])) if kinds == [True] else _of_assets(sources, asked)
    if kinds == [True]:
        manifest = _overridden(manifest, asked)
    if asked.out is not None:
        manifest = replace(manifest, out=absolute(asked.out))
    if asked.timeout is not None:
        manifest = replace(manifest, timeout=asked.timeout)
    if asked.retries is not None:
        manifest = replace(manifest, retries=asked.retries)
    return make_plan(manifest)


def parse_settings(words: Sequence[str], named: Mapping[str, Any]) -> dict[str, Any]:
    """NAME=VALUE pairs and options of their own.  Raises UsageError for what is no pair."""
    settings = {key: value for key, value in named.items() if value is not None}
    for word in words:
        name, sign, text = word.partition("=")
        if not sign or not name:
            raise UsageError(f"--set {word}: there is no value", "give --set NAME=VALUE")
        settings[name] = parse(name, text, f"--set {word}")
    return settings


def _axes(asked: Asked) -> dict[str, list[Any]]:
    """The axes that the command line names: it separates jobs, not variants, by commas."""
    axes: dict[str, list[Any]] = {}
    if asked.materials is not None:
        axes["material"] = [part.strip() for part in asked.materials.split(",")]
    if asked.seeds is not None:
        axes["seed"] = [parse("seed", part, "--seed") for part in asked.seeds.split(",")]
    return axes


def _of_assets(sources: Sequence[str], asked: Asked) -> Manifest:
    group = make_group(
        sources, settings=asked.settings or {}, matrix={"material": ["rubber"], **_axes(asked)},
        name=asked.name, folder=Path.cwd(), where="the command line",
    )  # fmt: skip
    out = absolute(asked.out or Path(OUT))
    return Manifest(groups=(group,), folder=Path.cwd(), title=out.name, out=out)


def _overridden(manifest: Manifest, asked: Asked) -> Manifest:
    """A manifest whose settings and axes give way to those of the command line."""
    axes = {
        key: [clean({key: value}, "the command line", Path.cwd())[key] for value in values]
        for key, values in _axes(asked).items()
    }
    settings = clean(asked.settings or {}, "the command line", Path.cwd())
    groups = []
    for group in manifest.groups:
        own = {k: v for k, v in {**group.settings, **settings}.items() if k not in axes}
        matrix = {k: v for k, v in {**group.matrix, **axes}.items() if k not in settings}
        groups.append(replace(group, settings=own, matrix=matrix, name=asked.name or group.name))
    return replace(manifest, groups=tuple(groups))


def _bundle(path: Path, asked: Asked) -> BatchPlan:
    """The jobs of a bundle as they are; only where and how they run may be said anew."""
    fixed = (asked.materials, asked.seeds, asked.settings or None, asked.name)
    if any(value is not None for value in fixed):
        raise UsageError(
            f"{path} holds jobs whose options are fixed", "make the bundle again with other options"
        )
    plan = read_jobs(path)
    if asked.path_mapping is not None:
        plan = mapped(plan, asked.path_mapping)
    if asked.out is not None:
        plan = moved_to(plan, absolute(asked.out))
    if asked.timeout is not None:
        plan = replace(plan, timeout=asked.timeout)
    return plan if asked.retries is None else replace(plan, retries=asked.retries)

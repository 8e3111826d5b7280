"""Expands a manifest into jobs: every combination of options, each with a unique name.

Also writes and reads the jobs of a plan as a file, to be run where paths may differ.
"""

from __future__ import annotations

import fnmatch
import itertools
import json
import os
import re
import string
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from gf_usd.batch.job import RECORD, Job
from gf_usd.batch.manifest import Group, Manifest, is_unset, material_files, obstacle_files
from gf_usd.core.errors import InputError, UsageError
from gf_usd.prepare.outputs.outputs import outputs, sequences

UNFIT = re.compile(r"[^\w.+]+")  # letters and digits of any script
LONGEST_PART = 200  # bytes of a file name: files next to the root layer have longer names


@dataclass(frozen=True, kw_only=True)
class BatchPlan:
    """All jobs of a batch."""

    jobs: tuple[Job, ...]
    out: Path  # absolute
    title: str
    timeout: float | None  # [s] of an attempt
    retries: int
    notes: tuple[str, ...] = ()  # on files that are not baked


def make_plan(manifest: Manifest) -> BatchPlan:
    """The jobs of a manifest, in the order of its assets, the combinations of one asset together.

    Raises UsageError where two jobs would write the same file, or a result would replace an asset.
    """
    _require_folder(manifest.out)
    jobs = tuple(job for group in manifest.groups for job in _jobs(group, manifest.out))
    _require_distinct_files(jobs)
    return BatchPlan(
        jobs=jobs,
        out=manifest.out,
        title=manifest.title,
        timeout=manifest.timeout,
        retries=manifest.retries,
        notes=tuple(dict.fromkeys(note for group in manifest.groups for note in group.notes)),
    )


def _require_folder(out: Path) -> None:
    """Raise UsageError where the folder of the results, or one above it, is a file."""
    there = next((one for one in (out, *out.parents) if one.exists()), out)
    if there.exists() and not there.is_dir():
        raise UsageError(f"{there} is not a folder", "choose a folder for the results: --output")


def jobs_matching(plan: BatchPlan, patterns: Sequence[str]) -> tuple[Job, ...]:
    """The jobs whose names match one of the patterns.  Raises UsageError for a pattern without a
    match.
    """
    chosen: dict[str, Job] = {}
    for pattern in patterns:
        # an exact name takes precedence over a pattern
        found = [job for job in plan.jobs if job.name == pattern] or [
            job for job in plan.jobs if fnmatch.fnmatchcase(job.name, pattern)
        ]
        if not found:
            raise UsageError(
                f"no job matches {pattern}", "gf-usd batch --dry-run lists their names"
            )
        chosen.update((job.name, job) for job in found)
    return tuple(job for job in plan.jobs if job.name in chosen)


def _jobs(group: Group, out: Path) -> list[Job]:
    # materials identify a result best, so they come first in its name
    axes = dict(sorted(group.matrix.items(), key=lambda item: item[0] != "material"))
    template = group.name or default_template(axes)
    jobs = []
    for asset in group.files:
        for values in itertools.product(*axes.values()):
            chosen = {**group.settings, **dict(zip(axes, values))}
            name = name_of(template, asset, chosen, group.where)
            options = {key: value for key, value in chosen.items() if not is_unset(value)}
            jobs.append(Job(name=name, asset=asset, root=out / f"{name}.usda", options=options))
    return jobs


def default_template(axes: Mapping[str, Sequence[Any]]) -> str:
    """``{asset}.{material}``, and the other options that differ between jobs."""
    more = (f".{key}{{{key}}}" for key, vs in axes.items() if key != "material" and len(vs) > 1)
    return "{asset}.{material}" + "".join(more)


def name_of(template: str, asset: Path, options: Mapping[str, Any], where: str) -> str:
    """The name of a job from a template.

    Fields are asset (the file's name without suffix), folder (of the file), material and every
    option of the job.  Slashes make folders; unusual characters become dashes.

    Raises UsageError for an unknown field, one with a format, or a name that leaves the folder or
    is too long.
    """
    materials = str(options.get("material", "rubber")).split(",")
    files = {str(path): path.stem for path in material_files(options)}
    fields = {
        **options,
        "asset": asset.stem,
        "folder": asset.parent.name,
        "material": "-".join(files.get(m, m) for m in materials),
    }
    used = _fields(template, where)
    unknown = [field for field in used if field not in fields]
    if unknown:
        raise UsageError(
            f"{where}: the name {template!r} has the field {{{unknown[0]}}}",
            f"its fields here are {', '.join(sorted(fields))}",
        )
    name = template.format_map({k: _fit(str(v)) for k, v in fields.items()})
    parts = [_fit(part) for part in name.removesuffix(".usda").split("/")]
    if any(part in ("", ".", "..") for part in parts):
        raise UsageError(
            f"{where}: the name {template!r} gives {name!r}", "give a path under the folder"
        )
    longest = max((len(os.fsencode(part)), part) for part in parts)
    if longest[0] > LONGEST_PART:
        raise UsageError(
            f"{where}: {asset}: the name {longest[1][:40]}... of {longest[0]} bytes is too long",
            f"give a --name with folders or fewer fields: a part has at most {LONGEST_PART} bytes",
        )
    return "/".join(parts)


def _fields(template: str, where: str) -> list[str]:
    """The fields of a template.  Raises UsageError for an invalid template."""
    hint = "write fields as {asset}, without a format, and braces in pairs"
    try:
        rows = [row for row in string.Formatter().parse(template) if row[1] is not None]
    except ValueError as error:
        raise UsageError(f"{where}: the name {template!r} is damaged: {error}", hint) from error
    for _, field, form, conversion in rows:
        if form or conversion:
            raise UsageError(f"{where}: the name {template!r} formats the field {field!r}", hint)
    return [str(field) for _, field, _, _ in rows]


def _fit(text: str) -> str:
    """The text with characters that are valid in a file name."""
    # file systems differ in the Unicode normalization of accents
    return UNFIT.sub("-", unicodedata.normalize("NFC", text))


def _require_distinct_files(jobs: Sequence[Job]) -> None:
    """Raise UsageError where two jobs write the same file.

    Jobs that read one mesh file with the same options share its layer.
    """
    owners: dict[Path, tuple[Any, Job]] = {}
    for job in jobs:
        files = outputs(job.asset, job.variant_names, str(job.root))
        frames = sequences(
            job.asset.stem, job.variant_names,
            ply=job.options.get("export_ply"), spz=job.options.get("export_spz"),
        )  # fmt: skip
        splats = [one.path(0).absolute() for each in frames for one in each]
        own = ((path, job.name) for path in (*files.own, job.sibling(RECORD), *splats))
        reading = (str(job.asset), *(job.options.get(k) for k in ("meters_per_unit", "up_axis")))
        shared = ((path, reading) for path in ([files.source] if files.source else []))
        for path, owner in (*own, *shared):
            before, other = owners.setdefault(path, (owner, job))
            if before != owner or (owner == job.name and other is not job):
                raise UsageError(
                    f"{_described(other)} and {_described(job)} would both write {path}",
                    _way_apart(other.asset, job.asset),
                )


def _way_apart(one: Path, other: Path) -> str:
    """A hint at what gives the jobs of two assets files of their own."""
    if one.stem != other.stem and _fit(one.stem) == _fit(other.stem):
        return (
            "rename one of the assets: names of jobs have letters, digits, _, . and + only, so"
            f" that both are {_fit(one.stem)!r}"
        )
    return (
        "give the jobs different names: --name '{folder}/{asset}.{material}', with a field for each"
        " option of the matrix; frames of splats need a folder for each job"
    )


def _described(job: Job) -> str:
    return f"{job.asset} ({', '.join(f'{k} {v}' for k, v in job.options.items())})"


FORM = "gf-usd jobs 1"
PATHS = {"POSIX": PurePosixPath, "WINDOWS": PureWindowsPath, "URI": PurePosixPath}
PIECE = re.compile(r"(\d+)(?:-(\d+)(?::(\d+))?)?")


def jobs_text(plan: BatchPlan) -> str:
    """The file of a plan's jobs."""
    return json.dumps(
        {
            "form": FORM,
            "title": plan.title,
            "out": str(plan.out),
            "timeout": plan.timeout,
            "retries": plan.retries,
            "jobs": [job.as_json() for job in plan.jobs],
        },
        indent=1,
    )


def is_bundle(path: Path) -> bool:
    """Whether a JSON file holds jobs rather than a manifest."""
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(tree, dict) and tree.get("form") == FORM


def read_jobs(path: Path) -> BatchPlan:
    """The plan of a file of jobs.  Raises InputError where the file is damaged."""
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        jobs = tuple(Job.of(row) for row in tree["jobs"])
        for job in jobs:
            job.arguments()  # KeyError for an unknown option
        return BatchPlan(
            jobs=jobs, out=Path(tree["out"]), title=tree["title"], timeout=tree["timeout"],
            retries=tree["retries"],
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} contains no jobs: {error}", "write the bundle again: gf-usd batch --openjd"
        ) from error


def with_output_folder(plan: BatchPlan, out: Path) -> BatchPlan:
    """The same jobs with their results in another folder."""
    _require_folder(out)
    jobs = tuple(replace(job, root=out / f"{job.name}.usda") for job in plan.jobs)
    return replace(plan, jobs=jobs, out=out)


def with_mapped_paths(plan: BatchPlan, rules: Path) -> BatchPlan:
    """The plan with its paths mapped to this machine.

    rules : a file of path mapping rules in the format of Open Job Description sessions
        (``pathmapping-1.0``).  The first matching rule applies, longest source first.

    Raises InputError for an invalid file.
    """
    try:
        tree = json.loads(rules.read_text(encoding="utf-8"))
        rows = list(tree.get("path_mapping_rules", []))
        change = _mapping(rows)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{rules} contains no path mapping rules: {error}",
            "give the file that the session provides",
        ) from error
    jobs = tuple(_job_mapped(job, change) for job in plan.jobs)
    return replace(plan, jobs=jobs, out=Path(change(str(plan.out))))


def _mapping(rows: Sequence[Mapping[str, Any]]) -> Callable[[str], str]:
    known = []
    for row in sorted(rows, key=lambda row: -len(row["source_path"])):
        kind = PATHS[row["source_path_format"].upper()]
        known.append((kind, kind(row["source_path"]), Path(row["destination_path"])))

    def change(text: str) -> str:
        for kind, source, target in known:
            path = kind(text)
            if path.is_relative_to(source):
                return str(target.joinpath(*path.relative_to(source).parts))
        return text

    return change


def _job_mapped(job: Job, change: Callable[[str], str]) -> Job:
    options = dict(job.options)
    for file in material_files(options):
        options["material"] = options["material"].replace(str(file), change(str(file)))
    if "colliders" in options:
        options["colliders"] = [change(str(file)) for file in obstacle_files(options)]
    return replace(
        job, asset=Path(change(str(job.asset))), root=Path(change(str(job.root))), options=options
    )


def parse_task_range(text: str, jobs: int) -> tuple[int, ...]:
    """The numbers of a range expression, ``0,3-5,10-20:2``, each below `jobs`.

    Raises UsageError for an invalid expression.
    """
    numbers: list[int] = []
    for part in text.split(","):
        match = PIECE.fullmatch(part.strip())
        first = int(match[1]) if match else 0
        last, step = (int(match[2] or first), int(match[3] or 1)) if match else (0, 0)
        if last < first or step == 0:
            raise UsageError(f"--tasks {text}: {part!r} is not a range", "give for example 0,3-5")
        if last >= jobs:
            raise UsageError(
                f"--tasks {text} is outside the {jobs} jobs",
                f"the jobs are numbered 0 to {jobs - 1}",
            )
        numbers += range(first, last + 1, step)
    return tuple(dict.fromkeys(numbers))

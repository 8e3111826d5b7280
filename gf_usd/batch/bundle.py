"""The jobs of a plan as a file, to be run elsewhere, where paths may be others."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from gf_usd.batch.job import Job
from gf_usd.batch.options import material_files
from gf_usd.batch.plan import BatchPlan
from gf_usd.errors import InputError, UsageError

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
        return BatchPlan(
            jobs=jobs, out=Path(tree["out"]), title=tree["title"], timeout=tree["timeout"],
            retries=tree["retries"],
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} holds no jobs: {error}", "make the bundle again: gf-usd batch --openjd"
        ) from error


def moved_to(plan: BatchPlan, out: Path) -> BatchPlan:
    """The same jobs with their results in another folder."""
    jobs = tuple(replace(job, root=out / f"{job.name}.usda") for job in plan.jobs)
    return replace(plan, jobs=jobs, out=out)


def mapped(plan: BatchPlan, rules: Path) -> BatchPlan:
    """The plan with its paths as this machine has them.

    rules : a file of path mapping rules as Open Job Description hands them to a session
    (``pathmapping-1.0``).  The first rule that fits a path counts, the longest source first.
    Raises InputError where the file is damaged.
    """
    try:
        tree = json.loads(rules.read_text(encoding="utf-8"))
        rows = list(tree.get("path_mapping_rules", []))
        change = _mapping(rows)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{rules} holds no path mapping rules: {error}",
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
    return replace(
        job, asset=Path(change(str(job.asset))), root=Path(change(str(job.root))), options=options
    )


def pieces(text: str, jobs: int) -> tuple[int, ...]:
    """The numbers of a range expression, ``0,3-5,10-20:2``, each below `jobs`.

    Raises UsageError for what is none.
    """
    numbers: list[int] = []
    for part in text.split(","):
        match = PIECE.fullmatch(part.strip())
        if match is None:
            raise UsageError(f"--tasks {text}: {part!r} is no range", "give for example 0,3-5")
        first = int(match[1])
        last = int(match[2]) if match[2] else first
        numbers += range(first, last + 1, int(match[3] or 1))
    if not numbers or max(numbers) >= jobs:
        raise UsageError(
            f"--tasks {text} leaves the {jobs} jobs", f"their numbers are 0 to {jobs - 1}"
        )
    return tuple(dict.fromkeys(numbers))

"""A batch as a job bundle of Open Job Description: ``openjd run``, AWS Deadline Cloud and others.

    template.json           the job template, specification jobtemplate-2023-09
    parameter_values.json   values of its parameters, as Deadline Cloud reads them
    parameters.json         the same for openjd run
    asset_references.json   every file that is read, and the folder that is written
    jobs.json               the jobs, which the tasks count

A task is a chunk of jobs: one process, which bakes them one after another or in parallel,
prints its progress to stdout, and on SIGTERM ends its bakes and itself.  In slices, a step is one
slice of every job and waits for the step before: tasks of one step are independent.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gf_usd.batch.plan import BatchPlan, jobs_text
from gf_usd.batch.record import InputTable, input_paths
from gf_usd.batch.run import memory_of
from gf_usd.batch.slices import Part, slice_count
from gf_usd.core.errors import BakeError, UsageError
from gf_usd.system.atomic_files import publish_text

SPECIFICATION = "jobtemplate-2023-09"
TEMPLATE, JOBS, REFERENCES = "template.json", "jobs.json", "asset_references.json"
VALUES, FLAT = "parameter_values.json", "parameters.json"
NOTICE = 30  # [s] between the request to end and SIGKILL; longer than `processes.GRACE`
TARGET = 900  # [s] target duration of a chunk, where the scheduler adapts its size
REPORT_TIMEOUT = 3600  # [s]
LONGEST_NAME = 128  # characters of a job name


def write_bundle(
    plan: BatchPlan, folder: Path, *, chunk: int, program: str, table: InputTable,
    slice: int | None = None,
) -> list[Path]:  # fmt: skip
    """Write the bundle; returns its files.

    Parameters
    ----------
    chunk : jobs in a task.
    program : the Python that has gf-usd on a worker.
    slice : complete value clips of a job in a task; None: the whole job.

    Raises UsageError for an invalid chunk size or a job that cannot be sliced, BakeError where a
    file cannot be written.
    """
    if chunk < 1:
        raise UsageError(f"--chunk is {chunk}", "give 1 or more jobs")
    if not plan.jobs:
        raise UsageError("there are no jobs", "name assets that exist")
    folder = folder.absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BakeError(
            f"{folder} cannot be created: {error.strerror}",
            "choose another folder with --openjd, or change the permissions of its parent",
        ) from error
    given = {
        "JobsFile": str(folder / JOBS),
        "OutDir": str(plan.out),
        "Jobs": f"0-{len(plan.jobs) - 1}",
        "JobsPerTask": chunk,
        "Python": program,
    }
    rows = [{"name": name, "value": value} for name, value in given.items()]
    texts = {
        JOBS: jobs_text(plan),
        TEMPLATE: json.dumps(template(plan, chunk, slice), indent=1),
        VALUES: json.dumps({"parameterValues": rows}, indent=1),
        FLAT: json.dumps(given, indent=1),
        REFERENCES: json.dumps(references(plan, table), indent=1),
    }
    return [publish_text(folder / name, text + "\n") for name, text in texts.items()]


def template(plan: BatchPlan, chunk: int, slice: int | None = None) -> dict[str, Any]:
    """The job template: one baking step, or one for each slice, and a step that makes the page."""
    many = max(slice_count(job, slice) for job in plan.jobs) if slice else 1
    parts = [Part(number=number, of=many) for number in range(1, many + 1)]
    names = [f"Bake {part.number} of {many}" if many > 1 else "Bake" for part in parts]
    steps: list[dict[str, Any]] = []
    for part, name, before in zip(parts, names, [None, *names]):
        arguments = ["--slice", str(slice), "--part", str(part)] if slice else []
        adapting = (
            slice is None and plan.timeout is None
        )  # the time limit covers this number of jobs
        steps.append({"name": name, **_after(before), **_bake(plan, chunk, arguments, adapting)})
    report = _action(["--report-only"], timeout=REPORT_TIMEOUT)
    steps.append({"name": "Report", **_after(names[-1]), "script": {"actions": {"onRun": report}}})
    return {
        "specificationVersion": SPECIFICATION,
        "extensions": ["TASK_CHUNKING"],
        "name": f"gf-usd {plan.title}"[:LONGEST_NAME],
        "parameterDefinitions": _parameters(plan),
        "steps": steps,
    }


def _after(step: str | None) -> dict[str, Any]:
    return {"dependencies": [{"dependsOn": step}]} if step else {}


def _bake(plan: BatchPlan, chunk: int, arguments: list[str], adapting: bool) -> dict[str, Any]:
    """A baking step without its name: chunks of jobs, each a call of ``batch`` with these
    arguments.

    adapting : the scheduler may choose another size of the chunks.
    """
    memory = max(memory_of(job.options) for job in plan.jobs)
    limit = None if plan.timeout is None else math.ceil(plan.timeout * (1 + plan.retries))
    bake = _action(
        ["--tasks", "{{Task.Param.Job}}", "--no-report", *arguments],
        # jobs of a chunk may run one after another; their own limits apply first
        timeout=None if limit is None else chunk * limit + 60,
    )
    job = {
        "name": "Job",
        "type": "CHUNK[INT]",
        "range": "{{Param.Jobs}}",
        "chunks": {
            "defaultTaskCount": "{{Param.JobsPerTask}}",
            "targetRuntimeSeconds": TARGET if adapting else 0,
            "rangeConstraint": "NONCONTIGUOUS",
        },
    }
    amounts = [
        {"name": "amount.worker.vcpu", "min": 1},
        {"name": "amount.worker.memory", "min": math.ceil(memory / 2**20)},
    ]
    return {
        "parameterSpace": {"taskParameterDefinitions": [job]},
        "hostRequirements": {"amounts": amounts},
        "script": {"actions": {"onRun": bake}},
    }


def _action(arguments: list[str], *, timeout: int | None) -> dict[str, Any]:
    args = [
        "-m", "gf_usd", "batch", "{{Param.JobsFile}}", "--output", "{{Param.OutDir}}",
        "--path-mapping", "{{Session.PathMappingRulesFile}}", "--openjd-lines", *arguments,
    ]  # fmt: skip
    action: dict[str, Any] = {
        "command": "{{Param.Python}}",
        "args": args,
        "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": NOTICE},
    }
    return action if timeout is None else {**action, "timeout": timeout}


def _parameters(plan: BatchPlan) -> list[dict[str, Any]]:
    return [
        {
            "name": "JobsFile", "type": "PATH", "objectType": "FILE", "dataFlow": "IN",
            "default": JOBS, "description": "The jobs of the batch.",
        },
        {
            "name": "OutDir", "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "OUT",
            "description": "Where results are written.",
        },
        {
            "name": "Jobs", "type": "STRING", "default": f"0-{len(plan.jobs) - 1}",
            "description": "Which jobs, by number: 0,3-5.",
        },
        {
            "name": "JobsPerTask", "type": "INT", "minValue": 1, "default": 1,
            "description": "Jobs that one process bakes.",
        },
        {
            "name": "Python", "type": "STRING", "default": "python3",
            "description": "A Python that has gf-usd.",
        },
    ]  # fmt: skip


def references(plan: BatchPlan, table: InputTable) -> dict[str, Any]:
    """Every file that the jobs read, for farms without a shared disk."""
    named = dict.fromkeys(path for job in plan.jobs for path in input_paths(job))
    files: dict[str, None] = {}
    for name, row in table.read(named).items():
        files.update(dict.fromkeys(_files(Path(name), row)))
    return {
        "assetReferences": {
            "inputs": {"filenames": sorted(files), "directories": []},
            "outputs": {"directories": [str(plan.out)]},
            "referencedPaths": [],
        }
    }


def _files(asset: Path, row: Mapping[str, Any]) -> list[str]:
    if "files" not in row:
        return [str(asset)]
    return [str((asset.parent / name).resolve()) for name, _ in row["files"]]

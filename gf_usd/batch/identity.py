"""When two bakes would be the same: the same inputs, options, program and schema."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gf_usd.batch.job import Job
from gf_usd.batch.options import decisive, material_files
from gf_usd.program import program


def read_by(job: Job) -> tuple[Path, ...]:
    """The files that a job names itself: the asset, and files with a material."""
    return (job.asset, *material_files(job.options))


def describe(job: Job, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """All that decides what a job writes, as plain values.

    inputs : for each path of `read_by`, ``{"files": [[relative path, sha256], ...], "missing":
    [...]}`` of `gf_usd.assets.inputs`.  Files count by their content and by where they lie relative
    to the asset; the asset by where it lies relative to the result, which refers to it.
    """
    return {
        **program(),
        "inputs": [inputs[str(path)] for path in read_by(job)],
        "options": decisive(_portable(job)),
        "asset": job.asset.name,
        "from_result": Path(os.path.relpath(job.asset, job.root.parent)).as_posix(),
        "name": job.root.name,
    }


def _portable(job: Job) -> dict[str, Any]:
    """Options in which material files are named without their folder; their content counts."""
    parts = [Path(m).name if "/" in m or "\\" in m else m for m in job.materials]
    return {**job.options, "material": ",".join(parts)}


def identity(description: Mapping[str, Any]) -> str:
    """sha256 of a description."""
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()

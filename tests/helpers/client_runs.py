"""Clients: where they are, and running one in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_assets import time_codes

PROBES = Path(__file__).parents[1] / "clients" / "probes"
ROOT = Path(__file__).resolve().parents[2]
# where tools/clients.py installed to
INTO = Path(os.environ.get("GF_USD_CLIENTS") or ROOT / ".clients").resolve()


def programs(name: str) -> Path:
    """The folder of programs of a client's environment."""
    return INTO / name / "bin"


def needs(name: str) -> pytest.MarkDecorator:
    """Skip, and say so, where a client is not installed."""
    return pytest.mark.skipif(
        # written once all of it is there
        not (INTO / name / "requirements.txt").is_file(),
        reason=f"{name} is not in {INTO}: python tools/clients.py install --only {name}",
    )


def run(command: list[object], *, status: tuple[int, ...] = (0,), **variables: str) -> str:
    """stdout of a command that is expected to end in one of these statuses."""
    # without what would lend the client our packages or our schema library
    own = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PXR_"))}
    done = subprocess.run(
        [str(word) for word in command],
        check=False, capture_output=True, text=True, timeout=300, env={**own, **variables},
    )  # fmt: skip
    assert done.returncode in status, f"{done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def in_blender(stage: Path, folder: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """What Blender makes of a stage: arrays by `KIND:PRIM`, and its report."""
    times = time_codes(stage)
    target = folder / f"{stage.stem}.npz"
    python = programs("blender") / "python"
    run([python, PROBES / "blender_import.py", stage, target, times[0], times[-1]])
    with np.load(target) as arrays:
        return dict(arrays), json.loads(target.with_suffix(".json").read_text())


def findings(stage: Path, folder: Path) -> set[tuple[str, str, str]]:
    """(severity, rule, message) of all that NVIDIA's usd-validation says, over every variant.

    Warnings are left out.
    """
    report = folder / f"{stage.stem}.json"
    # it exits 1 on a warning too: only the JSON differs
    run(
        [programs("validation") / "nvidia_usd_validate", stage, "--json-output", report],
        status=(0, 1),
    )
    return {
        (issue["severity"], row["rule"]["name"], issue["message"])
        for row in json.loads(report.read_text())["rules"]
        for issue in row.get("issues", [])
        if issue["severity"] not in {"WARNING", "INFO"}
    }

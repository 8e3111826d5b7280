"""What is left of a bake whose simulation could not go on, and the words that say so."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gf_usd.core.errors import BakeError, SolverError
from gf_usd.core.frames import sampled
from gf_usd.pipeline.result import VariantResult, report_json
from gf_usd.prepare.outputs import report_of_failure
from gf_usd.prepare.plan import Plan
from gf_usd.system.atomic_files import publish_text

if TYPE_CHECKING:
    from gf_usd.layers.variants import BakedVariant


def place(plan: Plan, look: str, error: SolverError) -> dict[str, Any]:
    """Where and why the simulation failed, as the report's key `failed` has it.

    particle, prim and rest_position (stage units) are None where the fault has no place.
    """
    found: dict[str, Any] = {"particle": None, "prim": None, "rest_position": None}
    if error.particle >= 0:
        unit = plan.asset.facts.units.length
        surface = int(plan.particles.surface[error.particle])
        riding = {path for path, _ in plan.riders}  # particles count the surfaces that are filled
        filled = [s.path for s in plan.asset.surfaces if s.path not in riding]
        found = {
            "particle": error.particle,
            "prim": filled[surface],
            "rest_position": [float(x) / unit for x in plan.particles.X[error.particle]],
        }
    return {
        "look": look,
        "frame": math.ceil(error.frame / plan.settings.samples_per_frame),
        "time_code": sampled(plan.settings).time_code(error.frame),
        **found,
        "why": error.message.removeprefix(f"frame {error.frame}: "),
        "hint": error.hint,
    }


def leave(
    plan: Plan,
    results: Sequence[VariantResult],
    looks: Sequence[BakedVariant],
    error: SolverError,
    *,
    notes: Sequence[str],
    seconds: float,
) -> SolverError:
    """Write the partial root layer and the report of a bake that failed; returns what to raise.

    results, looks : the bakes so far, the last of which failed; their caches have partial names.
    No file under a final name is touched but a report of an earlier failure.
    """
    from gf_usd.layers.check.run import review
    from gf_usd.layers.root import write_root

    failed = place(plan, results[-1].look, error)
    files = [bake.cache for bake in results]
    clips = [clip for bake in results for clip in bake.clips]
    findings: list[dict[str, str]] = []
    opened = ""
    try:
        _require_source(plan)
        root = write_root(
            plan.outputs.layers, plan.asset, looks, source=plan.source, choices=plan.choices,
            partial=True,
        )  # fmt: skip
        notes = [*notes, *root.notes]
        files = [root.path, *files]
        findings = review(root.path, plan.source)
        opened = f" (open {root.path.name})"
    except BakeError as second:
        notes = [*notes, second.message]
    report = report_json(plan, results, notes=notes, seconds=seconds, findings=findings)
    path = report_of_failure(plan.outputs)
    text = json.dumps(
        {**report, "outputs": [str(file) for file in (*files, *clips, path)], "failed": failed},
        indent=1,
    )
    if path == plan.outputs.report:
        publish_text(path, text + "\n")
    else:
        path.write_text(text + "\n", encoding="utf-8")
    return SolverError(
        f"{_where(plan, failed)}: {failed['why']}\n"
        f"the frames before it are kept in {', '.join(str(file) for file in files)}{opened};"
        f" the report is {path}",
        error.hint,
        frame=failed["frame"],
        particle=error.particle,
    )


def _require_source(plan: Plan) -> None:
    if plan.outputs.source is None and plan.converted is not None:
        raise BakeError(
            "no root layer was written: the layer of a mesh file is not kept for one file",
            "bake without --flatten",
        )


def _where(plan: Plan, failed: dict[str, Any]) -> str:
    said = (
        f"{plan.asset.facts.path}: {failed['look']} failed at frame {failed['frame']}"
        f" (time code {failed['time_code']:g})"
    )
    if failed["particle"] is None:
        return said
    x, y, z = failed["rest_position"]
    return (
        f"{said}, at particle {failed['particle']} of <{failed['prim']}>,"
        f" which rests at ({x:.4g}, {y:.4g}, {z:.4g})"
    )

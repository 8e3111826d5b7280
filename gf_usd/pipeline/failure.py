"""The files and the message of a bake whose simulation failed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.core.asset import Asset
from gf_usd.core.errors import BakeError, SolverError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings, sampled
from gf_usd.core.units import code_text
from gf_usd.pipeline.deliver import Delivery
from gf_usd.prepare.outputs.outputs import report_of_failure
from gf_usd.system.atomic_files import dropped_on_failure, publish_text

if TYPE_CHECKING:
    from gf_usd.layers.variants import BakedVariant

# (notes, findings of the check) -> the report
Report = Callable[[Sequence[str], Sequence[dict[str, str]]], dict[str, Any]]


def locate_failure(
    error: SolverError,
    variant: str,
    *,
    asset: Asset,
    embedded: Sequence[tuple[str, str]],
    particles: Particles,
    settings: Settings,
) -> dict[str, Any]:
    """Where and why the simulation failed: the value of the report's key `failed`.

    embedded : (prim path, reason) of surfaces that are not filled.
    particle, prim and rest_position (stage units) are None where the error has no position.
    """
    found: dict[str, Any] = {"particle": None, "prim": None, "rest_position": None}
    if error.particle >= 0:
        unit = asset.facts.units.length
        surface = int(particles.surface[error.particle])
        embedded_paths = {
            path for path, _ in embedded
        }  # particles count the surfaces that are filled
        filled = [s.path for s in asset.surfaces if s.path not in embedded_paths]
        found = {
            "particle": error.particle,
            "prim": filled[surface],
            "rest_position": [float(x) / unit for x in particles.X[error.particle]],
        }
    return {
        "variant": variant,
        "look": variant,  # its name before; until 1.0
        "frame": math.ceil(error.frame / settings.samples_per_frame),
        "time_code": sampled(settings).time_code(error.frame),
        **found,
        "why": error.message.removeprefix(f"frame {error.frame}: "),
        "hint": error.hint,
    }


def write_failure(
    delivery: Delivery,
    failed: dict[str, Any],
    error: SolverError,
    *,
    variants: Sequence[BakedVariant],
    clips: Sequence[Path],
    notes: Sequence[str],
    report: Report,
) -> SolverError:
    """Write the partial root layer and the report of a failed bake; returns the error to raise.

    failed : of `locate_failure`.
    variants : those with frames, the last of which may be the one that failed; their caches have
        partial names. Nothing is written where there are none.
    clips : files next to the caches.

    Final files are left unchanged, except for the report of an earlier failure.
    """
    from gf_usd.layers.check.run import review

    where = _where(delivery.asset.facts.path, failed)
    if not variants:
        return SolverError(
            f"{where}: {failed['why']}\nno frame was simulated before", error.hint,
            frame=failed["frame"], particle=error.particle,
        )  # fmt: skip
    files = [variant.cache for variant in variants]
    findings: list[dict[str, str]] = []
    opened = ""
    try:
        _require_source(delivery)
        root = delivery.write_root(variants, partial=True)
        notes = [*notes, *root.notes]
        files = [root.path, *files]
        findings = review(root.path, delivery.source)
        opened = f" (open {root.path.name})"
    except BakeError as second:
        notes = [*notes, second.message]
    path = report_of_failure(delivery.files)
    outputs = [str(file) for file in (*files, *clips, path)]
    text = json.dumps({**report(notes, findings), "outputs": outputs, "failed": failed}, indent=1)
    report_text = f"the report is {path}"
    try:
        _write_report(path, text + "\n", delivery.files.report)
    except BakeError as third:  # why the simulation ended counts for more
        report_text = f"there is no report: {third.message}"
    return SolverError(
        f"{where}: {failed['why']}\n"
        f"the frames before it are kept in {', '.join(str(file) for file in files)}{opened};"
        f" {report_text}",
        error.hint,
        frame=failed["frame"],
        particle=error.particle,
    )


def _write_report(path: Path, text: str, final: Path) -> None:
    """Write it under the report's final name, or under its partial name, where it then stays."""
    if path == final:
        publish_text(path, text)
        return
    with dropped_on_failure(final):
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise BakeError(
                f"{path} could not be written: {error.strerror}",
                f"check that {path.absolute().parent} is writable and has space left",
            ) from error


def _require_source(delivery: Delivery) -> None:
    if delivery.files.source is None and delivery.converted is not None:
        raise BakeError(
            "no root layer was written, because --flatten does not keep the layer of a mesh file",
            "bake without --flatten",
        )


def _where(path: Path, failed: dict[str, Any]) -> str:
    summary = (
        f"{path}: {failed['look']} failed at frame {failed['frame']}"
        f" (time code {code_text(failed['time_code'])})"
    )
    if failed["particle"] is None:
        return summary
    x, y, z = failed["rest_position"]
    return (
        f"{summary}, at particle {failed['particle']} of <{failed['prim']}>, with the rest "
        f"position ({x:.4g}, {y:.4g}, {z:.4g})"
    )

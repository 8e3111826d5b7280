"""The record of a bake: its report next to the root layer, or the root layer alone."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gf_usd.core.scene import Recording


@dataclass(frozen=True, kw_only=True)
class Warned:
    """One warning of a bake."""

    message: str
    hint: str = ""
    about: str = (
        ""  # the rule of pipeline.health.warnings that it came from; "" where that is not said
    )


@dataclass(frozen=True, kw_only=True)
class Record:
    """The numbers of one variant; whatever is missing is empty, and `missing` says so."""

    command: str = ""
    version: str = ""
    source: str = ""
    health: Mapping[str, Any] = field(default_factory=dict)
    certificate: Mapping[str, Any] = field(default_factory=dict)  # intervals of figures
    frames: tuple[Mapping[str, Any], ...] = ()  # health of every frame
    settings: Mapping[str, Any] = field(default_factory=dict)
    materials: tuple[Mapping[str, Any], ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)  # particles, spacing_m, seconds, ...
    notes: tuple[str, ...] = ()
    warnings: tuple[Warned, ...] = ()
    failure: str = ""  # why the bake ended early; "" where it did not
    findings: tuple[Mapping[str, Any], ...] = ()
    missing: tuple[str, ...] = ()  # what is not known, and why, in words


def report_path(root: Path) -> Path:
    """``duck.rubber.usda`` -> ``duck.rubber.report.json``, next to it."""
    return root.with_name(f"{root.stem}.report.json")


def load_report(root: Path) -> tuple[dict[str, Any], str]:
    """The report next to a root layer, or an empty one, and why it is empty."""
    path = report_path(root)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}, f"there is no {path.name} next to the file"
    except (OSError, ValueError) as error:
        return {}, f"{path.name} cannot be read ({error})"
    if not isinstance(data, dict) or not isinstance(data.get("bakes"), list):
        return {}, f"{path.name} is not the report of a bake"
    return data, ""


def variant_of(entry: Mapping[str, Any]) -> str:
    """The variant of a bake or a warning of a report; those of former versions call it `look`."""
    return str(entry.get("variant", entry.get("look", "")))


def make_record(recording: Recording, report: Mapping[str, Any], why_empty: str) -> Record:
    """The numbers of a variant: of the report if it is of this bake, else of the root layer."""
    mine = (b for b in report.get("bakes", ()) if variant_of(b) == recording.variant)
    bake = next(mine, None)
    about = recording.about
    if bake is not None and about.get("inputHash") not in (None, report.get("input_sha256")):
        bake, why_empty = None, "the report next to the file belongs to another bake"
    if bake is None:
        return _from_layer(recording, why_empty or "the report does not contain this variant")
    known = (
        "particles", "spacing_m", "volume_m3", "radius_m", "drop_m", "pins", "seconds",
    )  # fmt: skip
    missing = (
        () if bake.get("per_frame") else ("the report contains no health of individual frames",)
    )
    return Record(
        command=str(report.get("command", "")),
        version=str(report.get("version", "")),
        source=str(report.get("source", "")),
        health=_table(bake.get("health")),
        certificate=_table(bake.get("certificate")),
        frames=tuple(bake.get("per_frame") or ()),
        settings=_table(report.get("settings")),
        materials=(_table(bake.get("material")),),
        facts={key: report[key] for key in known if key in report},
        notes=tuple(str(note) for note in report.get("notes", ())),
        warnings=tuple(
            Warned(message=w.get("message", ""), hint=w.get("hint", ""), about=w.get("about", ""))
            for w in map(_table, report.get("warnings", ()))
            if variant_of(w) == recording.variant
        ),
        failure=str(_in_layer(recording).get("failure", "")),
        findings=tuple(_table(f) for f in report.get("check", ())),
        missing=missing,
    )


def _from_layer(recording: Recording, why: str) -> Record:
    about = recording.about
    told = _in_layer(recording)
    if not told:
        return Record(
            missing=(
                f"{recording.path.name} does not record how it was baked: settings, materials "
                f"and health are unknown, and the curves show only the geometry",
            )
        )
    materials = _table(told.get("materials"))
    return Record(
        command=str(about.get("command", "")),
        version=str(about.get("version", "")),
        health=_table(told.get("health")),
        settings=_table(told.get("settings")),
        materials=tuple(_table(materials[key]) for key in sorted(materials)),
        warnings=tuple(Warned(message=str(words)) for words in told.get("warnings", ())),
        failure=str(told.get("failure", "")),
        missing=(
            f"{why}: the energies, stretches and contact depths of individual frames, the notes "
            f"and the findings are unknown; the curves show only the geometry, and the summary "
            f"comes from the root layer",
        ),
    )


def _in_layer(recording: Recording) -> dict[str, Any]:
    """What the root layer says of the variant."""
    return _table(_table(recording.about.get("looks")).get(recording.variant))


def finite(value: Any) -> float | None:
    """The number, or None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _table(value: Any) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else {}

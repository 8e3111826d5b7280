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
class BakeWarning:
    """One warning of a bake."""

    message: str
    hint: str = ""
    about: str = ""  # its rule in `pipeline.health.warnings`; "" where the record has none


@dataclass(frozen=True, kw_only=True)
class Record:
    """The recorded numbers of one variant; fields without data are empty."""

    command: str = ""
    version: str = ""
    source: str = ""
    health: Mapping[str, Any] = field(default_factory=dict)
    certificate: Mapping[str, Any] = field(default_factory=dict)  # intervals of measured quantities
    frames: tuple[Mapping[str, Any], ...] = ()  # health of every frame
    settings: Mapping[str, Any] = field(default_factory=dict)
    materials: tuple[Mapping[str, Any], ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)  # particles, spacing_m, seconds, ...
    notes: tuple[str, ...] = ()
    warnings: tuple[BakeWarning, ...] = ()
    failure: str = ""  # why the bake ended early; "": it is complete
    findings: tuple[Mapping[str, Any], ...] = ()
    missing: tuple[str, ...] = ()  # which data is unknown and why, as text


def report_path(root: Path) -> Path:
    """The report next to a root layer: ``duck.rubber.usda`` -> ``duck.rubber.report.json``."""
    return root.with_name(f"{root.stem}.report.json")


def load_report(root: Path) -> tuple[dict[str, Any], str]:
    """The report next to a root layer and ""; or an empty report and the reason."""
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
    """The variant of an entry of a report; old versions write it as `look`."""
    return str(entry.get("variant", entry.get("look", "")))


def make_record(recording: Recording, report: Mapping[str, Any], why_empty: str) -> Record:
    """The record of a variant: from its report, or from the root layer where there is none."""
    entries = (b for b in report.get("bakes", ()) if variant_of(b) == recording.variant)
    bake = next(entries, None)
    about = recording.about
    if bake is not None and about.get("inputHash") not in (None, report.get("input_sha256")):
        bake, why_empty = None, "the report next to the file belongs to another bake"
    if bake is None:
        return _read_from_layer(recording, why_empty or "the report does not contain this variant")
    fact_keys = (
        "particles", "spacing_m", "volume_m3", "radius_m", "drop_m", "pins", "seconds",
    )  # fmt: skip
    missing = (
        () if bake.get("per_frame") else ("the report contains no health of individual frames",)
    )
    return Record(
        command=str(report.get("command", "")),
        version=str(report.get("version", "")),
        source=str(report.get("source", "")),
        health=_as_dict(bake.get("health")),
        certificate=_as_dict(bake.get("certificate")),
        frames=tuple(bake.get("per_frame") or ()),
        settings=_as_dict(report.get("settings")),
        materials=(_as_dict(bake.get("material")),),
        facts={key: report[key] for key in fact_keys if key in report},
        notes=tuple(str(note) for note in report.get("notes", ())),
        warnings=tuple(
            BakeWarning(
                message=w.get("message", ""), hint=w.get("hint", ""), about=w.get("about", "")
            )
            for w in map(_as_dict, report.get("warnings", ()))
            if variant_of(w) == recording.variant
        ),
        failure=str(_variant_in_layer(recording).get("failure", "")),
        findings=tuple(_as_dict(f) for f in report.get("check", ())),
        missing=missing,
    )


def _read_from_layer(recording: Recording, why: str) -> Record:
    about = recording.about
    recorded = _variant_in_layer(recording)
    if not recorded:
        return Record(
            missing=(
                f"{recording.path.name} does not record how it was baked: settings, materials "
                f"and health are unknown, and the curves show only the geometry",
            )
        )
    materials = _as_dict(recorded.get("materials"))
    return Record(
        command=str(about.get("command", "")),
        version=str(about.get("version", "")),
        health=_as_dict(recorded.get("health")),
        settings=_as_dict(recorded.get("settings")),
        materials=tuple(_as_dict(materials[key]) for key in sorted(materials)),
        warnings=tuple(
            BakeWarning(message=str(message)) for message in recorded.get("warnings", ())
        ),
        failure=str(recorded.get("failure", "")),
        missing=(
            f"{why}: the energies, stretches and contact depths of individual frames, the notes "
            f"and the findings are unknown; the curves show only the geometry, and the summary "
            f"comes from the root layer",
        ),
    )


def _variant_in_layer(recording: Recording) -> dict[str, Any]:
    """The metadata of the variant in the root layer."""
    return _as_dict(_as_dict(recording.about.get("looks")).get(recording.variant))


def finite(value: Any) -> float | None:
    """The value as a float; None where it is not a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _as_dict(value: Any) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else {}

"""The result of a bake: its files, its health and its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gf_usd.core.errors import UnhealthyError
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.pipeline.health.warnings import ERROR, HealthWarning, warnings_json
from gf_usd.pipeline.measures.certify import Certificate
from gf_usd.prepare.plan import settings_json


def require_healthy(result: BakeResult, *, strict: bool) -> None:
    """Raise UnhealthyError where a finished bake has errors; its files are kept.

    strict : treat warnings as errors.
    """
    warnings = [
        (name, warning) for name, warning in result.warnings if strict or warning.level == ERROR
    ]
    if not warnings:
        return
    hints = list(dict.fromkeys(warning.hint for _, warning in warnings))
    apart = len(hints) > 1
    lines = "".join(
        f"\n  {name}: {warning.message} [{warning.about}]"
        + (f"\n    hint: {warning.hint}" if apart else "")
        for name, warning in warnings
    )
    errors = any(warning.level == ERROR for _, warning in warnings)
    kind = "error" if errors else "warning"
    article = "an" if errors else "a"
    count = f"{article} {kind}" if len(warnings) == 1 else f"{len(warnings)} {kind}s"
    raise UnhealthyError(
        f"{result.root}: the bake is complete and its files are written, but it has {count}:"
        f"{lines}",
        (f"see that of each {kind}" if apart else hints[0])
        + ("" if errors else "; without --strict this is not an error"),
        warnings=tuple(warning for _, warning in warnings),
        result=result,
    )


def report_json(
    description: Mapping[str, Any],
    settings: Settings,
    bakes: Sequence[VariantResult],
    seconds: float,
    notes: Sequence[str],
    findings: Sequence[dict[str, str]],
) -> dict[str, Any]:
    """The report; its keys are documented in docs/guide/report.md.

    description : of `describe`.
    """
    warnings = [(bake.variant, warning) for bake in bakes for warning in bake.warnings]
    return {
        **description,
        "outputs": [*description["outputs"], *(str(c) for bake in bakes for c in bake.clips)],
        "notes": list(notes),
        "seconds": seconds,
        "settings": settings_json(settings),
        "bakes": [bake.as_json(frames=True) for bake in bakes],
        "warnings": warnings_json(warnings),
        "check": list(findings),
    }


@dataclass(frozen=True, kw_only=True)
class VariantResult:
    """One material's bake."""

    variant: str  # its name
    cache: Path  # the layer that the frames are in
    material: Material  # that of most of the volume
    frames: int  # that were written
    health: dict[str, Any] = field(repr=False)  # totals; docs/guide/report.md has the keys
    # one dict per frame, with the fields of `Health` by name
    per_frame: list[dict[str, Any]] = field(repr=False, default_factory=list)
    warnings: tuple[HealthWarning, ...] = ()  # each with about, message and hint
    clips: tuple[Path, ...] = ()  # files next to the cache
    at_rest: int | None = None  # frame, from 1, at which all rested; None: not tested
    certificate: Certificate | None = None  # how certain its figures are; None: not requested
    storage: dict[str, Any] | None = None  # saved disk space; docs/guide/report.md has the keys

    @property
    def look(self) -> str:
        """The former name of `variant`; it works until 1.0."""
        return self.variant

    def as_json(self, *, frames: bool = False) -> dict[str, Any]:
        """The result as plain values, on request with the health of every frame."""
        out = {
            "variant": self.variant,
            "look": self.variant,  # its name before; until 1.0
            "cache": str(self.cache),
            "material": self.material.values,
            "frames": self.frames,
            "at_rest": self.at_rest,
            "health": self.health,
        }
        if self.certificate is not None:
            out["certificate"] = self.certificate.as_json()
        if self.storage is not None:
            out["storage"] = self.storage
        return {**out, "per_frame": self.per_frame} if frames else out


@dataclass(frozen=True, kw_only=True)
class BakeResult:
    """A finished bake."""

    root: Path  # the layer to open
    report: Path  # its JSON report
    bakes: tuple[VariantResult, ...]  # one per material
    particles: int  # number of particles
    seconds: float  # [s] the bake took
    settings: Settings  # of the first material
    notes: tuple[str, ...] = ()  # assumptions, as text
    # of `check`, less those of the source, as dicts with the fields of `Finding`
    findings: tuple[dict[str, str], ...] = ()
    outputs: tuple[Path, ...] = ()  # all files, including shared ones of a mesh file

    @property
    def cache(self) -> Path:
        """The cache of the first material."""
        return self.bakes[0].cache

    @property
    def health(self) -> dict[str, Any]:
        """The health summary of the first material."""
        return self.bakes[0].health

    @property
    def frames(self) -> int:
        """The number of frames that were written."""
        return self.bakes[0].frames

    @property
    def warnings(self) -> tuple[tuple[str, HealthWarning], ...]:
        """(variant, warning) of every bake."""
        return tuple((bake.variant, warning) for bake in self.bakes for warning in bake.warnings)

    def as_json(self) -> dict[str, Any]:
        """Plain values, as ``bake --json`` prints them."""
        return {
            "root": str(self.root),
            "report": str(self.report),
            "particles": self.particles,
            "frames": self.frames,
            "seconds": self.seconds,
            "settings": settings_json(self.settings),
            "bakes": [b.as_json() for b in self.bakes],
            "warnings": warnings_json(self.warnings),
            "outputs": [str(path) for path in self.outputs],
            "notes": list(self.notes),
            "check": list(self.findings),
        }

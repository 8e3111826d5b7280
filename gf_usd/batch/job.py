"""A job, which is one bake of a batch, and its outcome."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from gf_usd.prepare.options.table import arguments

REPORT, RECORD = ".report.json", ".job.json"

# final states of a job; GOOD: it need not be repeated; NOT_FAILED: it did not fail
GOOD = ("done", "kept")
NOT_FAILED = (*GOOD, "sliced")
STATES = {
    "done": "baked without errors",
    "kept": "already done before",
    "sliced": "a slice is done, and frames remain",
    "busy": "another run is baking it",
    "stopped": "interrupted before it ended",
    "failed": "the bake failed",
    "refused": "the asset or the options were refused",
    "crashed": "the process died",
    "timeout": "exceeded its time limit",
    "unsound": "baked, but the check or --strict found a problem",
}


@dataclass(frozen=True, kw_only=True)
class Job:
    """One bake: an asset, options, and where the result goes."""

    name: str  # of the result under the batch's folder, without .usda; may hold slashes
    asset: Path  # absolute
    root: Path  # absolute; the root layer
    options: Mapping[str, Any] = field(default_factory=dict)  # those of `gf_usd.bake`

    @property
    def record(self) -> Path:
        """The file next to the root layer with the outcome of the job."""
        return self.sibling(RECORD)

    @property
    def report(self) -> Path:
        """The report of the bake."""
        return self.sibling(REPORT)

    def sibling(self, ending: str) -> Path:
        """``duck.rubber.usda`` -> ``duck.rubber.ENDING``."""
        return self.root.with_name(self.root.name.removesuffix(self.root.suffix) + ending)

    @property
    def materials(self) -> tuple[str, ...]:
        """The materials of its variants."""
        return tuple(
            part.strip() for part in str(self.options.get("material", "rubber")).split(",")
        )

    @property
    def variant_names(self) -> tuple[str, ...]:
        """The names of its variants."""
        return tuple(Path(material).stem for material in self.materials)

    def arguments(self) -> list[str]:
        """The arguments of ``gf-usd`` that bake it."""
        return ["bake", str(self.asset), "--output", str(self.root), *arguments(self.options)]

    @property
    def command(self) -> str:
        """The command line of the job, quoted for a shell."""
        return shlex.join(["gf-usd", *self.arguments()])

    def as_json(self) -> dict[str, Any]:
        """Plain values; `of` reads them back."""
        return {
            "name": self.name,
            "asset": str(self.asset),
            "root": str(self.root),
            "options": dict(self.options),
        }

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Job:
        """The job of `as_json`."""
        return cls(
            name=row["name"], asset=Path(row["asset"]), root=Path(row["root"]),
            options=dict(row["options"]),
        )  # fmt: skip


LISTS = ("warnings", "findings", "notes", "bake_notes")  # fields of `Outcome`


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a job."""

    job: str
    state: str  # one of STATES
    message: str = ""  # why it is not good
    hint: str = ""
    status: int | None = None  # exit status of the last attempt; negative: the signal
    attempts: int = 0  # 0 where nothing was run
    seconds: float = 0.0  # wall time of all attempts, and of earlier slices
    cpu_seconds: float = 0.0
    peak_memory: int = 0  # [bytes] of the last attempt
    frames: int = 0
    particles: int = 0
    frames_per_second: float = 0.0  # between the first and the last frame
    root: str = ""
    host: str = ""
    health: Mapping[str, Any] = field(default_factory=dict)  # of the first variant, a few numbers
    warnings: tuple[Mapping[str, Any], ...] = ()
    findings: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()  # of the batch
    bake_notes: tuple[str, ...] = ()  # of the bake: what it assumed
    command: str = ""
    log: str = ""  # the last lines of the output of an unsuccessful process

    @property
    def good(self) -> bool:
        """Whether the job need not be repeated."""
        return self.state in GOOD

    def as_json(self) -> dict[str, Any]:
        """Plain values; `of` reads them back."""
        return asdict(self)

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Outcome:
        """The outcome of `as_json`; keys of other versions are ignored."""
        known = {key: row[key] for key in cls.__dataclass_fields__ if key in row}
        lists = {key: tuple(known[key]) for key in LISTS if key in known}
        return cls(**{**known, **lists})

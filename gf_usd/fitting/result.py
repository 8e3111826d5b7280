"""The result of a fit: values with their intervals, and how well the targets are reproduced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.materials.material import Material
from gf_usd.fitting.figures import FIGURES, Number
from gf_usd.fitting.observation import Observation
from gf_usd.fitting.search import Minimum
from gf_usd.fitting.targets import Motion, Target
from gf_usd.fitting.uncertainty import LEVEL, Uncertainty
from gf_usd.fitting.unknowns import Unknown

AT_BOUND = 1e-3  # of the range: distance at which a value counts as being at its bound


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A fitted value, in SI."""

    name: str  # of a field of Material, or of a parameter of its law
    unit: str  # "" where it has none
    value: float  # the best estimate [unit]
    low: float  # of the 95 % interval
    high: float  # of the 95 % interval
    identifiable: bool  # False: the targets add little to the bounds
    start: float  # its value in the initial material
    bounds: tuple[float, float]  # of the search


@dataclass(frozen=True, kw_only=True)
class Reproduced:
    """A target and its value with the fitted material, in SI."""

    name: str  # of the figure, or of the file with the motion
    unit: str  # "" where it has none
    target: float  # a number; of points 0
    sigma: float  # its standard deviation
    stated: bool  # whether the standard deviation was stated
    start: float  # with the initial material; of points the rms distance
    fitted: float  # with the fitted material
    sensitivity: Mapping[str, float]  # change for +10 % of each value, for +0.01 of a ratio


@dataclass(frozen=True, kw_only=True)
class FitResult:
    """What `gf_usd.fit` found."""

    material: Material  # with the fitted values
    estimates: tuple[Estimate, ...]  # one per unknown
    targets: tuple[Reproduced, ...]  # one per target
    not_identifiable: tuple[str, ...]  # sentences; empty if the targets determine all values
    correlation: tuple[tuple[float, ...], ...]  # of the estimates, in their order
    noise: float  # scatter of the residuals over the standard deviations of the targets
    converged: bool  # False: the time limit was reached first
    simulations: int  # that were run
    read: int  # that were kept from before
    seconds: float  # [s] the fit took
    particles: int  # of each simulation
    frames: int  # of each simulation
    layer: Path | None  # the material, for `material` of a bake; None: not written
    picture: Path | None  # None: not written
    notes: tuple[str, ...]  # assumptions, as text

    def as_json(self) -> dict[str, Any]:
        """The result as JSON-compatible values."""
        fields = {
            name: value
            for name, value in vars(self).items()
            if name not in ("material", "estimates", "targets", "layer", "picture")
        }
        return {
            "material": self.material.values,
            "estimates": [asdict(entry) for entry in self.estimates],
            "targets": [asdict(entry) for entry in self.targets],
            **{k: list(v) if isinstance(v, tuple) else v for k, v in fields.items()},
            "layer": None if self.layer is None else str(self.layer),
            "picture": None if self.picture is None else str(self.picture),
        }


def estimates(
    rows: Sequence[Unknown], minimum: Minimum, intervals: Uncertainty
) -> tuple[Estimate, ...]:
    """The estimates at the minimum; intervals are clipped to the bounds."""
    low, high = np.clip([minimum.z - intervals.half, minimum.z + intervals.half], 0.0, 1.0)
    return tuple(
        Estimate(
            name=row.name, unit=row.unit, value=row.value(float(minimum.z[k])),
            low=row.value(float(low[k])), high=row.value(float(high[k])),
            identifiable=intervals.identifiable[k], start=row.start, bounds=(row.low, row.high),
        )
        for k, row in enumerate(rows)
    )  # fmt: skip


def reproduced(
    targets: Sequence[Target],
    rows: Sequence[Unknown],
    jacobian: Floats,
    observation: Observation,
    start: Observation | None,
) -> tuple[Reproduced, ...]:
    """The targets and their values with the fitted material.

    start : the observation of the initial material; None where its simulation failed.
    """
    results, row, first = [], 0, 0
    steps = np.array([entry.change_of_z for entry in rows])
    for target in targets:
        before = row
        row += len(target.residual(observation, first))
        rows_change = jacobian[before:row] * steps
        if isinstance(target, Number):
            change = rows_change[0] * target.sigma
            unit, value = FIGURES[target.figure].unit, target.value
            fitted = target.simulated(observation, first)
            initial = float("nan") if start is None else target.simulated(start, first)
        else:
            assert isinstance(target, Motion)
            # rms over points of the distance, which has three coordinates
            change = np.sqrt(3.0 * np.mean((rows_change * target.sigma) ** 2, axis=0))
            unit, value = "m", 0.0
            fitted = _rms(target.distance(observation, first))
            initial = float("nan") if start is None else _rms(target.distance(start, first))
        results.append(
            Reproduced(
                name=target.name, unit=unit, target=value, sigma=target.sigma,
                stated=target.stated, start=initial, fitted=fitted,
                sensitivity={entry.name: float(m) for entry, m in zip(rows, change)},
            )
        )  # fmt: skip
        first += sum(len(entry.vertices) for entry in target.tracked)
    return tuple(results)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def not_identifiable(rows: Sequence[Unknown], intervals: Uncertainty) -> tuple[str, ...]:
    """Sentences on unknowns that the targets do not determine."""
    sentences: list[str] = []
    groups: dict[tuple[int, ...], list[Floats]] = {}
    for members, direction in intervals.undetermined:
        groups.setdefault(members, []).append(direction)
    for members, directions in groups.items():
        names = [rows[k].name for k in members]
        fields = len(members) - len(directions)
        if fields <= 0:
            sentences += [f"{name} is not identifiable from these targets" for name in names]
            continue
        joint = (
            f"{', '.join(names[:-1])} and {names[-1]} are not separately identifiable from these"
            " targets"
        )
        if len(directions) == 1:
            sentences.append(f"{joint}: {_describe_direction(rows, directions[0], members)}")
        else:
            sentences.append(f"{joint}: they determine only {fields} combination of them")
    listed_members = {k for members in groups for k in members}
    sentences += [
        f"{rows[k].name} is not identifiable from these targets"
        for k, entry in enumerate(intervals.identifiable)
        if not entry and k not in listed_members
    ]
    return tuple(dict.fromkeys(sentences))


def _describe_direction(rows: Sequence[Unknown], direction: Floats, members: Sequence[int]) -> str:
    """Text of the changes along an undetermined direction."""
    share = 0.1 / max(direction[list(members)], key=abs)
    parts = []
    for k in members:
        change, row = share * float(direction[k]), rows[k]
        if row.log:
            parts.append(f"{row.name} times {(row.high / row.low) ** change:.3g}")
        else:
            parts.append(f"{row.name} {(row.high - row.low) * change:+.3g}")
    return " with ".join(parts) + " changes almost nothing"


def at_bounds(rows: Sequence[Unknown], z: Floats) -> tuple[str, ...]:
    """Sentences on estimates that ended at a bound."""
    return tuple(
        f"{row.name} ended at its {'lower' if entry < 0.5 else 'upper'} bound,"
        f" {row.value(float(entry)):.4g} {row.unit}".rstrip()
        + f": --bounds {row.name}=LOW:HIGH changes it"
        for row, entry in zip(rows, z)
        if min(entry, 1.0 - entry) < AT_BOUND
    )


def fit_metadata(result: FitResult, command: str) -> dict[str, Any]:
    """Metadata of the fit for the material layer."""
    return {
        "fit": {
            "command": command,
            "level": LEVEL,
            "noise": result.noise,
            "converged": result.converged,
            "notIdentifiable": list(result.not_identifiable),
            "values": {
                entry.name: {
                    "value": entry.value, "low": entry.low, "high": entry.high,
                    "identifiable": entry.identifiable,
                }
                for entry in result.estimates
            },
            "targets": {
                f"target{k}": {
                    "name": entry.name, "unit": entry.unit, "target": entry.target,
                    "sigma": entry.sigma, "fitted": entry.fitted,
                    "sensitivity": dict(entry.sensitivity),
                }
                for k, entry in enumerate(result.targets)
            },
        }
    }  # fmt: skip

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

AT_BOUND = 1e-3  # of what lies between the bounds


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A fitted value, in SI."""

    name: str  # of a field of Material, or of a parameter of its law
    unit: str
    value: float
    low: float  # of the 95 % interval
    high: float
    identifiable: bool  # False: the targets add little to the bounds
    start: float
    bounds: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Reproduced:
    """A target and its value with the fitted material, in SI."""

    name: str
    unit: str
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
    estimates: tuple[Estimate, ...]
    targets: tuple[Reproduced, ...]
    not_identifiable: tuple[str, ...]  # sentences; empty if the targets determine all values
    correlation: tuple[tuple[float, ...], ...]  # of the estimates, in their order
    noise: float  # scatter of the residuals over the standard deviations of the targets
    converged: bool  # False: the time limit was reached first
    simulations: int  # that were run
    read: int  # that were kept from before
    seconds: float
    particles: int
    frames: int
    layer: Path | None  # the material, for --material
    picture: Path | None
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        told = {
            name: value
            for name, value in vars(self).items()
            if name not in ("material", "estimates", "targets", "layer", "picture")
        }
        return {
            "material": self.material.values,
            "estimates": [asdict(one) for one in self.estimates],
            "targets": [asdict(one) for one in self.targets],
            **{k: list(v) if isinstance(v, tuple) else v for k, v in told.items()},
            "layer": None if self.layer is None else str(self.layer),
            "picture": None if self.picture is None else str(self.picture),
        }


def estimates(
    rows: Sequence[Unknown], minimum: Minimum, found: Uncertainty
) -> tuple[Estimate, ...]:
    """The values at the minimum, with intervals that end at the bounds."""
    low, high = np.clip([minimum.z - found.half, minimum.z + found.half], 0.0, 1.0)
    return tuple(
        Estimate(
            name=row.name, unit=row.unit, value=row.value(float(minimum.z[k])),
            low=row.value(float(low[k])), high=row.value(float(high[k])),
            identifiable=found.identifiable[k], start=row.start, bounds=(row.low, row.high),
        )
        for k, row in enumerate(rows)
    )  # fmt: skip


def reproduced(
    targets: Sequence[Target],
    rows: Sequence[Unknown],
    jacobian: Floats,
    seen: Observation,
    start: Observation | None,
) -> tuple[Reproduced, ...]:
    """The targets and their values with the fitted material; start : None where it failed."""
    made, row, first = [], 0, 0
    steps = np.array([one.change_of_z for one in rows])
    for target in targets:
        before = row
        row += len(target.residual(seen, first))
        change = jacobian[before:row] * steps
        if isinstance(target, Number):
            moved = change[0] * target.sigma
            unit, value = FIGURES[target.figure].unit, target.value
            now = target.simulated(seen, first)
            then = float("nan") if start is None else target.simulated(start, first)
        else:
            assert isinstance(target, Motion)
            # three coordinates of a point make its distance
            moved = np.sqrt(3.0 * np.mean((change * target.sigma) ** 2, axis=0))
            unit, value = "m", 0.0
            now = _rms(target.distance(seen, first))
            then = float("nan") if start is None else _rms(target.distance(start, first))
        made.append(
            Reproduced(
                name=target.name, unit=unit, target=value, sigma=target.sigma,
                stated=target.stated, start=then, fitted=now,
                sensitivity={one.name: float(m) for one, m in zip(rows, moved)},
            )
        )  # fmt: skip
        first += sum(len(one.vertices) for one in target.followed)
    return tuple(made)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def not_identifiable(rows: Sequence[Unknown], found: Uncertainty) -> tuple[str, ...]:
    """What the targets do not tell, in sentences."""
    said: list[str] = []
    groups: dict[tuple[int, ...], list[Floats]] = {}
    for members, direction in found.undetermined:
        groups.setdefault(members, []).append(direction)
    for members, directions in groups.items():
        names = [rows[k].name for k in members]
        told = len(members) - len(directions)
        if told <= 0:
            said += [f"{name} is not identifiable from these targets" for name in names]
            continue
        listed = (
            f"{', '.join(names[:-1])} and {names[-1]} are not separately identifiable from these"
            " targets"
        )
        if len(directions) == 1:
            said.append(f"{listed}: {_balance(rows, directions[0], members)}")
        else:
            said.append(f"{listed}: they determine only {told} combination of them")
    named = {k for members in groups for k in members}
    said += [
        f"{rows[k].name} is not identifiable from these targets"
        for k, one in enumerate(found.identifiable)
        if not one and k not in named
    ]
    return tuple(dict.fromkeys(said))


def _balance(rows: Sequence[Unknown], direction: Floats, members: Sequence[int]) -> str:
    """The changes along a direction that is not determined, in words."""
    share = 0.1 / max(direction[list(members)], key=abs)
    words = []
    for k in members:
        change, row = share * float(direction[k]), rows[k]
        if row.log:
            words.append(f"{row.name} times {(row.high / row.low) ** change:.3g}")
        else:
            words.append(f"{row.name} {(row.high - row.low) * change:+.3g}")
    return " with ".join(words) + " changes almost nothing"


def at_bounds(rows: Sequence[Unknown], z: Floats) -> tuple[str, ...]:
    """Which values ended at a bound, in sentences."""
    return tuple(
        f"{row.name} ended at its {'lower' if one < 0.5 else 'upper'} bound,"
        f" {row.value(float(one)):.4g} {row.unit}".rstrip()
        + f": --bounds {row.name}=LOW:HIGH changes it"
        for row, one in zip(rows, z)
        if min(one, 1.0 - one) < AT_BOUND
    )


def about(result: FitResult, command: str) -> dict[str, Any]:
    """What the layer says of the fit, as metadata."""
    return {
        "fit": {
            "command": command,
            "level": LEVEL,
            "noise": result.noise,
            "converged": result.converged,
            "notIdentifiable": list(result.not_identifiable),
            "values": {
                one.name: {
                    "value": one.value, "low": one.low, "high": one.high,
                    "identifiable": one.identifiable,
                }
                for one in result.estimates
            },
            "targets": {
                f"target{k}": {
                    "name": one.name, "unit": one.unit, "target": one.target,
                    "sigma": one.sigma, "fitted": one.fitted, "sensitivity": dict(one.sensitivity),
                }
                for k, one in enumerate(result.targets)
            },
        }
    }  # fmt: skip

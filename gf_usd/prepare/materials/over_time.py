"""Material values over time, where the stage has time samples of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.asset import Asset
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import MIXED, Settings
from gf_usd.core.materials.keys import KEYED, ValueKeys
from gf_usd.core.materials.per_particle import spread
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.materials.assign import Assigned

if TYPE_CHECKING:
    from gf_usd.readers.usd_bake.keys import MaterialKeys

SAME = 1e-6  # relative: float32 holds no finer difference
# what a note calls each value, and its unit
TERMS = {
    "youngs_modulus": ("Young's modulus", " Pa; the step is that of the stiffest"),
    "poissons_ratio": ("Poisson's ratio", ""),
    "damping_time": ("the damping time", " s"),
    "friction": ("friction", ""),
}


def with_value_keys(
    assigned: Assigned,
    keys: MaterialKeys,
    asset: Asset,
    file: Path,
    spec: StageSpec,
    settings: Settings,
    again: Callable[[StageSpec], Assigned],
    *,
    repeats: bool,
) -> Assigned:
    """The particles with the values that change over time, and notes.

    These are values of materials and paint at each time code; all others are those at rest.

    keys : of `material_keys`; again : assigns the materials of another time code; repeats : of
        --loop.
    Raises InputError for values out of range, and UsageError for a solver that does not support
    them.
    """
    from gf_usd.readers.usd_bake.keys import FOLLOWED, spec_at

    notes = [
        f"{name} has time samples, and keeps the value of the rest pose: of material parameters"
        f" only {', '.join(FOLLOWED)} can change over time"
        for name in keys.others
    ]
    codes = _needed(keys.codes, settings)
    if not codes:
        return replace(assigned, notes=(*assigned.notes, *notes))
    rest = spread(assigned.particles, assigned.tables[0])
    found = [again(spec_at(asset, file, spec, code)) for code in codes]
    spreads = [spread(one.particles, one.tables[0]) for one in found]
    values = {name: np.stack([one[name] for one in spreads]) for name in KEYED}
    changing = [n for n in KEYED if not np.allclose(values[n], rest[n], rtol=SAME, atol=0.0)]
    notes += [
        f"{', '.join(names)} has time samples, with which {TERMS[what][0]} does not change"
        for what, names in keys.by.items()
        if what not in changing
    ]
    if not changing:
        return replace(assigned, notes=(*assigned.notes, *notes))
    every = [name for names in keys.by.values() for name in names]
    if settings.solver in ("ul", MIXED):
        raise UsageError(
            f"{asset.facts.path}: {every[0]} has time samples, which --solver ul and bakes with"
            " flowing bodies do not support",
            "use --solver tl, or author one value",
        )
    for name in KEYED:
        if name not in changing:  # to the bit
            values[name] = np.repeat(rest[name][None], len(codes), axis=0)
            continue
        word, unit = TERMS[name]
        low, high = float(values[name].min()), float(values[name].max())
        by = ", ".join(keys.by.get(name, every))
        notes.append(
            f"{word} changes with {len(codes)} time samples of {by}: from {low:.4g} to"
            f" {high:.4g}{unit}"
        )
    if repeats:
        notes.append("--loop does not repeat the time samples of materials: the first one holds")
    whole = np.concatenate([values[name] for name in KEYED])
    groups, of = np.unique(whole, axis=1, return_inverse=True)
    each = dict(zip(KEYED, np.split(groups, len(KEYED)), strict=True))
    made = ValueKeys(times=np.array(codes), values=each, of=of.reshape(-1))
    return replace(
        assigned,
        particles=replace(assigned.particles, keys=made),
        notes=(*assigned.notes, *notes),
    )


def _needed(codes: tuple[float, ...], settings: Settings) -> list[float]:
    """The time codes that bracket a bake."""
    if not codes:
        return []
    start, end = settings.time_code(0), settings.time_code(settings.frames - 1)
    first = max([k for k, code in enumerate(codes) if code <= start], default=0)
    last = min([k for k, code in enumerate(codes) if code >= end], default=len(codes) - 1)
    return list(codes[first : last + 1])

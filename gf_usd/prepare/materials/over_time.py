"""Young's modulus over time, where the stage has time samples of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.asset import Asset
from gf_usd.core.errors import UsageError
from gf_usd.core.frames import MIXED, Settings
from gf_usd.core.materials.keys import StiffnessKeys
from gf_usd.core.materials.per_particle import spread
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.materials.assign import Assigned

if TYPE_CHECKING:
    from gf_usd.readers.usd_bake.keys import MaterialKeys

SAME = 1e-6  # relative: float32 holds no finer difference


def with_stiffness_keys(
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
    """The particles with what their moduli are multiplied by over time, and notes on that.

    The factors are those of Young's modulus, as materials and paint have it at each time code; all
    else stays as it is at rest.
    keys : of `material_keys`; again : assigns the materials of another time code; repeats : of
    --loop.

    Raises InputError for values out of range, and UsageError for a solver that cannot follow them.
    """
    from gf_usd.readers.usd_bake.keys import spec_at

    notes = [
        f"{name} has time samples, and keeps the value of the rest pose: of materials only"
        " youngsModulus changes"
        for name in keys.others
    ]
    codes = _needed(keys.codes, settings)
    if not codes:
        return replace(assigned, notes=(*assigned.notes, *notes))
    rest = spread(assigned.particles, assigned.tables[0])["youngs_modulus"]
    found = [again(spec_at(asset, file, spec, code)) for code in codes]
    young = [spread(one.particles, one.tables[0])["youngs_modulus"] for one in found]
    factors, of = np.unique(np.stack(young) / rest, axis=1, return_inverse=True)
    if np.allclose(factors, 1.0, rtol=SAME, atol=0.0):
        return replace(assigned, notes=(*assigned.notes, *notes))
    if settings.solver in ("ul", MIXED):
        raise UsageError(
            f"{asset.facts.path}: {keys.by[0]} has time samples, which --solver ul and bakes with"
            " bodies that flow without end do not know",
            "use --solver tl, or author one value",
        )
    low, high = float(np.min(young)), float(np.max(young))
    notes.append(
        f"Young's modulus changes with {len(codes)} time samples of {', '.join(keys.by)}: from"
        f" {low:.4g} to {high:.4g} Pa; the step is that of the stiffest"
    )
    if repeats:
        notes.append("--loop does not repeat the time samples of materials: the first one holds")
    stiffness = StiffnessKeys(times=np.array(codes), factors=factors, of=of.reshape(-1))
    return replace(
        assigned,
        particles=replace(assigned.particles, stiffness=stiffness),
        notes=(*assigned.notes, *notes),
    )


def _needed(codes: tuple[float, ...], settings: Settings) -> list[float]:
    """The time codes between which a bake lies."""
    if not codes:
        return []
    start, end = settings.time_code(0), settings.time_code(settings.frames - 1)
    first = max([k for k, code in enumerate(codes) if code <= start], default=0)
    last = min([k for k, code in enumerate(codes) if code >= end], default=len(codes) - 1)
    return list(codes[first : last + 1])

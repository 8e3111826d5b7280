"""Hints for bakes that take long: a shorter damping time, or --mass-scaling.

Both promise what the estimate says of the bake with that option: the solver, which has the number
of substeps, is built once more with the materials that the option would give.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.units import percent_text
from gf_usd.pipeline.cost.budget import Cost, rough_duration

LONG = 300.0  # [s] of a bake of a flowing material from which mass scaling is suggested
ELASTIC = 0.02  # of strain at yield: more is seen as springback
WORTH = 0.6  # of the time at most, for which mass scaling is suggested
OVERDAMPED = 3.0  # damping ratio from which damping alone limits the time step
DAMPED = 30.0  # [s] of a bake from which a shorter damping time is suggested


def shortcuts(
    cost: Cost,
    tables: Sequence[Sequence[Material]],
    *,
    damped: Callable[[int, float], int],
    scaled: Callable[[float], float],
    scaling: float = 1.0,
) -> tuple[str, ...]:
    """The hints for a bake, as text.

    tables : the materials of all bodies, for each variant.
    damped : substeps of a frame of a variant, by its number, if all its materials had a damping
        time [s].
    scaled : [s] that the bake would take with a further mass scaling.
    scaling : the mass scaling that it has.
    """
    found = [
        damping_hint(row, table, lambda tau, number=number: damped(number, tau))
        for number, (row, table) in enumerate(zip(cost["per_material"], tables, strict=True))
    ]
    return tuple(filter(None, (*found, mass_scaling_hint(cost, tables, scaled, scaling))))


def damping_hint(
    row: Mapping[str, Any], table: Sequence[Material], substeps: Callable[[float], int]
) -> str:
    """A hint at a shorter damping time, where damping limits the time step; "" otherwise.

    The suggestion damps the stiffest vibration of the grid critically, in two digits.  The time
    step is that of `time_step`, (2 / w) (sqrt(1 + z^2) - z), with the damping ratio z proportional
    to the damping time.  The option sets the damping time of all materials, with which that
    vibration has z = (1/2) w tau 2 mu / (lam + 2 mu), with the moduli of the material of the
    fastest waves (`critical_damping_time`).

    table : the materials of all bodies; substeps : of a frame, with a damping time [s] of all.
    """
    z = float(row["damping_ratio"])
    candidates = [one for one in table if one.damping_time]
    if z < OVERDAMPED or row["seconds"] < DAMPED or not candidates:
        return ""
    # the damping of a node is the mean viscosity over its mass
    material = max(candidates, key=lambda one: one.mu * one.damping_time / one.density)
    shorter, of, owner = material.damping_time / z, "", ""
    if len(table) > 1:
        shorter = float(row["critical_damping_time"])
        of, owner = f" for all {len(table)} materials", f" of {material.name},"
    suggested = float(f"{shorter:.2g}")
    if not 0.0 < suggested < material.damping_time:
        return ""
    count = substeps(suggested)
    if count >= row["substeps_per_frame"]:
        return ""
    return (
        f"--damping-time {suggested:g}{of} would bake {row['name']} in {count} substeps a frame:"
        f" {'the' if owner else 'its'} damping time{owner or ' of'}"
        f" {material.damping_time:.3g} s{',' if owner else ''} takes {row['substeps_per_frame']}"
    )


def mass_scaling_hint(
    cost: Cost,
    tables: Sequence[Sequence[Material]],
    seconds: Callable[[float], float],
    scaling: float = 1.0,
) -> str:
    """A hint at --mass-scaling, where stiff plastic materials limit the time step; "" otherwise.

    The option holds for all variants.  The suggestion is the largest factor, in two digits, for
    which the elastic strain at yield of every flowing material of all variants stays below ELASTIC.

    tables : the materials of all bodies, for each variant.
    seconds : [s] that the bake would take with a further factor; scaling : the factor that it has,
    which the option replaces.
    """
    rows = cost["per_material"]
    plastic = {one.name: one for table in tables for one in table if LAWS[one.law].flows}
    strains = [one.yield_strain or 0.0 for one in plastic.values()]
    if max(row["seconds"] for row in rows) < LONG or not strains or min(strains) <= 0.0:
        return ""
    strain = max(strains)
    if strain > ELASTIC / 4.0:
        return ""
    most = scaling * ELASTIC / strain
    digit = 10.0 ** (math.floor(math.log10(most)) - 1)
    whole = float(f"{math.floor(most / digit) * digit:.2g}")
    factor = whole / scaling
    if all(_speed(table, factor) > WORTH * _speed(table) for table in tables):
        return ""  # an elastic material has the fastest waves, and keeps its moduli
    promised = seconds(factor)
    if promised > WORTH * cost["usual_seconds"]:
        return ""
    what = f"all {len(rows)} materials" if len(rows) > 1 else rows[0]["name"]
    if len(rows) == 1:
        stiffest = max(plastic.values(), key=lambda one: one.wave_speed)
        within = f", in the {stiffest.name} of which" if len(tables[0]) > 1 else ", in which"
        what += f"{within} waves run at {stiffest.wave_speed:.3g} m/s,"
    return (
        f"--mass-scaling {whole:g} would bake {what} in about {rough_duration(promised)} and"
        f" dent {', '.join(plastic) if len(rows) > 1 else 'it'} alike:"
        f" {'they spring' if len(plastic) > 1 else 'it springs'} back by up to"
        f" {percent_text(factor * strain)} instead of {percent_text(strain)}"
    )


def _speed(table: Sequence[Material], factor: float = 1.0) -> float:
    """[m/s] of the fastest waves, with the moduli of what flows divided by a factor."""
    return max(one.wave_speed / (factor**0.5 if LAWS[one.law].flows else 1.0) for one in table)

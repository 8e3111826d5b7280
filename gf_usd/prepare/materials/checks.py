"""Checks that materials are consistent: yield stresses and laws, weight and stiffness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.errors import InputError
from gf_usd.core.frames import Particles
from gf_usd.core.materials.laws import LAWS, stated_flow
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.presets import Fixed
from gf_usd.core.stage import StageSpec
from gf_usd.core.units import length_text
from gf_usd.prepare.materials.parts import MaterialPart
from gf_usd.prepare.materials.table import FLOW, Authored, own_spec

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


def flow_notes(
    look: Any,
    law: str | None,
    parts: Sequence[MaterialPart],
    materials: Mapping[int, Material],
    solid: Solid,
    spec: StageSpec,
) -> tuple[str, ...]:
    """Notes where a yield stress is stated: which law was chosen for it, or that no law uses it.

    look : as in `table`; law : of the options; materials : of the parts that have particles, by
        index of parts.
    """
    notes = list(look.notes) if isinstance(look, Fixed) else []
    for k, material in materials.items():
        part, path = parts[k], solid.surfaces[parts[k].surface].path
        painted = spec.painted.get(path, {}).keys() & FLOW
        own = own_spec(part, spec.bodies.get(path)) if isinstance(look, Authored) else None
        stated = own.parameters.keys() & FLOW if own else set()
        if not LAWS[material.law].flows and (painted or material.parameters.keys() & FLOW):
            notes.append(
                f"<{path}>: the yield stress is not used, because the law {material.law}"
                " has no plastic flow: use --law vonMises"
            )
        elif law is None and stated and own and own.law is None:
            what = stated_flow(material.law)
            notes.append(f"<{own.path}>: {what} is stated but no law: {material.law} is used")
        elif law is None and painted and not stated and (own is None or own.law is None):
            notes.append(f"<{path}>: a yield stress is painted: the law is {material.law}")
    return tuple(dict.fromkeys(notes))


def require_parameters(
    path: Path,
    particles: Particles,
    slot: Ints,
    materials: Mapping[int, Material],
    solid: Solid,
    spec: StageSpec,
) -> None:
    """Raise InputError where a parameter of a law is neither stated nor painted.

    path : of the asset, for messages; slot, materials : as in `table` and `flow_notes`.
    """
    for k, material in materials.items():
        for p in LAWS[material.law].parameters:
            if not p.required or p.name in material.parameters:
                continue
            from gf_usd.geometry.surface import nearest

            bare = [p.name not in spec.painted.get(s.path, {}) for s in solid.surfaces]
            mine = np.flatnonzero(slot == k)
            found = mine[np.array(bare)[nearest(solid, particles.X).surface[mine]]]
            if len(found):
                surface = solid.surfaces[int(particles.surface[found[0]])]
                raise InputError(
                    f"{path}: <{surface.path}>: the law {material.law} needs a"
                    f" {p.label.lower()}, and {material.name} (Young's modulus"
                    f" {material.youngs_modulus:.3g} Pa) has none",
                    f"author gaussianFlesh:{p.attribute} on a material or paint it as a primvar,"
                    " or use a plastic material, such as clay or mild-steel",
                )


SINGLE = np.finfo(np.float32)


def require_weighable(
    path: Path, particles: Particles, slot: Ints, materials: Sequence[Material]
) -> None:
    """Raise InputError where masses are beyond the range of single precision, which solvers and
    caches use.

    slot : (N,) of each particle in materials.
    """
    mass = np.array([m.density for m in materials])[slot] * particles.V0
    whole, least = float(mass.sum()), float(mass.min())
    most, smallest = float(SINGLE.max), float(SINGLE.tiny)
    if whole >= most or least <= smallest:
        what = (
            f"the bodies would weigh {whole:.3g} kg"
            if whole >= most
            else f"a particle would weigh {least:.3g} kg"
        )
        raise InputError(
            f"{path}: {what}, and single precision holds from {smallest:.2g} to"
            f" {most:.2g}; particles are {length_text(particles.spacing)} apart",
            "check the unit (--meters-per-unit) and the transforms of the asset",
        )


SPREADS = 3.0  # times its Young's modulus: weight that presses a body flat

FLAT = 100.0  # times: there is no such body


def require_standing(
    path: Path,
    materials: Sequence[Material],
    height: float,
    gravity: float,
    *,
    carried: bool = False,
) -> tuple[str, ...]:
    """Notes on materials that are too soft for bodies of this height.

    The weight of a column, rho g H, over Young's modulus E is the strain at its foot, for small
    strains.  Jelly has 1.1 by design: it spreads on the floor and keeps a third of its height.

    height : H [m] of the tallest body along gravity [m/s^2]. carried : bones support it, or there
        is no floor: it does not spread.
    Raises InputError where the ratio is FLAT or more.
    """
    notes = []
    for material in dict.fromkeys(materials):
        weight = material.density * gravity * height
        ratio = weight / material.youngs_modulus
        if ratio < SPREADS:
            continue
        problem = (
            f"{material.name} cannot carry its own weight: {length_text(height)} of it weigh"
            f" {weight:.3g} Pa,"
            f" {ratio:.3g} times its Young's modulus of {material.youngs_modulus:.3g} Pa"
        )
        change = f"a Young's modulus of {weight:.2g} Pa"
        if ratio >= FLAT:
            raise InputError(
                f"{path}: {problem}",
                f"take {change} or more, a preset such as jelly, whose stiffness grows with the"
                " body, or check the unit (--meters-per-unit)",
            )
        if not carried:
            notes.append(f"{problem}, so it spreads on the floor; {change} would keep its shape")
    return tuple(notes)

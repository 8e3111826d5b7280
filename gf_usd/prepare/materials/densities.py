"""Densities of the stage that no solid has, as where kg/m^3 are authored in centimeters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.frames import Particles
from gf_usd.core.stage import StageSpec
from gf_usd.core.units import StageUnits

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid

DENSEST = 23_000.0  # [kg/m^3] osmium has 22,600
LIGHT = 25.0  # from here on a number means kg/m^3, below g/cm^3: foams and lighter woods apart


def implausible_densities(
    spec: StageSpec, particles: Particles, solid: Solid, units: StageUnits, *, by_stage: bool
) -> str:
    """A warning where densities or masses of the stage make bodies denser than any solid; else "".

    by_stage : whether the materials of the stage are used, and not only presets.
    """
    if not by_stage:
        return ""
    found: dict[str, str] = {}
    volume = np.bincount(particles.surface, particles.V0, minlength=len(solid.surfaces))
    filled: dict[str, float] = {}
    mass: dict[str, float] = {}
    for k, surface in enumerate(solid.surfaces):
        body = spec.bodies.get(surface.path)
        if body is None:
            continue
        if body.mass is not None:  # goes before all densities
            mass[body.mass_of] = body.mass
            filled[body.mass_of] = filled.get(body.mass_of, 0.0) + float(volume[k])
            continue
        stated = [(one.spec.density, one.spec.path) for one in body.subsets]
        stated.append((body.spec.density, body.spec.path))
        if body.density is not None:
            stated = [(body.density, body.density_of)]
        for density, path in stated:
            if density is not None and density > DENSEST:
                found[path] = f"a density of {_text(density)}{_meant(density, units)}"
    for path, kilograms in mass.items():
        if kilograms > DENSEST * filled[path] > 0.0:
            found[path] = (
                f"a mass of {kilograms:.3g} kg in {filled[path]:.3g} m^3, which is a density of"
                f" {_text(kilograms / filled[path])}"
            )
    if not found:
        return ""
    path, what = next(iter(found.items()))
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return f"<{path}>{more} states {what}; no solid has more than {_text(DENSEST)}"


def _meant(density: float, units: StageUnits) -> str:
    """The number [kg/m^3] in the units of the stage, and which one was probably meant."""
    if units.density == 1.0:
        return ""
    authored = density / units.density
    unit = (
        f"{authored:.4g} mass units of {units.kilograms_per_unit:g} kg per cubic unit of"
        f" {units.meters_per_unit:g} m"
    )
    meant = authored if authored >= LIGHT else 1000.0 * authored
    if not LIGHT <= meant <= DENSEST:
        return f" ({unit})"
    number = "kg/m^3" if authored >= LIGHT else "g/cm^3"
    return (
        f" ({unit}): {authored:.4g} {number} was probably meant, which is"
        f" {meant / units.density:.4g} in the units of this stage"
    )


def _text(density: float) -> str:
    return f"{density:,.0f} kg/m^3" if density < 1e6 else f"{density:.3g} kg/m^3"

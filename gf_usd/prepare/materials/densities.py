"""Densities of the stage that no solid has, as where kg/m^3 are authored in centimeters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import BodyPhysics, StageSpec
from gf_usd.core.units import StageUnits, volume_text
from gf_usd.prepare.materials.parts import MaterialPart

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid

DENSEST = 23_000.0  # [kg/m^3] osmium has 22,600
USED = 1e-2  # relative: a material's density is the stated one; nearly equal materials are merged
LIGHT = 25.0  # from here on a number means kg/m^3, below g/cm^3: foams and lighter woods apart


@dataclass(frozen=True, kw_only=True)
class StatedDensity:
    """A density that parts of bodies have because a prim of the stage states it, or a mass."""

    prim: str  # that states it
    attribute: str  # of that prim
    density: float  # [kg/m^3]
    mass: float | None = None  # [kg] that it states; None: a density
    volume: float = 0.0  # [m^3] that has the mass


def stated_densities(
    made: Mapping[int, Material],
    slot: Ints,
    particles: Particles,
    parts: Sequence[MaterialPart],
    solid: Solid,
    spec: StageSpec,
) -> tuple[StatedDensity, ...]:
    """The densities and masses of the stage that its bake uses.

    Presets and painted densities go before stated ones, and a part without particles has none.

    made : the material of each part with particles; slot : (N,) of `part_of_particles`.
    """
    found = []
    volume = np.bincount(slot, particles.V0, minlength=len(parts))
    groups: dict[str, list[int]] = {}
    mass: dict[str, float] = {}
    attribute: dict[str, str] = {}
    for k, material in made.items():
        path = solid.surfaces[parts[k].surface].path
        body = spec.bodies.get(path)
        if body is None:
            continue
        if body.mass is not None:  # goes before all densities
            groups.setdefault(body.mass_of, []).append(k)
            mass[body.mass_of] = body.mass
            attribute[body.mass_of] = body.mass_attribute
        elif parts[k].region is None and "density" not in spec.painted.get(path, {}):
            density, prim, name = _stated(parts[k], body)
            if density is not None and np.isclose(material.density, density, rtol=USED, atol=0.0):
                found.append(StatedDensity(prim=prim, attribute=name, density=density))
    for prim, members in groups.items():
        now = float(sum(made[k].density * volume[k] for k in members))
        filled = float(volume[members].sum())
        if np.isclose(now, mass[prim], rtol=USED, atol=0.0):
            found.append(
                StatedDensity(
                    prim=prim,
                    attribute=attribute[prim],
                    density=now / filled,
                    mass=mass[prim],
                    volume=filled,
                )
            )
    return tuple(found)


def _stated(part: MaterialPart, body: BodyPhysics) -> tuple[float | None, str, str]:
    """The density [kg/m^3] that the stage states for a part, the prim and its attribute."""
    if body.density is not None:
        return body.density, body.density_of, "physics:density"
    spec = body.spec
    if part.subset is not None and part.subset.spec.density is not None:
        spec = part.subset.spec
    return spec.density, spec.path, spec.density_attribute


def implausible_densities(stated: Sequence[StatedDensity], units: StageUnits) -> tuple[str, str]:
    """A warning where the stage states a density that no solid has, or a mass that gives it, and
    what is to be corrected; "" and "" where it states none.
    """
    found = {one.prim: one for one in stated if one.density > DENSEST}
    if not found:
        return "", ""
    path, first = next(iter(found.items()))
    if first.mass is None:
        what = f"a density of {_text(first.density)}{_meant(first.density, units)}"
    else:
        what = (
            f"a mass of {first.mass:.3g} kg in {volume_text(first.volume)}, which is a density of"
            f" {_text(first.density)}"
        )
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return (
        f"<{path}>{more} states {what}; no solid has more than {_text(DENSEST)}",
        f"{first.attribute} of <{path}>",
    )


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

"""Material values of particles: those of their material, or their own in a mixed body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.laws import LAWS, law_parameters
from gf_usd.core.materials.material import Material, young_poisson

if TYPE_CHECKING:
    pass


# Values that may differ by particle, in addition to the parameters of laws; others follow.
FREE = ("density", "mu", "lam", "damping_time", "friction", "restitution")

REPORTED = ("youngs_modulus", "poissons_ratio", "density")

SAME = 1e-6  # relative: float32 holds no finer difference


def of_materials(particles: Particles, materials: Sequence[Material]) -> dict[str, Floats]:
    """(N,) of each value in `columns`, as the material of each particle has it."""
    index = np.asarray(particles.material)
    return {name: column[index] for name, column in columns(materials).items()}


def columns(materials: Sequence[Material]) -> dict[str, Floats]:
    """(M,) of each of FREE, and of each parameter that a law of these materials has."""
    own = {
        one.name: np.array([m.parameter(one) for m in materials])
        for one in law_parameters(m.law for m in materials)
    }
    return {name: np.array([getattr(m, name) for m in materials]) for name in FREE} | own


def unbounded(particles: Particles, materials: Sequence[Material]) -> Ints:
    """(N,) whether particles flow without limit from the start, by the laws of their materials."""
    return np.array([LAWS[m.law].unbounded for m in materials])[np.asarray(particles.material)]


def convertible(particles: Particles) -> Ints:
    """(N,) whether particles can be converted."""
    out = np.zeros(len(particles), bool)
    for one in particles.conversions:
        out[one.particles] = True
    return out


def after_conversion(particles: Particles) -> Particles:
    """The particles after all possible conversions."""
    material = np.array(particles.material)
    for one in particles.conversions:
        material[one.particles] = one.material
    return replace(particles, material=material, own=None)


def stiffest_by_conversion(
    per: dict[str, Floats], particles: Particles, materials: Sequence[Material]
) -> dict[str, Floats]:
    """Values (N,) of the particles with moduli and damping as high as they get by conversion."""
    if not particles.conversions:
        return per
    after = of_materials(after_conversion(particles), materials)
    names = ("mu", "lam", "damping_time")
    return with_derived({**per, **{name: np.maximum(per[name], after[name]) for name in names}})


def moved_as_flow(particles: Particles, materials: Sequence[Material]) -> Ints:
    """(N,) particles that replace meshes, from the start or later: those of surfaces of which some
    flow without limit, and of bodies of which some can be converted.
    """
    surface, body = np.asarray(particles.surface), particles.body_of
    flows = np.unique(surface[unbounded(particles, materials)])
    later = np.unique(body[convertible(particles)])
    return np.isin(surface, flows) | np.isin(body, later)


def flowing(particles: Particles, materials: Sequence[Material]) -> dict[int, Ints]:
    """Indices of the particles of `moved_as_flow`, by body; bodies without any are left out."""
    flows = moved_as_flow(particles, materials)
    body = particles.body_of
    return {int(b): np.flatnonzero(flows & (body == b)) for b in np.unique(body[flows])}


def spread(particles: Particles, materials: Sequence[Material]) -> dict[str, Floats]:
    """Material values of particles, (N,) each, in SI: `columns`, and what follows from them.

    c = sqrt((lam + 2 mu) / rho); E and nu by `young_poisson`.
    """
    return with_derived({**of_materials(particles, materials), **(particles.own or {})})


def with_derived(values: Mapping[str, Floats]) -> dict[str, Floats]:
    """The values, with youngs_modulus, poissons_ratio and wave_speed as in `spread`."""
    mu, lam = values["mu"], values["lam"]
    young, poisson = young_poisson(mu, lam)
    return {
        **values,
        "youngs_modulus": young,
        "poissons_ratio": poisson,
        "wave_speed": np.sqrt((lam + 2.0 * mu) / values["density"]),
    }


def summary(particles: Particles, materials: Sequence[Material]) -> dict[str, Any]:
    """How many particles differ from their material, and the range of values of all, in SI.

    Empty if none differs.
    """
    if particles.own is None:
        return {}
    plain = with_derived(of_materials(particles, materials))
    mine = spread(particles, materials)
    differs = np.zeros(len(particles), bool)
    for name in (*columns(materials), *REPORTED):
        differs |= ~np.isclose(mine[name], plain[name], rtol=SAME, atol=0.0)
    ranges = {name: [float(mine[name].min()), float(mine[name].max())] for name in REPORTED}
    return {"particles": int(differs.sum()), **ranges}

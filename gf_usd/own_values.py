"""Material values of single particles: their material's, or their own where a body is mixed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gf_usd.model import Floats, Material, Particles

# What a particle may have of its own; the rest follows from these.
FREE = ("density", "mu", "lam", "damping_time", "friction", "restitution")
REPORTED = ("youngs_modulus", "poissons_ratio", "density")
SAME = 1e-6  # relative: float32 holds no finer difference


def of_materials(particles: Particles, materials: Sequence[Material]) -> dict[str, Floats]:
    """(N,) of each of FREE, as the material of each particle has it."""
    index = np.asarray(particles.material)
    return {name: np.array([getattr(m, name) for m in materials])[index] for name in FREE}


def spread(particles: Particles, materials: Sequence[Material]) -> dict[str, Floats]:
    """Material values of particles, (N,) each, in SI: FREE, and what follows from it.

    E = mu (3 lam + 2 mu) / (lam + mu), nu = lam / (2 (lam + mu)), c = sqrt((lam + 2 mu) / rho).
    """
    return with_derived({**of_materials(particles, materials), **(particles.own or {})})


def with_derived(values: Mapping[str, Floats]) -> dict[str, Floats]:
    """The values, with youngs_modulus, poissons_ratio and wave_speed as in `spread`."""
    mu, lam = values["mu"], values["lam"]
    return {
        **values,
        "youngs_modulus": mu * (3.0 * lam + 2.0 * mu) / (lam + mu),
        "poissons_ratio": lam / (2.0 * (lam + mu)),
        "wave_speed": np.sqrt((lam + 2.0 * mu) / values["density"]),
    }


def summary(particles: Particles, materials: Sequence[Material]) -> dict[str, Any]:
    """How many particles differ from their material, and the range of values of all, in SI.

    Empty where all are as their materials say.
    """
    if particles.own is None:
        return {}
    plain = with_derived(of_materials(particles, materials))
    mine = spread(particles, materials)
    differs = np.zeros(len(particles), bool)
    for name in (*FREE, *REPORTED):
        differs |= ~np.isclose(mine[name], plain[name], rtol=SAME, atol=0.0)
    ranges = {name: [float(mine[name].min()), float(mine[name].max())] for name in REPORTED}
    return {"particles": int(differs.sum()), **ranges}

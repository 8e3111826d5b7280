"""Material values of the particles of a Total Lagrangian body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.keys import ValueKeys
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import spread, with_derived
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.stage import Pin


def per_particle(
    particles: Particles, materials: Sequence[Material], held: Ints | None = None
) -> dict[str, Floats]:
    """Material values per particle, (N,) each, and the rest volume V0 [m^3] that is simulated.

    held : (N,) pin of each particle, -1 for none; a pinned particle has V0 = 0.
    """
    per = spread(particles, materials)
    free = np.ones(len(particles)) if held is None else (held < 0).astype(float)
    return {**per, "V0": particles.V0 * free}


def at_largest_moduli(
    per: dict[str, Floats], keys: ValueKeys | None, settings: Settings
) -> dict[str, Floats]:
    """Material values per particle, with the largest moduli and damping of all frames.

    The damping rate of the stiffest vibration is proportional to mu tau, so the maxima of mu and
    tau bound it at all times.
    """
    if keys is None:
        return per
    most = keys.most(settings.time_code(max(k - 0.5, 0.0)) for k in range(settings.frames))
    return with_derived({**per, **{name: most[name] for name in ("mu", "lam", "damping_time")}})


def with_soft_material(
    particles: Particles, materials: Sequence[Material], regions: Sequence[Pin]
) -> Particles:
    """Particles of rigid regions with the material of the nearest soft particle, but their own
    density.

    Strain in a region occurs only in its outermost cells, between its nodes and free ones.

    Raises InputError where all particles are in rigid regions.
    """
    if not regions:
        return particles
    inside = np.any([pin.holds(particles.X, particles.body) for pin in regions], axis=0)
    flesh, stone = np.flatnonzero(~inside), np.flatnonzero(inside)
    if not len(flesh):
        raise InputError(
            f"--rigid {', '.join(pin.name for pin in regions)} holds all {len(inside)} particles",
            "leave some of the body soft",
        )
    if not len(stone):
        return particles
    nearest = flesh[kd_tree(particles.X[flesh]).query(particles.X[stone])[1]]
    of = np.arange(len(inside))
    of[stone] = nearest
    own = {name: values[of] for name, values in (particles.own or {}).items()}
    own["density"] = spread(particles, materials)["density"]
    keys = particles.keys
    return replace(
        particles,
        material=np.asarray(particles.material)[of],
        own=own,
        keys=replace(keys, of=keys.of[of]) if keys else None,
    )


def viscosities(per: Mapping[str, Floats], h: float) -> Floats:
    """(N, 2) 2 mu tau [Pa s] of Kelvin-Voigt damping and c2 rho0 h^2 [Pa s^2] of the shock
    viscosity.

    Both are 0 for a material without damping, which conserves energy.

    per : of `Body.values_at`; h : [m] edge of a cell.
    """
    from gf_usd.physics.laws.stress import SHOCK

    tau, mu = per["damping_time"], per["mu"]
    return np.column_stack([2.0 * mu * tau, (tau > 0.0) * SHOCK * per["density"] * h * h])

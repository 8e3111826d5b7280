"""Fills the bodies of a solid with particles, and covers them with contact samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.arrays import Ints
from gf_usd.core.asset import Asset
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.units import length_text
from gf_usd.prepare.bodies.plan import BodyPlan, plan_bodies
from gf_usd.prepare.materials.flowing import Dispatch
from gf_usd.prepare.settings import Resolution

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid

OTHER_COUNT = 0.25  # of the number requested: solids alone are as far from it


@dataclass(frozen=True, kw_only=True)
class SampledBodies:
    """The bodies of a bake with their particles and contact samples."""

    bodies: BodyPlan
    particles: Particles
    samples: SurfaceSamples


def sample_bodies(
    asset: Asset,
    solid: Solid,
    resolution: Resolution,
    flow: Dispatch,
    *,
    seed: int,
    paper: bool,
    mixed: bool,
    combine: bool,
    owners: dict[str, str],
    find: Callable[[float], Ints],
    characters: bool,
    can_combine: bool,
    placing: Callable[[], None],
    covering: Callable[[], None],
) -> SampledBodies:
    """Fill a solid.  Raises InputError where a body cannot be filled.

    seed : of random places; paper : whether particles are placed as in the paper.
    mixed : there are solid and flowing bodies, each with its own solver.
    combine, owners, find, characters, can_combine : see `plan_bodies`.
    placing, covering : called before particles are placed, and before surfaces get samples.
    """
    from gf_usd.geometry.sampling.contact_samples import sample_surface
    from gf_usd.geometry.sampling.particles import expected_particles, sample_solid

    def sample(of: Ints) -> Particles:
        return sample_solid(
            solid,
            particles=resolution.particles if resolution.spacing is None else None,
            spacing=resolution.spacing,
            seed=seed,
            uniform=paper,
            up=asset.facts.up_axis,
            bodies=of,
            scattered=None if paper else flow.first,
            later=None if paper else flow.flows & ~flow.first,
        )

    placing()
    spacing = resolution.spacing or spacing_of(solid.volume, resolution.particles or 1)
    expected_particles(solid, spacing)  # before the search for bodies samples surfaces as finely
    bodies, particles = plan_bodies(
        asset, solid, spacing, sample, owners, find, combine=combine,
        kinds=flow.first if mixed else None, characters=characters,
        can_combine=can_combine,
    )  # fmt: skip
    covering()
    if paper or (flow.flows.any() and not mixed):
        # Contact with the floor acts on every particle; a mass of rho * area * spacing is its own.
        samples = SurfaceSamples(X=particles.X, area=particles.V0 / particles.spacing)
    else:
        samples = sample_surface(
            solid,
            particles.spacing,
            bodies.of_surface if bodies.count > 1 else None,
            asset.facts.up_axis,
        )
    if mixed:
        samples = samples.with_grains(particles, bodies.flows(flow.first))
    return SampledBodies(bodies=bodies, particles=particles, samples=samples)


def spacing_of(volume: float, particles: int) -> float:
    """[m] spacing of so many particles in a volume [m^3]."""
    return float(np.cbrt(volume / particles))


def count_notes(requested: int, particles: Particles, *, sheets: bool) -> tuple[str, ...]:
    """A note where the number of particles differs from the requested one; 0: none was requested.

    sheets : sheets of one layer are filled at a spacing that was to give as many.
    """
    count = len(particles)
    if not requested or abs(count - requested) <= OTHER_COUNT * requested:
        return ()
    if sheets:
        return (
            f"sheets of one layer have {count} particles instead of {requested}: --spacing sets"
            " the distance between them",
        )
    if count < requested:
        return ()
    from gf_usd.geometry.sampling.particles import CELL_PER_LATTICE, LEAST_PARTICLES

    few = requested < LEAST_PARTICLES
    least = f"a bake needs at least {LEAST_PARTICLES}, and " if few else ""
    return (
        f"there are {count} particles instead of {requested}: {least}each cell of the grid that the"
        " surface cuts gets four or eight, which are many where the body is thinner than a cell"
        f" ({length_text(CELL_PER_LATTICE * particles.lattice)}); for fewer, give a larger"
        " --spacing in place of --particles",
    )

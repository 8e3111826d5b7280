"""Longer time steps for flowing materials: `--mass-scaling`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gf_usd.core.errors import UsageError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.core.units import percent_text


def mass_scaled(
    tables: Sequence[tuple[Material, ...]], particles: Particles, factor: float
) -> tuple[list[tuple[Material, ...]], Particles, tuple[str, ...]]:
    """Flowing materials with elastic moduli divided by `factor`, and notes.

    Density, weight and velocities are unchanged, and with them the energy of an impact; so is the
    yield stress.  The final shape is therefore the same as long as elastic strains are small.  A
    body with `factor` times the density and strength has the same motion.  Scaling the inertia
    alone does not help: with the true weight the motion is slower by the square root of the factor,
    so the longer time steps have a proportionally longer motion to cover.

    Raises UsageError where no material flows.
    """
    if factor == 1.0:
        return list(tables), particles, ()
    seen = {m.name: m for table in tables for m in table if LAWS[m.law].flows}
    if not seen:
        laws = {m.name: m.law for table in tables for m in table}
        raise UsageError(
            f"--mass-scaling {factor:g}: the bake has no material with plastic flow: "
            + ", ".join(f"{name} is {law}" for name, law in laws.items()),
            "omit it: the shape of an elastic body depends on its stiffness",
        )
    own = particles.own
    if own is not None:
        flows = np.array([LAWS[m.law].flows for m in tables[0]])[np.asarray(particles.material)]
        share = np.where(flows, 1.0 / factor, 1.0)
        own = {**own, "mu": own["mu"] * share, "lam": own["lam"] * share}
    notes = [
        f"--mass-scaling {factor:g}: {m.name} has a Young's modulus of"
        f" {m.youngs_modulus / factor:.3g} Pa instead of {m.youngs_modulus:.3g} Pa"
        + (
            f", and yields at an elastic strain of {percent_text(factor * strain)} instead of"
            f" {percent_text(strain)}"
            if (strain := m.yield_strain) is not None else ""
        )
        + "; mass, weight and yield stress do not change"
        for m in seen.values()
    ]  # fmt: skip
    scaled = [tuple(scaled_material(m, factor) for m in table) for table in tables]
    return scaled, replace(particles, own=own), tuple(notes)


def scaled_material(material: Material, factor: float) -> Material:
    """A material as `mass_scaled` has it: one that does not flow is unchanged."""
    if not LAWS[material.law].flows:
        return material
    return replace(material, youngs_modulus=material.youngs_modulus / factor)

"""Solid and flowing bodies that meet, made of values: as a plan would hand them to the solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from solids import settings, solid

from gf_usd.core.asset import Surface
from gf_usd.core.frames.settings import MIXED
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import Collider, ContactSetup
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.coupled.solver import Coupled
from gf_usd.physics.solvers import make_solver
from gf_usd.prepare.bodies.contact import skins


def mixed_solver(
    *surfaces: Surface,
    materials: Sequence[str],
    particles: int,
    colliders: tuple[Collider, ...] = (),
    changes: dict[str, Any] | None = None,
    velocity: Any = (0.0, 0.0, 0.0),
    real: type = np.float32,
    **options: Any,
) -> Coupled:
    """A solver of surfaces that are a body each, of a preset each; changes : to all materials."""
    made = solid(*surfaces)
    of = np.arange(len(surfaces))
    filled = sample_solid(made, particles=particles, spacing=None, seed=0, bodies=of)
    body = of[filled.surface]
    filled = replace(filled, body=body, material=body)
    radius = filled.radii
    table = [
        replace(find_preset(name).material(float(r), None), **(changes or {}))
        for name, r in zip(materials, radius, strict=True)
    ]
    on = sample_surface(made, filled.spacing, of)
    flows = np.array([LAWS[m.law].unbounded for m in table])
    samples = on.with_grains(filled, flows)
    solver = make_solver(
        settings(**{"solver": MIXED, **options}), filled, table, samples=samples,
        embedded={s.path: s.points for s in surfaces},
        embedded_body={s.path: k for k, s in enumerate(surfaces)},
        velocity=velocity, real=real,
        contact_setup=ContactSetup(skins=skins(made, of, filled.spacing), colliders=colliders),
    )  # fmt: skip
    assert isinstance(solver, Coupled)
    return solver

"""Which bodies flow without limit, and which meshes then have no body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import convertible, flowing, unbounded
from gf_usd.prepare.bodies.plan import BodyPlan

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


@dataclass(frozen=True, kw_only=True)
class Flow:
    """The bodies that flow without limit, from the start or after conversion."""

    bodies: tuple[int, ...] = ()  # as in Particles: some of their particles flow, or all
    meshes: tuple[str, ...] = ()  # prim paths of those that particles replace from the start
    converting: tuple[tuple[str, int], ...] = ()  # of those they replace later, and their bodies


def flow_of(
    solid: Solid, bodies: BodyPlan, particles: Particles, materials: Sequence[Material]
) -> Flow:
    """The flowing bodies of a solid.

    A filled mesh is replaced by its particles where some of them flow, any other mesh where all of
    its body flows.  All meshes of a body that can be converted are replaced: once its first
    particle is converted, or from the start where some of it flows then.
    """
    flows = unbounded(particles, materials)
    body = particles.body_of
    ready = np.unique(body[convertible(particles)])
    later = np.setdiff1d(ready, np.unique(body[flows]))
    both = np.setdiff1d(ready, later)
    surface = np.asarray(particles.surface)
    filled = solid.filled
    meshes = [path for path, k in filled.items() if flows[surface == k].any()]
    meshes += [
        path
        for path, of in bodies.embedded.items()
        if path not in meshes and (of in both or (path not in filled and flows[body == of].all()))
    ]
    return Flow(
        bodies=tuple(flowing(particles, materials)),
        meshes=tuple(meshes),
        converting=tuple((path, of) for path, of in bodies.embedded.items() if of in later),
    )

"""What of the bodies flows without end, and which meshes that leaves without a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.frames import Particles
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import unbounded
from gf_usd.prepare.bodies.plan import BodyPlan

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


@dataclass(frozen=True, kw_only=True)
class Flow:
    """What flows without end."""

    bodies: tuple[int, ...] = ()  # as in Particles: some of their particles flow, or all
    meshes: tuple[str, ...] = ()  # prim paths of those that move with nothing solid


def flow_of(
    solid: Solid, bodies: BodyPlan, particles: Particles, materials: Sequence[Material]
) -> Flow:
    """What flows of the bodies of a solid.

    A mesh that is filled moves with nothing solid where all of its particles flow, any other one
    where all of its body do.
    """
    flows = unbounded(particles, materials)
    if not flows.any():
        return Flow()
    surface = np.asarray(particles.surface)
    body = particles.body_of
    meshes = [s.path for k, s in enumerate(solid.surfaces) if flows[surface == k].all()]
    filled = {s.path for s in solid.surfaces}
    meshes += [
        path
        for path, of in bodies.embedded.items()
        if path not in filled and flows[body == of].all()
    ]
    return Flow(bodies=tuple(np.unique(body[flows]).tolist()), meshes=tuple(meshes))

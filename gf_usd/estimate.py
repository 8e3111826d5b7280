"""What a bake will cost, before it starts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from gf_usd.plan import Plan

RATE = 4e6  # particle-substeps a second: BENCHMARKS.md, two cores; a guess for other machines
FRAME_OVERHEAD = 0.01  # [s] a frame
MESH_BYTES = 24  # points and velocities of a vertex, float32
NORMAL_BYTES = 12
PARTICLE_BYTES = 76  # positions, velocities, orientation, scale, and the Points twin


def estimate(plan: Plan) -> dict[str, Any]:
    """Substeps a frame of each material, seconds, bytes on disk, frame of first contact.

    The frame is None where the asset touches nothing within the bake.
    """
    frames, n = plan.settings.frames, len(plan.particles)
    substeps = {m.name: plan.solver(m).substeps for m in plan.materials}
    work = frames * n * sum(substeps.values()) / RATE
    mesh = sum(
        MESH_BYTES * len(s.points) + NORMAL_BYTES * (0 if s.normals is None else len(s.normals))
        for s in plan.asset.surfaces
    )
    s = plan.settings
    g = -float(np.dot(s.gravity, s.up))
    fall = np.sqrt(2.0 * plan.drop / g) if g > 0.0 else np.inf
    contact = int(np.ceil(fall * s.fps / s.time_scale)) if np.isfinite(fall) else None
    looks = len(plan.materials)
    return {
        "substeps_per_frame": substeps,
        "estimated_seconds": float(work + looks * frames * FRAME_OVERHEAD),
        "estimated_bytes": int(looks * frames * (mesh + PARTICLE_BYTES * n)),
        "first_contact_frame": contact if contact is not None and contact < frames else None,
    }

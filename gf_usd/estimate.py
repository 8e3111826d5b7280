"""What a bake will cost, before it starts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from gf_usd.bake import Plan

RATE = 4e6  # particle-substeps a second: BENCHMARKS.md, two cores; a guess for other machines
FRAME_OVERHEAD = 0.01  # [s] a frame
MESH_BYTES = 24  # points and velocities of a vertex, float32
NORMAL_BYTES = 12
PARTICLE_BYTES = 76  # positions, velocities, orientation, scale, and the Points twin


def estimate(plan: Plan) -> dict[str, Any]:
    """Estimated seconds, bytes on disk, and the frame of first contact (None: no fall)."""
    frames, n = plan.settings.frames, len(plan.particles)
    work = frames * plan.solver.substeps * n / RATE
    mesh = sum(
        MESH_BYTES * len(s.points) + NORMAL_BYTES * (0 if s.normals is None else len(s.normals))
        for s in plan.asset.surfaces
    )
    g = -float(np.dot(plan.settings.gravity, plan.settings.up))
    fall = np.sqrt(2.0 * plan.drop / g) if g > 0.0 else np.inf
    contact = int(np.ceil(fall * plan.settings.fps)) if np.isfinite(fall) else None
    return {
        "estimated_seconds": float(work + frames * FRAME_OVERHEAD),
        "estimated_bytes": int(frames * (mesh + PARTICLE_BYTES * n)),
        "first_contact_frame": contact if contact is not None and contact < frames else None,
    }

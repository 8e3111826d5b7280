"""What a bake will cost, before it starts.

Measured with the duck and with spheres of 41k to 655k vertices, 1k to 400k particles, on two cores
of an x86-64 server: within a factor of two of what ``/usr/bin/time -v`` says.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from gf_usd.plan import Plan

RATE = 7e6  # particle-substeps a second
START_SECONDS = 3.0  # imports, and compiling the kernels
PARTICLE_SECONDS = 8e-5  # sample a particle and place it on the grid, once
VERTEX_SECONDS = 3e-5  # weld, measure and embed a vertex, once
FRAME_OVERHEAD = 0.01  # [s] a frame
MESH_BYTES = 24  # points and velocities of a vertex, float32
NORMAL_BYTES = 12
PARTICLE_BYTES = 76  # positions, velocities, orientation, scale, and the Points twin
PROCESS_MEMORY = 320e6  # [bytes] Python, USD, Taichi and its compiler
PARTICLE_MEMORY = 4400.0  # [bytes] a particle, mostly the rows of W and G
VERTEX_MEMORY = 4400.0  # [bytes] a vertex, likewise


def estimate(plan: Plan) -> dict[str, Any]:
    """Substeps, seconds, disk and memory of each material and in all; frame of first contact.

    Materials are baked one after another: seconds and disk add up, memory does not.  The frame is
    None where the asset touches nothing within the bake.
    """
    frames, n = plan.settings.frames, len(plan.particles)
    vertices = sum(len(s.points) for s in plan.asset.surfaces)
    normals = sum(0 if s.normals is None else len(s.normals) for s in plan.asset.surfaces)
    disk = frames * (MESH_BYTES * vertices + NORMAL_BYTES * normals + PARTICLE_BYTES * n)
    memory = PROCESS_MEMORY + PARTICLE_MEMORY * n + VERTEX_MEMORY * vertices
    rows = []
    for material in plan.materials:
        substeps = plan.solver(material).substeps
        seconds = START_SECONDS + PARTICLE_SECONDS * n + VERTEX_SECONDS * vertices
        seconds += frames * (n * substeps / RATE + FRAME_OVERHEAD)
        rows.append(
            {
                "name": material.name,
                "substeps_per_frame": substeps,
                "seconds": float(seconds),
                "disk_bytes": int(disk),
                "memory_bytes": int(memory),
            }
        )
    return {
        "substeps_per_frame": {row["name"]: row["substeps_per_frame"] for row in rows},
        "estimated_seconds": sum(row["seconds"] for row in rows),
        "estimated_bytes": sum(row["disk_bytes"] for row in rows),
        "estimated_memory_bytes": int(memory),
        "first_contact_frame": _first_contact(plan),
        "per_material": rows,
    }


def _first_contact(plan: Plan) -> int | None:
    """Frames of free fall from rest, sqrt(2 drop / g)."""
    s = plan.settings
    g = -float(np.dot(s.gravity, s.up))
    if g <= 0.0:
        return None
    frame = int(np.ceil(np.sqrt(2.0 * max(0.0, plan.drop) / g) * s.fps / s.time_scale))
    return frame if frame < s.frames else None

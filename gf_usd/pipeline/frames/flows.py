"""The surfaces of flowing bodies, per frame."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from gf_usd.core.frames.frame import Pose, SurfacePose
from gf_usd.core.frames.particles import Particles
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import flowing

NO_VECTORS = np.zeros((0, 3))
NOTHING = SurfacePose(
    points=NO_VECTORS, velocities=NO_VECTORS, normals=NO_VECTORS, colors=NO_VECTORS,
    triangles=np.zeros((0, 3), np.int64),
)  # fmt: skip


class FlowSurfaces:
    """Reconstructs a surface from the particles of each flowing body.

    particles : of the bake, whose colors the surfaces take; materials : per particle index.
        time_scale : simulated seconds per second of playback.
    """

    def __init__(
        self, particles: Particles, materials: Sequence[Material], time_scale: float
    ) -> None:
        self._bodies = flowing(particles, materials)
        self._volumes = np.asarray(particles.V0, np.float64)
        self._colors = np.asarray(particles.color, np.float64)
        self._rate = time_scale

    def poses(self, pose: Pose, without: Collection[int] = ()) -> dict[int, SurfacePose]:
        """The surface of each body at a pose; empty for the bodies of `without`."""
        return {
            body: NOTHING if body in without else self._of(pose, mine)
            for body, mine in self._bodies.items()
        }

    def _of(self, pose: Pose, mine: np.ndarray) -> SurfacePose:
        from gf_usd.physics.output.surface import surface

        values = np.concatenate([pose.v[mine] * self._rate, self._colors[mine]], axis=1)
        found = surface(pose.x[mine], self._volumes[mine], values)
        return SurfacePose(
            points=found.points,
            velocities=found.interpolated[:, :3],
            normals=found.normals,
            colors=found.interpolated[:, 3:],
            triangles=found.triangles,
        )

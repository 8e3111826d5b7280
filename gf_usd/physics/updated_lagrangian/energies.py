"""Energies and health report of a frame of the Updated Lagrangian solver; wave speed under strain.

A plane wave with normal N in the rest body has k = shear + U''(J) J^2 |F^-T N|^2 (see `time_step`),
and its wavelength in the world is 1 / |F^-T N| times that at rest. Its speed in the world is that
of rho c^2 = shear / |F^-T N|^2 + U''(J) J^2, at most

    k = shear s_max^2 + U''(J) J^2,        s_max the largest singular value of F

with rho of the rest body. Stretch therefore shortens the stable step of this solver, and
compression that of the Total Lagrangian solver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints, triple
from gf_usd.core.frames.frame import Health, Pose
from gf_usd.core.frames.settings import Settings
from gf_usd.core.stage import ContactSetup
from gf_usd.physics.time_step import wave_speed

if TYPE_CHECKING:
    from gf_usd.physics.laws.registry import ParticleLaws


def measure(
    particles: Pose,
    strain: tuple[Floats, Floats],
    C: Floats,
    m: Floats,
    h: float,
    settings: Settings,
    *,
    elastic: float,
    contact: float,
    flows: bool = False,
) -> Health:
    """Energies, momenta and stretches in float64; C (N, 3, 3) [1/s], m (N,) [kg], h [m].

    strain : (stretch (N, 3), J (N,)) from `per_particle.strains`.

    A particle has an affine velocity, with the inertia m h^2/4 of quadratic B-splines along each
    axis:

        kinetic = sum m (|v|^2 + h^2/4 |C|^2) / 2
        angular momentum = sum m (x x v + h^2/4 axial(C)),   axial(C)_a = eps_abc C_cb

    Transfers never increase the first, and conserve the second (Jiang et al. 2015).
    """
    x, v = particles.x, particles.v
    stretch, J = strain
    spread = 0.25 * h * h
    datum = settings.floor if settings.floor is not None else 0.0
    height = x - datum * settings.normal
    return Health(
        kinetic=float(0.5 * m @ ((v * v).sum(1) + spread * (C * C).sum((1, 2)))),
        elastic=elastic,
        potential=float(-(m @ (height @ np.asarray(settings.gravity)))),
        contact=contact,
        mass=float(m.sum()),
        center=triple(m @ x / m.sum()),
        momentum=triple(m @ v),
        angular_momentum=triple(m @ (np.cross(x, v) + spread * axial(C))),
        min_J=float(J.min()),
        max_J=float(J.max()),
        min_stretch=float(stretch.min()),
        max_stretch=float(stretch.max()),
        inverted=int((J <= 0.0).sum()),
        plastic_dissipation=0.0 if flows else None,
    )


def axial(C: Floats) -> Floats:
    """eps_abc C_cb (N, 3) of C (N, 3, 3)."""
    return np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], -1)


class Losses:
    """Statistics of flowing particles: lost ones, and the density of the others.

    A particle is lost where it is more than a cell below the floor, or, without a floor, below the
    lowest point that any obstacle reaches.

    setup : contact with obstacles; h : [m] edge of a cell; flowing : (N,) which particles flow.
    """

    def __init__(
        self, settings: Settings, setup: ContactSetup | None, h: float, flowing: NDArray[np.bool_]
    ) -> None:
        self._flowing, self._h = flowing, h
        self._up = settings.normal
        self._level = None if settings.floor is None else settings.floor - h
        if settings.floor is None and setup and any(settings.gravity):
            gravity = np.asarray(settings.gravity, float)
            self._up = -gravity / np.linalg.norm(gravity)
            self._level = setup.bottom(self._up)

    def measured(self, pose: Pose, m: Floats, V0: Floats, J: Floats) -> dict[str, Any]:
        """The fields of `Health` on flowing particles, from `lost` to `flow_per_cell`; J (N,) of
        F_e.
        """
        if not self._flowing.any():
            return {}
        lost = np.zeros(len(pose.x), bool)
        if self._level is not None:
            lost = self._flowing & (pose.x @ self._up < self._level)
        kept = self._flowing & ~lost
        volume = float(V0[kept] @ J[kept] / V0[kept].sum()) if kept.any() else None
        kinetic = float(0.5 * m[lost] @ (pose.v[lost] ** 2).sum(1))
        cells = _cells(pose.x[kept], self._h)
        return {
            "lost": int(lost.sum()),
            "fallen_kinetic": kinetic,
            "flow_volume": volume,
            "flow_per_cell": int(kept.sum()) / cells if cells else None,
        }


def _cells(x: Floats, h: float) -> int:
    """Number of cells of edge h [m] that contain a point of x (n, 3) [m]."""
    if len(x) == 0:
        return 0
    at = np.floor(x / h)
    at -= at.min(0)
    wide = at.max(0) + 1.0
    # one key per cell, which sorts faster than three indices; exact in float64 up to 2^53 cells
    return len(np.unique((at[:, 0] * wide[1] + at[:, 1]) * wide[2] + at[:, 2]))


def world_stiffness(law: ParticleLaws, stretch: Floats, J: Floats) -> Floats:
    """k (N,) [Pa] of elastic stretches (N, 3), ascending, and J (N,)."""
    shear, bulk = law.moduli(stretch, J)
    return shear * stretch[:, 2] ** 2 + np.maximum(bulk, 0.0) * J**2


def cells_now(cells: Floats) -> tuple[Ints, Ints]:
    """Particles sorted by cell, and the start of each cell's range, with the end.

    cells : (N, 3) positions in units of cells; nodes are at integers.
    """
    base = np.floor(cells - 0.5).astype(np.int64)
    base -= base.min(0)
    dims = base.max(0) + 1
    key = (base[:, 0] * dims[1] + base[:, 1]) * dims[2] + base[:, 2]
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return order, np.append(first, len(key))


def strained_speed(k: Floats, density: Floats, cells: Floats) -> float:
    """Largest over cells of sqrt(mean k / mean density) [m/s]."""
    return wave_speed(k, density, *cells_now(cells))

"""What a frame of the Updated Lagrangian solver says of its own health."""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats, Health, Pose, Settings


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
) -> Health:
    """Energies, momenta and stretches in float64; C (N, 3, 3) [1/s], m (N,) [kg], h [m].

    strain : (stretch (N, 3), J (N,)) from `stretches.strains`.

    A particle holds an affine motion, of inertia m h^2/4 in every direction (the B-splines' own):

        kinetic = sum m (|v|^2 + h^2/4 |C|^2) / 2
        angular momentum = sum m (x x v + h^2/4 axial(C)),   axial(C)_a = eps_abc C_cb

    the first of which transfers only lessen, and the second of which they keep.
    """
    x, v = particles.x, particles.v
    stretch, J = strain
    spread = 0.25 * h * h
    axial = np.stack(
        [C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], -1
    )
    datum = settings.floor if settings.floor is not None else 0.0
    height = x - datum * settings.normal
    return Health(
        kinetic=float(0.5 * m @ ((v * v).sum(1) + spread * (C * C).sum((1, 2)))),
        elastic=elastic,
        potential=float(-(m @ (height @ np.asarray(settings.gravity)))),
        contact=contact,
        mass=float(m.sum()),
        centre=_triple(m @ x / m.sum()),
        momentum=_triple(m @ v),
        angular_momentum=_triple(m @ (np.cross(x, v) + spread * axial)),
        min_J=float(J.min()),
        max_J=float(J.max()),
        min_stretch=float(stretch.min()),
        max_stretch=float(stretch.max()),
        inverted=int((J <= 0.0).sum()),
    )


def _triple(a: Floats) -> tuple[float, float, float]:
    return (float(a[0]), float(a[1]), float(a[2]))

"""Attachments of the written tetrahedra to pins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gf_usd.core.frames.particles import Particles, TetAttachment, TetLattice
from gf_usd.core.stage import Pin


def tet_attachments(
    pins: Sequence[Pin], tets: Sequence[TetLattice], particles: Particles
) -> tuple[TetAttachment, ...]:
    """The tetrahedron points of each body that a pin prescribes along all axes.

    These are the nodes whose motion the solver is given. Rigid regions that move under the forces
    on them prescribe nothing. The core of a bone, which is part of `--flesh`, is not a region that
    `--pin` can name.
    """
    from gf_usd.physics.grid.pins import pinned_by, prescribed_nearby

    found: list[TetAttachment] = []
    for one in tets:
        body = np.full(len(one.X), one.body)
        held = pinned_by(pins, one.X, body)
        axes = prescribed_nearby(pins, held, one.X, 2.0 * particles.lattice, body).axes
        names = dict.fromkeys(pin.name for pin in pins if pin.sharp and not pin.rigid)
        for name in names:
            mine = [k for k, pin in enumerate(pins) if pin.name == name and all(pin.axes)]
            points = np.flatnonzero(np.isin(axes, mine).all(1))
            if not len(points):
                continue
            paths = [pins[k].path for k in mine]
            length = max(len(path) for path in paths)
            whole = [np.broadcast_to(path, (length, *path.shape[1:])) for path in paths]
            found.append(
                TetAttachment(
                    pin=name, body=one.body, points=points, path=np.concatenate(whole, axis=1)
                )
            )
    return tuple(found)

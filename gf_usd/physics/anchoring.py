"""The constants of nodes that follow a pin, as they stand on a solver's device."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gf_usd.model import Floats
from gf_usd.physics import host

if TYPE_CHECKING:
    from gf_usd.physics.solver import TotalLagrangian
    from gf_usd.physics.stencil import Stencil


def constants(solver: TotalLagrangian) -> tuple[Floats, Floats]:
    """c (followers, 3) [m] of the followers now, and its rate [m/s]."""
    anchor, rate = (host.values(solver.arrays[name]) for name in ("anchor", "anchor_rate"))
    return of_followers(solver.stencil, anchor, rate)


def of_followers(stencil: Stencil, anchor: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """The kernels' arrays as c and its rate, (followers, 3): they are never empty."""
    count = stencil.node_count - stencil.free_count
    c, c_rate = (a.astype(float).reshape(-1, 3)[:count] for a in (anchor, rate))
    return c, c_rate


def node_motion(solver: TotalLagrangian) -> tuple[Floats, Floats]:
    """u and v as `Rows` stack them: with pins, the followers' constants too."""
    return solver.moment().nodes


def anchor(solver: TotalLagrangian, index: int) -> None:
    """Set the constants of held nodes for the way from frame `index` - 1 to `index`."""
    host.clear(solver.arrays["work"])
    if solver.holder is None or not solver.holder.moving:
        return
    free, nodes = solver.stencil.free_count, solver.stencil
    start, end = (
        solver.holder.constants(
            nodes.held.pin[free:], nodes.node_X[free:], nodes.mirror[free:], frame
        )
        for frame in (index - 1, index)
    )
    host.put(solver.arrays["anchor"], start.astype(solver.real).ravel())
    rate = (end - start) / solver.frame_time
    host.put(solver.arrays["anchor_rate"], rate.astype(solver.real).ravel())

"""The registry of solvers by name; all implement `frame_loop.Solver`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import MIXED, Settings
from gf_usd.physics.frame_loop import Solver


def _total_lagrangian() -> type[Solver]:
    from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

    return TotalLagrangian


def _updated_lagrangian() -> type[Solver]:
    from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian

    return UpdatedLagrangian


def _coupled() -> type[Solver]:
    from gf_usd.physics.coupled.solver import Coupled

    return Coupled


def _converting() -> type[Solver]:
    from gf_usd.physics.coupled.handover import Converting

    return Converting


# One row per solver; its module is imported on use.
SOLVERS: dict[str, Callable[[], type[Solver]]] = {
    "tl": _total_lagrangian,
    "ul": _updated_lagrangian,
}


def make_solver(settings: Settings, particles: Any, materials: Any, **more: Any) -> Solver:
    """The solver of `settings.solver`; `more` : arguments as for `TotalLagrangian`.

    MIXED is not a name for users: it is chosen by the materials.

    Raises UsageError for a name that is not in SOLVERS, or options that the solver does not
    support.
    """
    if settings.solver == MIXED:
        both: Any = _converting() if particles.conversions else _coupled()
        return both(particles, materials, settings, **more)
    if settings.solver not in SOLVERS:
        raise UsageError(f"unknown solver {settings.solver!r}", f"choose {' or '.join(SOLVERS)}")
    solver: Any = SOLVERS[settings.solver]()
    return solver(particles, materials, settings, **more)

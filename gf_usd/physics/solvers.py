"""The solvers by their names, all behind `frame_loop.Solver`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gf_usd.core.errors import UsageError
from gf_usd.core.frames import MIXED, Settings
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


# One row makes a solver; its file is imported when it is asked for.
SOLVERS: dict[str, Callable[[], type[Solver]]] = {
    "tl": _total_lagrangian,
    "ul": _updated_lagrangian,
}


def make_solver(settings: Settings, particles: Any, materials: Any, **more: Any) -> Solver:
    """The solver that `settings.solver` names; `more` as for `TotalLagrangian`.

    MIXED is no name that is asked for: it follows from the materials.

    Raises UsageError for a name that is not in SOLVERS, or what the solver named does not know.
    """
    if settings.solver == MIXED:
        both: Any = _converting() if particles.conversions else _coupled()
        return both(particles, materials, settings, **more)
    if settings.solver not in SOLVERS:
        raise UsageError(f"unknown solver {settings.solver!r}", f"choose {' or '.join(SOLVERS)}")
    solver: Any = SOLVERS[settings.solver]()
    return solver(particles, materials, settings, **more)

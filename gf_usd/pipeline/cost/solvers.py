"""The solvers of a bake, and what they know of its substeps before it begins."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gf_usd.prepare.plan import Variant
from gf_usd.system.taichi_runtime import epoch

if TYPE_CHECKING:
    from gf_usd.physics.frame_loop import Solver
    from gf_usd.physics.time_step import StableStep


KEPT = 200_000  # particles of all solvers that are kept until their bake, at 4 kB each
# Of the substeps that contact adds while all neighbors touch, those that it adds in the mean: 0.66
# to 0.71 of gears and of a pot with its lid (docs/performance.md, Bodies next to each other).
TOUCH = 0.7


@dataclass(frozen=True, kw_only=True)
class Demand:
    """What determines the substeps of a bake; factors are relative to `substeps`."""

    substeps: int  # of a sample, at rest
    damping: float = 0.0  # ratio that the material gives the stiffest vibration of the grid
    contact: float = 1.0  # substeps with contact springs over those that the body needs without
    touching: float = 1.0  # factor while bodies touch all that they face at the start
    crowded: float = math.inf  # the largest factor of contact between bodies; inf: unknown
    step: StableStep | None = None  # at rest; None: unknown

    @classmethod
    def of(cls, solver: Solver) -> Demand:
        """That of a solver in its initial state, which stays as it is."""
        from gf_usd.pipeline.cost.neighbors import contact_factors, step_of

        touching, crowded = contact_factors(solver)
        return cls(
            substeps=solver.substeps, damping=solver.damping_ratio, contact=solver.contact_factor,
            touching=touching, crowded=crowded, step=step_of(solver),
        )  # fmt: skip

    def expected(self, meets: float, folds: float) -> float:
        """Mean factor of contact between bodies.

        meets : of bodies that come from far away; folds : of those that fall on their own limbs.
        """
        near = 1.0 + TOUCH * (self.touching - 1.0)
        return min(max(near if near > 1.0 else meets, folds), max(1.0, self.crowded))

    @property
    def most(self) -> float:
        """The largest mean factor of contact between bodies; 1 where it is unknown."""
        return 1.0 + TOUCH * (self.crowded - 1.0) if self.crowded < math.inf else 1.0


class Solvers:
    """The solvers of a bake's variants, each built once.

    Building a solver is expensive, and only the solver has the number of substeps per frame. The
    solver that is built for the estimate is therefore also used for the bake.

    build : makes the solver of a variant, in its initial state.
    particles : of each variant; keep : small solvers are kept for `take`.
    demands : those that are known, by the name of the variant.
    """

    def __init__(
        self,
        build: Callable[[Variant], Solver],
        particles: int,
        *,
        keep: bool = True,
        demands: Mapping[str, Demand] | None = None,
    ) -> None:
        self._build, self._particles, self._keep = build, particles, keep
        self._demands = dict(demands or {})
        self._kept: dict[str, tuple[Solver, int]] = {}  # with the epoch of Taichi

    def demand(self, variant: Variant) -> Demand:
        """What determines the substeps of a variant."""
        if variant.name not in self._demands:
            solver = self._build(variant)
            if self._keep and self._particles * (1 + len(self._demands)) <= KEPT:
                self._kept[variant.name] = solver, epoch()
            self._demands[variant.name] = Demand.of(solver)
        return self._demands[variant.name]

    def of_length(self, build: Callable[[Variant], Solver]) -> Solvers:
        """The solvers of the same bake with fewer frames, of the same demand.

        With animated moduli the demand is that of the stiffest frame, which may be a later one.
        """
        return Solvers(build, self._particles, keep=self._keep, demands=self._demands)

    def substeps(self, variant: Variant) -> int:
        """Substeps of a sample."""
        return self.demand(variant).substeps

    def take(self, variant: Variant) -> Solver:
        """A solver in its initial state, which the caller may advance."""
        solver, made = self._kept.pop(variant.name, (None, 0))
        if solver is not None and made == epoch():
            return solver
        return self._build(variant)

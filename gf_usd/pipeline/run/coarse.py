"""Runs of a variant at lower resolutions, and the certificate that is made from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gf_usd.pipeline.cost.forecast import CERTIFYING, Stages
from gf_usd.pipeline.measures.certify import Certificate, certify, coarser_runs
from gf_usd.pipeline.measures.observe import Observed
from gf_usd.pipeline.prepared import Prepared, has_driven_motion, solver_of
from gf_usd.pipeline.run.parts import observer_of, rest_of
from gf_usd.prepare.plan import Plan


@dataclass(frozen=True, kw_only=True)
class CoarseRuns:
    """Runs of a variant at lower resolutions; () without --certify."""

    runs: tuple[Observed, ...] = ()
    reason: str = ""  # why they cannot be used; "" where they can

    def certificate(self, plan: Plan, fine: Observed) -> Certificate:
        """The certificate of the run at full resolution."""
        return certify(
            (fine, *self.runs), held=has_driven_motion(plan) or bool(plan.goals),
            single=plan.bodies is None or plan.bodies.count == 1, reason=self.reason,
        )  # fmt: skip


def run_coarser(prepared: Prepared, number: int, stages: Stages) -> CoarseRuns:
    """Run a variant at lower resolutions, without writing files."""
    plan, refill = prepared.plan, prepared.refill
    if refill is None:
        return CoarseRuns()

    def run(spacing: float) -> tuple[Observed, float]:
        # other settings that depend on the spacing, such as the number of frames, are kept
        coarse = replace(refill(spacing), settings=plan.settings, each=plan.each)
        variant = coarse.variants[number]
        observer = observer_of(coarse, variant)
        solver = solver_of(coarse, variant)
        rest = rest_of(plan)
        for frame in solver.frames():
            observer.add_frame(frame, frame.embedded)
            if rest.reached(frame.health, frame.index) and (
                plan.choices.until_rest or plan.choices.settled
            ):
                break
        return observer.observed(), coarse.particles.volume

    stages.begin(CERTIFYING, plan.variants[number].name)
    runs, reason = coarser_runs(plan.particles.lattice, plan.particles.volume, run)
    return CoarseRuns(runs=runs, reason=reason)

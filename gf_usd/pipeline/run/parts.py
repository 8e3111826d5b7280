"""Makes the objects with which one variant of a plan is simulated, measured and written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.frames.frame import BakeInfo
from gf_usd.core.frames.settings import sampled
from gf_usd.pipeline.checkpoint import Checkpoint
from gf_usd.pipeline.cost.budget import ResourceGuard, reserve
from gf_usd.pipeline.frames.builder import FrameBuilder
from gf_usd.pipeline.frames.captured import SplatDeformer
from gf_usd.pipeline.frames.flows import FlowSurfaces
from gf_usd.pipeline.frames.period import Period
from gf_usd.pipeline.health.log import HealthLog
from gf_usd.pipeline.measures.observe import Observer
from gf_usd.pipeline.measures.rest import Rest
from gf_usd.pipeline.prepared import has_driven_motion
from gf_usd.prepare.outputs.outputs import RESUME
from gf_usd.prepare.plan import Plan, Variant, input_hash

if TYPE_CHECKING:
    from gf_usd.physics.frame_loop import Solver


def folder(plan: Plan) -> Path:
    """The folder of the results."""
    return plan.outputs.root.absolute().parent


def resume_hint(plan: Plan) -> str:
    """Text: how to continue a bake that ended early."""
    return RESUME if plan.choices.clip_frames else "bake again"


def bake_info(plan: Plan, variant: Variant) -> BakeInfo:
    """What the layers of a variant record of its bake."""
    return BakeInfo(
        look=variant.name,
        materials=variant.table,
        settings=variant.settings,
        command=plan.command,
        version=plan.version,
        input_hash=input_hash(plan.asset.facts.path),
        colliders={file: input_hash(file) for file in plan.collider_files},
    )


def health_log(plan: Plan, since: Checkpoint | None) -> HealthLog:
    """The health log of a variant, continued from its checkpoint."""
    log = HealthLog(
        plan.settings,
        spacing=plan.particles.spacing,
        drop=plan.drop,
        radius=plan.particles.radius,
        particles=len(plan.particles),
        held=has_driven_motion(plan),
        bodies=plan.bodies.count if plan.bodies else 1,
        obstacles=bool(plan.contact_setup and plan.contact_setup.colliders),
        flesh=plan.has_flesh,
    )
    if since is not None:
        log.load(since.log)
    return log


def period_of(plan: Plan, variant: Variant, since: Checkpoint | None) -> Period:
    """The comparison of cycles of a variant, continued from its checkpoint."""
    period = Period(
        plan.cycle * plan.settings.samples_per_frame, plan.repeats,
        sampled(variant.settings).first, plan.particles.radius, until=plan.until_periodic,
    )  # fmt: skip
    if since is not None:
        period.load(since.track)
    return period


def rest_of(plan: Plan) -> Rest:
    """The detector of rest, which accounts for moving obstacles."""
    settings, setup = sampled(plan.settings), plan.contact_setup
    obstacles = setup.colliders if setup else ()
    moving_frames = max((one.still_from for one in obstacles), default=0)
    return Rest(settings.frame_time, plan.particles.radius, moving_frames)


def end_of(plan: Plan, since: Checkpoint | None) -> Rest | None:
    """The detector of rest of a bake that ends at rest, continued from its checkpoint; None: the
    bake has a fixed length.
    """
    if not (plan.choices.settled or plan.choices.until_rest):
        return None
    rest = rest_of(plan)
    if since is not None:
        rest.still = float(since.log["still"])
    return rest


def resource_guard(plan: Plan) -> ResourceGuard:
    """The guard of the disk and the memory."""
    return ResourceGuard(
        folder(plan),
        plan.frame_bytes / plan.settings.samples_per_frame,
        reserve(plan.settings.frames),
        resume_hint(plan),
    )


def observer_of(plan: Plan, variant: Variant) -> Observer:
    """The observer of a variant's frames."""
    carried = {path for path, _ in plan.embedded}
    paths = [s.path for s in plan.asset.surfaces if s.path not in carried]
    return Observer(plan.particles, sampled(variant.settings), paths)


def splat_deformer(plan: Plan, variant: Variant) -> SplatDeformer:
    """The captured Gaussians of a plan, in their initial state."""
    surfaces = [s for s in plan.asset.surfaces if s.path in plan.points]
    return SplatDeformer(
        {s.path: s.splats for s in surfaces if s.splats is not None},
        plan.source,
        variant.settings,
        plan.asset.facts,
        plan.particles,
        variant.sequences,
    )


def frame_builder(
    plan: Plan,
    variant: Variant,
    solver: Solver,
    splats: SplatDeformer,
    observer: Observer | None = None,
) -> FrameBuilder:
    """The frame builder of a variant and its solver; an observer receives the frames."""
    from gf_usd.geometry.skinning import MeshSkin
    from gf_usd.physics.output.gaussians import GaussianTrack

    track = GaussianTrack(plan.particles.orientation, plan.particles.scale)
    skin = None
    if plan.points and plan.settings.skin != "embed":
        skin = MeshSkin(plan.settings.skin, plan.points, plan.particles.X)
    surfaces = [s for s in plan.asset.surfaces if plan.choices.drawn(s.path)]
    keys = [tets.key for tets in plan.tets]
    flows = None
    if plan.choices.flows:
        flows = FlowSurfaces(plan.particles, variant.table, variant.settings.time_scale)
    return FrameBuilder(
        solver, track, skin, surfaces, sampled(variant.settings), splats, keys, observer, flows,
        dict(plan.choices.converting),
        bodies=plan.bodies.surfaces if plan.bodies else (),
        sheets=plan.sheets,
        shapes=plan.shapes,
        open_end=plan.choices.until_rest or plan.choices.settled,
    )  # fmt: skip

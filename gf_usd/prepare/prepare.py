"""Reads, checks and fills an asset, before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core import USD_SUFFIXES
from gf_usd.core.asset import ASSUMED, Asset
from gf_usd.core.errors import InputError
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import unbounded
from gf_usd.core.mesh.subdivision import EDGE
from gf_usd.core.stage import StageSpec
from gf_usd.core.units import check_unit
from gf_usd.prepare.advice import Auto
from gf_usd.prepare.advice.advise import Draw, advise
from gf_usd.prepare.asset_size import implausible_size
from gf_usd.prepare.bodies.contact import file_obstacles
from gf_usd.prepare.fill.fill import fill
from gf_usd.prepare.fill.inputs import Progress, silent
from gf_usd.prepare.fill.neighbors import Around, neighbor_notes, with_neighbors
from gf_usd.prepare.materials.table import Authored, variant_name
from gf_usd.prepare.options.parse import DEFAULT_MATERIAL, material_names, parse_request
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.table import PLANNED
from gf_usd.prepare.options.texts import AUTO
from gf_usd.prepare.outputs.outputs import Outputs, require_no_input_of_bake
from gf_usd.prepare.outputs.targets import files_read, targets_of, with_layer
from gf_usd.prepare.plan import Plan, command_line
from gf_usd.prepare.settings import DEFAULT_PARTICLES
from gf_usd.readers.inputs import require_packable
from gf_usd.readers.isolated import Reading, Source
from gf_usd.readers.usd_bake.spec import read_stage_spec
from gf_usd.system.atomic_files import require_utf8
from gf_usd.system.sandbox import Limits
from gf_usd.system.taichi_runtime import init_taichi, kernel_cache_notes

if TYPE_CHECKING:
    from gf_usd.geometry.diagnosis import Diagnosis
    from gf_usd.geometry.solid import Solid
    from gf_usd.geometry.thin.parts import Part
    from gf_usd.readers.mesh.to_usd import MeshSource


# Times the particles of a bake with --flesh, beyond which none are suggested for small parts, such
# as eyes: flesh around bones moves as it should with fewer.
MOST_FOR_PARTS = 4
# Fills an asset that was read once more, with particles at another spacing [m].
Refill = Callable[[float], Plan]


def prepare(
    path: str | Path,
    *,
    material: str | tuple[str | Material, ...] | None = None,
    output: str | Path | None = None,
    law: str | None = None,
    prims: Sequence[str] = (),
    overwrite: bool = False,
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    repair: bool = False,
    resume: bool = False,
    limits: Limits | None = None,
    draw: Draw,
    progress: Progress = silent,
    once_filled: Callable[[Refill], None] | None = None,
    **options: Any,
) -> tuple[Plan, MeshSource | None]:
    """Read, check and fill an asset; nothing is written.  See `bake` for the parameters.

    draw : makes the picture of the asset for an advisor.
    progress : called with each step once the file is read; see `fill`.
    once_filled : called with a function that fills the same asset at a lower resolution.

    Returns the plan, and the layer of an asset that is not USD, which is in a temporary folder that
    exists as long as the object.
    """
    from gf_usd.system import usd_schema

    usd_schema.require_registered()
    check_unit(meters_per_unit)
    request, presets = parse_request(material, law, options)
    source = Path(path)
    require_utf8(source)
    target = None if output is None else str(output)
    divided = request.max_edge_length is not None  # the layer is that of this bake alone
    folders = {name: request.folder(f"export_{name}") for name in ("ply", "spz")}
    written = partial(
        targets_of, source, target=target, flatten=request.flatten, divided=divided,
        overwrite=overwrite, resume=resume, **folders,
    )  # fmt: skip
    # existing results are found before the asset is read, where their names are known
    targets = written(presets=presets) if presets else None
    given = AssetFile(
        path=source, limits=limits, request=request, presets=presets, prims=prims,
        meters_per_unit=meters_per_unit, up_axis=up_axis,
    )  # fmt: skip
    with given.reading() as read:
        # In parallel; a device that is not there is found out before the file is judged.
        init_taichi(request.device, request.threads)
        found = given.asset(read.result(), draw)
    progress("")
    targets = targets or written(presets=found.presets)
    files, seen_source = with_layer(targets, found.converted, shared=not divided)
    if any(file.exists() for file in files.all):
        require_no_input_of_bake(files, files_read(source, material, request.listed("colliders")))
    if files.is_package:
        require_packable(found.file, source)
    asset = found.asset
    plan, solid = fill_found(
        found, request, law, files, given.around(found), repair=repair, progress=progress
    )
    if request.flesh:
        _require_named(plan, prims)
    if once_filled:

        def refill(spacing: float) -> Plan:
            coarse = replace(request, particles=None, spacing=spacing / asset.facts.units.length)
            # the solid that is given has only the meshes of the plan
            return fill(
                asset if repair else plan.asset, coarse, found.presets, law, files, found.file,
                spec=found.spec, repair=repair, built=None if repair else solid,
            )[0]  # fmt: skip

        once_filled(refill)
    lists = {name: getattr(request, name) for name, row in PLANNED.items() if row.repeated}
    command = command_line(
        source, material=material_names(material), law=law, meters_per_unit=meters_per_unit,
        up_axis=up_axis, repair=repair, **{k: v for k, v in options.items() if k not in lists},
        prims=tuple(prims), **lists,
    )  # fmt: skip
    odd = implausible_size(plan.asset)
    plan = replace(
        plan, command=command, collider_files=tuple(map(Path, request.listed("colliders"))),
        notes=(
            *plan.notes, *_poorly_filled(plan, solid), *filter(None, (odd, plan.heavy)),
            *kernel_cache_notes(),
        ),
        odd=odd if asset.facts.unit_from == ASSUMED else "",
        sequences=targets.sequences, seen=targets.seen, seen_source=seen_source,
    )  # fmt: skip
    return plan, found.converted


def _require_named(plan: Plan, prims: Sequence[str]) -> None:
    """Raise InputError where a mesh that was named with --prim is not baked."""
    reasons = dict(plan.asset.skipped)
    for path in prims:
        if path in reasons:
            raise InputError(
                f"{plan.asset.facts.path}: --prim {path} --flesh: it cannot be baked:"
                f" {reasons[path]}",
                "bind it to the skeleton, or, where there is none, animate it; bake it without"
                " --flesh; or omit this --prim, and it stays as it is in the stage",
            )


def _poorly_filled(plan: Plan, solid: Solid) -> tuple[str, ...]:
    """Notes on parts with too few particles, as `inspect` names them."""
    from gf_usd.geometry.thin.advice import poor_note, specks_note

    # faults of meshes cause thin parts where they remove much of the volume
    if plan.lost:
        return ()
    parts = poor_parts_of(plan, solid)
    solid.release()
    return tuple(filter(None, (poor_note(parts, len(plan.particles)), specks_note(parts))))


def poor_parts_of(plan: Plan, solid: Solid) -> tuple[Part, ...]:
    """The parts of a plan with too few particles, except those that are never too stiff.

    These flow without limit, or do not deform: all points of their surface are in regions that are
    rigid or pinned along all axes.
    """
    from gf_usd.geometry.thin.parts import poor_parts

    flows = _flowing_surfaces(plan, solid)
    if flows.all():
        return ()
    found = poor_parts(solid, plan.particles, plan.samples)
    parts = tuple(part for part in found if not flows[solid.filled[part.path]])
    if plan.has_flesh:
        parts = _without_excessive(parts, MOST_FOR_PARTS * len(plan.particles))
    pins = [pin for pin in plan.pins if all(pin.axes)]
    if not parts or not pins:
        return parts
    counts = [len(part.rays[0]) for part in parts]
    # a mesh holds what is inside it, a part of a surface what is on it
    X, above, below = np.concatenate([np.stack([p.rays[0], *p.sides]) for p in parts], axis=1)
    body = None
    if plan.bodies:
        body = np.repeat([plan.bodies.of_surface[solid.filled[p.path]] for p in parts], counts)
    held = np.any([pin.holds(at, body) for pin in pins for at in (X, above, below)], axis=0)
    every = np.logical_and.reduceat(held, np.cumsum([0, *counts[:-1]]))
    return tuple(parts[k] for k in np.flatnonzero(~every))


def _without_excessive(parts: Sequence[Part], most: int) -> tuple[Part, ...]:
    """The parts, without a suggestion of more than `most` particles."""
    return tuple(
        replace(part, suggested=None) if (part.suggested or 0) > most else part for part in parts
    )


def _flowing_surfaces(plan: Plan, solid: Solid) -> NDArray[np.bool_]:
    """(S,) filled surfaces all of whose particles, or all of their body where they have none, flow
    without limit in every variant.
    """
    particles = plan.particles
    stays = ~np.all([unbounded(particles, one.table) for one in plan.variants], axis=0)
    count = len(solid.surfaces)
    inside, solids = (np.bincount(particles.surface, w, count) for w in (None, stays))
    of = plan.bodies.of_surface if plan.bodies else np.zeros(count, int)
    body = np.bincount(particles.body_of, stays, minlength=of.max() + 1)[of]
    return np.where(inside > 0, solids, body) == 0


@dataclass(frozen=True, kw_only=True)
class SourceAsset:
    """An asset with its specification and presets."""

    asset: Asset
    spec: StageSpec  # what its stage specifies
    presets: Sequence[Any]  # one for each variant
    file: Path  # its USD form
    converted: MeshSource | None  # of an asset that is not USD, or whose faces were divided


@dataclass(frozen=True, kw_only=True)
class AssetFile:
    """The file of an asset, and how it is read for a bake."""

    path: Path
    limits: Limits | None
    request: Request
    presets: Sequence[Any]  # of the options; none: the materials of the stage, or rubber
    prims: Sequence[str]
    meters_per_unit: float | None
    up_axis: str | None

    @property
    def is_usd(self) -> bool:
        return self.path.suffix.lower() in USD_SUFFIXES

    @property
    def elastic(self) -> bool:
        """Whether the material specifications of the stage are used."""
        return not self.presets or isinstance(self.presets[0], Auto)

    def reading(self) -> Reading:
        """Start to read the file."""
        request = self.request
        longest, count = request.parsed["max_edge_length"], None
        if longest == AUTO:
            longest = EDGE * request.spacing if request.spacing else None
            count = None if longest else request.particles or DEFAULT_PARTICLES
        return Reading(
            self.path, self.limits, prims=tuple(self.prims),
            meters_per_unit=self.meters_per_unit, up_axis=self.up_axis,
            time_code=request.start, elastic=self.elastic, bind_pose=request.flesh,
            fps=request.fps, max_edge_length=longest, edges_for=count,
        )  # fmt: skip

    def asset(self, read: Source, draw: Draw) -> SourceAsset:
        """The asset, its stage's specification, and the presets of the bake.

        draw : makes the picture of the asset for an advisor.

        Raises InputError for the result of a bake.
        """
        read.asset.facts.require_not_baked()
        asset, spec, converted = _with_hulls(read.asset), read.spec, read.converted
        rest, presets = self.request.start, self.presets
        file = self.path if converted is None else converted.layer
        if spec is None:
            spec = StageSpec()
            if self.is_usd:
                asset, spec = read_stage_spec(
                    asset, file, self.prims, rest=rest, elastic=self.elastic
                )
        if presets and isinstance(presets[0], Auto):
            spec = advise(asset, self.path, spec, presets[0], usd=self.is_usd, rest=rest, draw=draw)
            presets = [Authored(presets[0].name)]
        elif not presets:
            named = variant_name(spec, asset.surfaces) if spec.says_material else DEFAULT_MATERIAL
            presets = [Authored(named)]
        colliders = self.request.listed("colliders")
        of_files, notes = file_obstacles(colliders, asset.facts, self.limits)
        physics = replace(spec.physics, of_files=of_files, notes=(*spec.physics.notes, *notes))
        spec = replace(spec, physics=physics)
        return SourceAsset(asset=asset, spec=spec, presets=presets, converted=converted, file=file)

    def around(self, found: SourceAsset) -> Around | None:
        """What reads the meshes of a stage around those that were named; None: none were."""
        if not self.prims or self.request.flesh:
            return None
        again = None
        if not self.is_usd and self.request.max_edge_length is not None:
            # its layer has divided faces
            whole = replace(
                self, request=replace(self.request, max_edge_length=None),
                prims=[s.path for s in found.asset.surfaces],
            )  # fmt: skip
            again = whole.reading
        return Around(
            file=self.path if self.is_usd else found.file, usd=self.is_usd, again=again,
            rest=self.request.start, elastic=self.elastic,
        )  # fmt: skip


def _with_hulls(asset: Asset) -> Asset:
    """See `with_hulls`, whose libraries are only imported for captured Gaussians."""
    if not asset.splats:
        return asset
    from gf_usd.geometry.splat_hull import with_hulls

    return with_hulls(asset)


def fill_found(
    found: SourceAsset,
    request: Request,
    law: str | None,
    files: Outputs,
    others: Around | None,
    *,
    repair: bool,
    known: Sequence[Diagnosis] = (),
    progress: Progress = silent,
) -> tuple[Plan, Solid]:
    """A plan for an asset and its solid, see `fill`.

    others : reads the meshes around those that were named.  The refusal and the notes of the plan
        name those that would close them.

    Raises InputError where the asset is refused.
    """
    try:
        plan, solid = fill(
            found.asset, request, found.presets, law, files, found.file, spec=found.spec,
            repair=repair, known=known, progress=progress,
        )  # fmt: skip
    except InputError as refused:
        closed = with_neighbors(refused, found.asset, others) if others else None
        if closed is None:
            raise
        raise closed from refused
    if others:
        plan = replace(plan, notes=(*plan.notes, *neighbor_notes(found.asset, others)))
    return plan, solid

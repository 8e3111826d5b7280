"""Before time is spent: read, check and fill an asset, and say what a bake of it would be."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd import materials as presets
from gf_usd import paper_options
from gf_usd.choices import Choices, clip_length, parse_only
from gf_usd.errors import InputError, UsageError
from gf_usd.estimate import frame_bytes
from gf_usd.model import Asset, Material, Settings, SurfaceSamples
from gf_usd.output_files import Outputs, outputs, require_free, require_source_free
from gf_usd.pinning import make_pins
from gf_usd.plan import Plan, command_line
from gf_usd.planning import DEFAULT_PARTICLES, PAPER_PARTICLES, Request, parse_floor, resolve
from gf_usd.runtime import init_taichi
from gf_usd.timeline import sampled, written

if TYPE_CHECKING:
    from gf_usd.geometry.diagnosis import Diagnosis
    from gf_usd.geometry.solid import Solid
    from gf_usd.inspection import Inspection


def prepare(
    path: str | Path,
    *,
    material: str = "rubber",
    output: str | Path | None = None,
    law: str | None = None,
    prims: Sequence[str] = (),
    overwrite: bool = False,
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    repair: bool = False,
    **options: Any,
) -> Plan:
    """Read, check and fill an asset; nothing is written.  See `bake` for the parameters."""
    request, looks = _asked(material, law, options)
    source = Path(path)
    names = [look.name for look in looks]
    files = outputs(source, names, None if output is None else str(output), request.flatten)
    require_free(files, overwrite)
    # A device that is not there is found out before the asset is read.
    init_taichi(request.device, request.threads)
    from gf_usd.assets import convert, read_asset

    converted = convert(source, meters_per_unit=meters_per_unit, up_axis=up_axis)
    if converted is None:
        asset = read_asset(
            source,
            prims=tuple(prims),
            meters_per_unit=meters_per_unit,
            up_axis=up_axis,
            time_code=request.start,
        )
    else:
        asset = converted.asset(prims=tuple(prims), time_code=request.start)
        target = files.source
        if target is not None:
            files = replace(files, textures=converted.textures(target))
            require_source_free(files, converted.is_at(target), overwrite)
        elif files.root.suffix != ".usdz":
            files = replace(files, textures=converted.textures(files.root))
            require_free(files, overwrite)
    from gf_usd.inspection import implausible_size

    file = source if converted is None else converted.layer
    plan = _fill(asset, request, looks, law, files, file, repair=repair)[0]
    command = command_line(
        source, material=material, law=law, meters_per_unit=meters_per_unit, up_axis=up_axis,
        repair=repair, **{k: v for k, v in options.items() if k != "pins"},
    )  # fmt: skip
    command += "".join(f" --prim {shlex.quote(prim)}" for prim in prims)
    command += "".join(f" --pin {shlex.quote(pin)}" for pin in request.pins)
    odd = implausible_size(asset)
    notes = (*plan.notes, odd) if odd else plan.notes
    return replace(plan, converted=converted, command=command, notes=notes)


def inspect(
    path: str | Path,
    *,
    material: str = "rubber",
    law: str | None = None,
    prims: Sequence[str] = (),
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    repair: bool = False,
    **options: Any,
) -> Inspection:
    """What `bake` would make of an asset with the same parameters, and what is wrong with it.

    A refusal is part of the result (`Inspection.refusal`), where the file could be read at all.

    Raises
    ------
    UsageError : the options make no sense.
    InputError : the file cannot be read, or holds nothing that could be made soft.
    """
    from gf_usd.assets import read_asset
    from gf_usd.estimate import estimate
    from gf_usd.geometry.parts import poor_parts
    from gf_usd.geometry.repair import repair_asset
    from gf_usd.inspection import implausible_size, look_at, lost_volume

    request, looks = _asked(material, law, options)
    source = Path(path)
    asset = read_asset(
        source,
        prims=tuple(prims),
        meters_per_unit=meters_per_unit,
        up_axis=up_axis,
        time_code=request.start,
    )
    seen = look_at(asset, repair_asset(asset)[1] if repair else ())
    files = outputs(source, [look.name for look in looks], None)
    try:
        plan, solid = _fill(
            asset, request, looks, law, files, source, repair=repair, known=seen.diagnoses
        )
    except InputError as refusal:
        warnings = [implausible_size(asset)]
        if not repair and _would_fill(repair_asset(asset)[0]):
            warnings.append("with --repair it can be baked")
        return replace(seen, refusal=refusal, warnings=tuple(w for w in warnings if w))
    seen = replace(seen, plan=plan, cost=estimate(plan))
    lost = lost_volume(seen)
    # Where faults cost much of the fill, thin parts are their echo.
    parts = () if lost else poor_parts(solid, plan.particles, plan.samples)
    warnings = (implausible_size(asset), lost)
    return replace(seen, parts=parts, warnings=tuple(w for w in warnings if w))


def _fill(
    asset: Asset,
    request: Request,
    looks: Sequence[Any],
    law: str | None,
    files: Outputs,
    file: Path,
    *,
    repair: bool,
    known: Sequence[Diagnosis] = (),
) -> tuple[Plan, Solid]:
    """A plan for an asset that was read.  Raises InputError where it is refused.

    file : its USD form.
    known : what `diagnose` said of its surfaces, if it was asked already.
    """
    from gf_usd.geometry.diagnosis import diagnose, tolerated
    from gf_usd.geometry.repair import notes, repair_asset
    from gf_usd.geometry.sampling import sample_solid, sample_surface
    from gf_usd.geometry.skinning import SKIN_NOTES
    from gf_usd.geometry.solid import build_solid

    mended: tuple[str, ...] = ()
    if repair:
        asset, repairs = repair_asset(asset)
        mended = notes(repairs)
    solid = build_solid(asset)
    if not repair:
        by_path = {seen.path: seen for seen in known}
        all_seen = (by_path.get(s.path) or diagnose(s) for s in solid.surfaces)
        mended = tuple(line for seen in all_seen if (line := tolerated(seen)))
    unit = asset.facts.units.length
    default = PAPER_PARTICLES if request.preset == "paper" else DEFAULT_PARTICLES
    particles = sample_solid(
        solid,
        particles=None if request.spacing else (request.particles or default),
        spacing=request.spacing * unit if request.spacing else None,
        seed=request.seed,
        uniform=request.preset == "paper",
    )
    if request.preset == "paper":
        # There every particle feels the floor; a mass of rho * area * spacing is its own.
        samples = SurfaceSamples(X=particles.X, area=particles.V0 / particles.spacing)
    else:
        samples = sample_surface(solid, particles.spacing, request.seed)
    floor, normal = parse_floor(request.floor, asset.facts.up, unit)
    lowest = min(float((s.points @ normal).min()) for s in asset.surfaces)
    settings = resolve(request, asset.facts, particles.radius, lowest)
    gap = float(np.dot(settings.lift, normal)) + lowest - (floor or 0.0)
    pins = make_pins(request.pins, asset, solid, sampled(settings), file, rest=request.start)
    ridden = [f"<{p}> rides along and is not filled: {why}" for p, why in solid.riders]
    left = [f"<{p}> is left as it is: {why}" for p, why in asset.skipped]
    skin = SKIN_NOTES.get(settings.skin, ())
    made = tuple(_made(look, particles.radius, law, request) for look in looks)
    choices, split = _chosen(request, files, settings, asset, len(particles))
    each = tuple(paper_options.of_material(settings, request, m, particles.radius) for m in made)
    plan = Plan(
        asset=asset,
        particles=particles,
        samples=samples,
        materials=made,
        settings=each[0],
        each=each,
        outputs=files,
        riders=solid.riders,
        drop=gap / float(normal @ asset.facts.up),
        pins=pins,
        notes=(*asset.facts.notes, *mended, *ridden, *left, *skin, *_options(made, each), *split),
        choices=choices,
    )
    return plan, solid


def _chosen(
    request: Request, files: Outputs, settings: Settings, asset: Asset, particles: int
) -> tuple[Choices, tuple[str, ...]]:
    """The output choices, with notes on what nobody asked for."""
    if files.flat and request.clip_frames:
        raise UsageError(
            f"--clip-frames {request.clip_frames} and a package were both asked for",
            "a package is one file: leave one of them out",
        )
    choices = Choices(
        shapes=parse_only(request.only), half=request.half, flat=request.flatten or files.flat
    )
    size = frame_bytes(asset, particles, settings, choices)
    length = 0 if choices.flat else clip_length(request.clip_frames, size, written(settings))
    notes = ()
    if length and request.clip_frames is None:
        notes = (
            f"the cache, about {size * written(settings) / 1e9:.1f} GB, is split into value clips"
            f" of {length} frames: --clip-frames 0 keeps it in one file",
        )
    return replace(choices, clip_frames=length), notes


def _options(materials: Sequence[Material], each: Sequence[Settings]) -> tuple[str, ...]:
    """Notes on the paper's options, once where they are the same for all materials."""
    if all(settings == each[0] for settings in each):
        return paper_options.notes(each[0])
    pairs = zip(materials, each)
    return tuple(note for m, s in pairs for note in paper_options.notes(s, m.name))


def _would_fill(asset: Asset) -> bool:
    from gf_usd.geometry.solid import build_solid

    try:
        build_solid(asset)
    except InputError:
        return False
    return True


def _asked(material: str, law: str | None, options: dict[str, Any]) -> tuple[Request, list[Any]]:
    """The request and the materials of a bake, checked before anything is read."""
    known = Request.__dataclass_fields__
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise UsageError(
            f"bake() has no option {unknown[0]!r}", f"its options are {', '.join(sorted(known))}"
        )
    request = Request(**{**options, "pins": tuple(options.get("pins") or ())})
    request.check()
    if law is not None:
        presets.check_law(law)
    from gf_usd.usd import schema  # noqa: F401  (registers itself before any stage opens)

    return request, [_find(name, request) for name in material.split(",")]


def _find(name: str, request: Request) -> Any:
    """A preset, or the material of a file in the clothes of one."""
    from gf_usd.usd.material_file import is_material_file, read_material

    if is_material_file(name):
        return presets.Fixed(read_material(Path(name)))
    look = presets.find_preset(name.strip())
    # The paper has every solid corotated.
    return replace(look, law="corotated") if request.preset == "paper" else look


def _made(look: Any, radius: float, law: str | None, request: Request) -> Material:
    """A material on a body of radius [m], with what the request says in place of its own."""
    own = {
        name: value
        for name in ("damping_time", "friction", "restitution")
        if (value := getattr(request, name)) is not None
    }
    if request.preset == "paper":
        own.setdefault("damping_time", 0.0)  # the paper has none
    return replace(look.material(radius, law), **own)

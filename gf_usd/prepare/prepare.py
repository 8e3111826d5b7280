"""Before time is spent: read, check and fill an asset, and say what a bake of it would be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gf_usd.core import materials
from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError
from gf_usd.core.stage import StageWords
from gf_usd.core.units import check_unit
from gf_usd.prepare import outputs as splat_sequence
from gf_usd.prepare.advice import Auto
from gf_usd.prepare.advice.advise import Draw, advise, parse_auto
from gf_usd.prepare.fill import fill
from gf_usd.prepare.materials import Authored, look_name
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.table import PLANNED
from gf_usd.prepare.outputs import (
    interrupted,
    outputs,
    require_free,
    require_source_free,
    stamp,
    stamps,
)
from gf_usd.prepare.plan import Plan, command_line
from gf_usd.readers.trial import try_asset
from gf_usd.readers.usd_bake.spec import read_words
from gf_usd.system.sandbox import Limits
from gf_usd.system.taichi_runtime import init_taichi


def prepare(
    path: str | Path,
    *,
    material: str | None = None,
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
    **options: Any,
) -> Plan:
    """Read, check and fill an asset; nothing is written.  See `bake` for the parameters.

    draw : makes the picture of the asset that an advisor is shown.
    """
    check_unit(meters_per_unit)
    request, looks = _asked(material, law, options)
    source = Path(path)
    target_name = None if output is None else str(output)

    def frames_of(
        looks: Sequence[Any], overwrite: bool
    ) -> tuple[tuple[splat_sequence.SplatSequence, ...], ...]:
        """The splat files of each look, which must be free."""
        names = [look.name for look in looks]
        asked = splat_sequence.sequences(
            source.stem, names, ply=request.export_ply, spz=request.export_spz
        )
        splat_sequence.require_free_sequences(asked, overwrite)
        return asked

    if looks:
        names = [look.name for look in looks]
        files = outputs(source, names, target_name, request.flatten)
        overwritten = overwrite or (resume and interrupted(files))
        require_free(files, overwritten)
        frames_of(looks, overwritten)
    # It forks, which must be done before Taichi starts its threads.
    _try(source, limits, request, looks, prims, meters_per_unit, up_axis)
    # A device that is not there is found out before the asset is read.
    init_taichi(request.device, request.threads)
    from gf_usd.readers import convert, read_asset

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
    asset = _hulled(asset)
    asset, words, looks = _stage(asset, source, prims, request, looks, converted is None, draw)
    names = [look.name for look in looks]
    files = outputs(source, names, target_name, request.flatten)
    there = stamps(files)
    # what it wrote before it ended was free to be written
    overwrite = overwrite or (resume and interrupted(files))
    require_free(files, overwrite)
    frames = frames_of(looks, overwrite)
    seen_source = None
    if converted is not None:
        target = files.source
        if target is not None:
            files = replace(files, textures=converted.textures(target))
            seen_source = stamp(target)
            require_source_free(files, converted.is_at(target), overwrite)
        elif files.root.suffix != ".usdz":
            files = replace(files, textures=converted.textures(files.root))
            require_free(files, overwrite)
    from gf_usd.prepare.fill import implausible_size

    file = source if converted is None else converted.layer
    plan = fill(asset, request, looks, law, files, file, words=words, repair=repair)[0]
    lists = {name: getattr(request, name) for name, row in PLANNED.items() if row.repeated}
    command = command_line(
        source, material=material, law=law, meters_per_unit=meters_per_unit, up_axis=up_axis,
        repair=repair, **{k: v for k, v in options.items() if k not in lists}, prims=tuple(prims),
        **lists,
    )  # fmt: skip
    odd = implausible_size(asset)
    notes = (*plan.notes, odd) if odd else plan.notes
    return replace(
        plan, converted=converted, command=command, notes=notes, sequences=frames, seen=there,
        seen_source=seen_source,
    )  # fmt: skip


def _stage(
    asset: Asset,
    file: Path,
    prims: Sequence[str],
    request: Request,
    looks: Sequence[Any],
    usd: bool,
    draw: Draw,
) -> tuple[Asset, StageWords, Sequence[Any]]:
    """What is to be soft, what its stage says of that, and the looks that it is baked with.

    usd : the file is a stage, and not a mesh file.
    """
    words = StageWords()
    if usd:
        asset, words = read_words(asset, file, prims, rest=request.start, elastic=_elastic(looks))
    if looks and isinstance(looks[0], Auto):
        words = advise(asset, file, words, looks[0], usd=usd, rest=request.start, draw=draw)
        return asset, words, [Authored(looks[0].name)]
    if looks:
        return asset, words, looks
    if words.says_material:
        return asset, words, [Authored(look_name(words, asset.surfaces))]
    return asset, words, [Authored("rubber")]


def _hulled(asset: Asset) -> Asset:
    """See `with_hulls`, whose libraries only captured Gaussians need."""
    if not asset.splats:
        return asset
    from gf_usd.geometry.splat_hull import with_hulls

    return with_hulls(asset)


def _elastic(looks: Sequence[Any]) -> bool:
    """Whether the stage is asked what its bodies are made of."""
    return not looks or isinstance(looks[0], Auto)


def _try(
    source: Path,
    limits: Limits | None,
    request: Request,
    looks: Sequence[Any],
    prims: Sequence[str],
    meters_per_unit: float | None,
    up_axis: str | None,
) -> None:
    """Read it in a child process first, where limits are given."""
    try_asset(
        source, limits, prims=tuple(prims), meters_per_unit=meters_per_unit, up_axis=up_axis,
        time_code=request.start, elastic=_elastic(looks),
    )  # fmt: skip


def _would_fill(asset: Asset) -> bool:
    from gf_usd.geometry.solid import build_solid

    try:
        build_solid(asset)
    except InputError:
        return False
    return True


def _asked(
    material: str | None, law: str | None, options: dict[str, Any]
) -> tuple[Request, list[Any]]:
    """The request and the looks of a bake, checked before anything is read.

    No look: the stage says what it is made of, or it is rubber.
    """
    request = Request.of(options)
    request.check()
    if law is not None:
        materials.check_law(law)
    from gf_usd.system import usd_schema  # noqa: F401  (registers itself before any stage opens)

    if material is None and request.preset == "paper":
        material = "rubber"
    auto = parse_auto(material, request.preset)
    if auto is not None:
        return request, [auto]
    return request, [_find(name, request) for name in material.split(",")] if material else []


def _find(name: str, request: Request) -> Any:
    """A preset, or the material of a file in the clothes of one."""
    from gf_usd.readers.usd_bake.material_file import is_material_file, read_material

    if is_material_file(name):
        return materials.Fixed(read_material(Path(name)))
    look = materials.find_preset(name.strip())
    # The paper has every solid corotated.
    return replace(look, law="corotated") if request.preset == "paper" else look

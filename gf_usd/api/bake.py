"""`gf_usd.bake`: turns an asset into USD layers with its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.api.call import BAKE, takes
from gf_usd.api.host.guest import run_here_or_separately
from gf_usd.prepare.options.table import MAX_HOURS, BakeOptions

if TYPE_CHECKING:
    from gf_usd.pipeline.health.warnings import HealthWarning
    from gf_usd.pipeline.result import BakeResult


@takes(BakeOptions)
def bake(
    path: Path,
    *,
    strict: bool = False,
    max_hours: float = MAX_HOURS,
    slice: int | None = None,
    until: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> BakeResult:
    """Fill an asset with particles, simulate it and write its layers.

    >>> result = gf_usd.bake("duck.usda", drop=3.0, range=(1, 4), particles=300, overwrite=True)
    >>> result.bakes[0].material.name, result.health["inverted_particle_frames"]
    ('rubber', 0)

    A program that has already opened stages, or that uses Taichi itself, can call it too: the bake
    then runs in a separate process, and a note says so.  What is baked is the file on disk: an
    asset with a layer that has unsaved changes in the program is refused.

    The keywords are the options of ``gf-usd bake``, with underscores.  They take Python values:
    numbers, tuples and lists, `pathlib` paths, `gf_usd.Material` objects, and dicts for regions.
    None is the same as leaving out a keyword.  The asset is never modified.

    Parameters
    ----------
    path : the asset: USD, obj, ply, stl, off, glTF, FBX, or captured Gaussians.
    material : a preset (see `gf_usd.materials`), a USD file with a material, a `gf_usd.Material`,
        or a list of them: variants of one root layer.
    output : root layer, or a folder.
    prims : prim path to bake, or a list of them.
    drop : height of the fall [stage units], or a string in radii of the body: "3r".
    gravity : [m/s^2] downward, or a vector (3,).
    velocity : (3,) [stage units/s] of all bodies at the start; spin : (3,) [degrees/s] about the
        center of each.
    colliders : file whose meshes are obstacles, or a list of them.
    floor : a height [stage units], a normal (3,), (height, normal), or False for none.
    range : (first, last) time code to write; None for an open end.
    pins : prim paths, or boxes of two corners [stage units].
    material_boxes : {preset: (corner, corner)} [stage units].
    material_labels : {property: {value: preset}} of captured Gaussians.
    limits : of the process that reads the asset, {"time": [s], "memory": [B], "output": [B]}; None:
        this process reads it.
    strict : raise UnhealthyError also if the finished bake has warnings.
    max_hours : refuse a bake whose estimate is longer [h], and end one that takes twice as long.
    slice : number of full value clips after which the bake ends, to be resumed later.
    until : bake again, at a higher resolution each time, until the figures of certify are this
        certain: "2%", or "rebound,squash:2%"; within max_hours.
    progress : called after each frame with (frames done, total frames).
    options : all others; docs/guide/options.md lists them.

    Returns
    -------
    BakeResult : the files, the health, the warnings and the notes, which name keywords; those of
        the report on the disk name the options of the command line.

    Raises
    ------
    UsageError : the options make no sense, or the output exists or cannot be written.
    InputError : the asset was refused; nothing was written.
    BakeError : the simulation failed; only ``*.partial.*`` files and the report remain.  If the
        solver failed, it is a SolverError with the frame and the particle.
    Unfinished : the slice is done, and frames remain.
    UnhealthyError : contact created energy, or strict is set and there are warnings; the files are
        written.
    """
    from gf_usd.pipeline.result import require_healthy
    from gf_usd.readers.usd.stage import require_saved

    require_saved(path)
    arguments = {"path": path, "max_hours": max_hours, "slice": slice, "until": until, **options}
    result, why = run_here_or_separately("gf_usd.api.bake:prepare_and_run", arguments, progress)
    if why:
        result = replace(result, notes=(*result.notes, f"baked in a separate process: {why}"))
    result = _in_keywords(result)
    require_healthy(result, strict=strict)
    return result


def _in_keywords(result: BakeResult) -> BakeResult:
    """A result whose notes and warnings name keywords instead of options of the command line."""

    def warning(found: HealthWarning) -> HealthWarning:
        return replace(found, message=BAKE.text(found.message), hint=BAKE.text(found.hint))

    bakes = tuple(replace(b, warnings=tuple(map(warning, b.warnings))) for b in result.bakes)
    return replace(result, bakes=bakes, notes=tuple(map(BAKE.text, result.notes)))


def prepare_and_run(
    path: Path,
    *,
    max_hours: float,
    slice: int | None,
    until: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> BakeResult:
    """See `bake`; in this process."""
    from gf_usd.pipeline.measures.refine import Refining
    from gf_usd.pipeline.prepared import prepare
    from gf_usd.pipeline.run.run import run

    refining = Refining(until, max_hours, options)
    while True:
        prepared = prepare(path, **refining.options)
        result = run(prepared, progress, max_hours=refining.hours, slice=slice)
        if not refining.bake_again(result, prepared.plan.asset.facts.units.length):
            break
    result = replace(result, notes=(*result.notes, *refining.notes))
    if prepared.plan.outputs.sheet:
        from gf_usd.api.drawing.sweep import draw_sweep

        draw_sweep(result, prepared.plan.outputs.sheet)
    return result

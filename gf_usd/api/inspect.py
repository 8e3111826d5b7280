"""`gf_usd.inspect`: reports what a bake would do, and the problems of an asset."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gf_usd.api.call import BAKE, in_python, takes
from gf_usd.api.host.guest import guest, require_this_process
from gf_usd.prepare.options.table import OPTIONS, PROGRESS, BakeOptions

if TYPE_CHECKING:
    from gf_usd.pipeline.inspect import Inspection

# Keywords of a bake that change nothing of what would be filled or what it would cost.
LATER = tuple(
    name
    for name, row in OPTIONS.items()
    if "inspect" not in row.commands and name != "repair"  # of which the command has its own help
)


@takes(BakeOptions)
def inspect(path: Path, **options: Any) -> Inspection:
    """Report what `bake` would do with an asset, and the problems of the asset.

    >>> seen = gf_usd.inspect("duck.usda", particles=300)
    >>> seen.refusal is None, seen.warnings
    (True, ())

    It takes the keywords of `bake`; those that only affect the output files have no effect here.
    If the file can be read, a refusal is part of the result.  Refusal, warnings and notes name
    keywords.

    Returns
    -------
    Inspection : `plan` with particles, materials and settings, `cost`, `warnings`, `notes`,
        `refusal`, and `diagnoses` of the meshes; `as_json()` is what ``gf-usd inspect --json``
        prints.

    Raises
    ------
    UsageError : the options make no sense, or another part of the program uses Taichi.
    InputError : the file cannot be read, has unsaved changes in this program, is the result of a
        bake, or contains nothing to bake.
    """
    from gf_usd.pipeline.inspect import inspect as inspect_asset
    from gf_usd.readers.usd.stage import require_saved

    require_saved(path)
    require_this_process("inspect")
    with guest():
        seen = inspect_asset(
            path, **{k: v for k, v in options.items() if k not in (*LATER, PROGRESS)}
        )
    if seen.refusal is not None:
        in_python(seen.refusal, BAKE)
    facts, plan = seen.asset.facts, seen.plan
    return replace(
        seen,
        warnings=tuple(map(BAKE.text, seen.warnings)),
        asset=replace(seen.asset, facts=replace(facts, notes=tuple(map(BAKE.text, facts.notes)))),
        shortcuts=tuple(map(BAKE.text, seen.shortcuts)),
        plan=plan and replace(plan, notes=tuple(map(BAKE.text, plan.notes))),
    )

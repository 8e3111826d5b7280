"""From finished caches to published files: layers over the asset, or one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.publish import drop_working, partial_path, publish
from gf_usd.resuming import abandoned, folders

if TYPE_CHECKING:
    from gf_usd.plan import Plan
    from gf_usd.usd.variants import BakedLook


def sweep(plan: Plan) -> set[Path]:
    """Delete the clips of a bake of these names that was interrupted and is not gone on with.

    Returns the folders of clips that a finished bake refers to: nothing touches these before the
    new one is there.
    """
    from gf_usd.usd.clips import clips_of, remove_clips

    for path in (plan.outputs.root, plan.outputs.layers, *plan.outputs.caches):
        drop_working(path)
    kept = {folder for cache in plan.outputs.caches if (folder := clips_of(cache))}
    stale = {folder for c in plan.outputs.caches if (folder := clips_of(partial_path(c)))}
    if not any(plan.standing):
        stale |= abandoned(plan.outputs)
    for folder in stale - kept - folders(plan.standing, plan.outputs):
        remove_clips(folder)
    return kept


def deliver(plan: Plan, looks: Sequence[BakedLook], earlier: set[Path]) -> tuple[str, ...]:
    """Give the results their final names, none before all of it is there; returns notes.

    looks : with the final names of their caches, which still have their partial names.
    earlier : folders of clips that the bake replaces.

    Raises BakeError where the disk refuses.
    """
    if plan.outputs.flat:
        return _one_file(plan, looks)
    from gf_usd.usd.clips import clips_of, remove_clips
    from gf_usd.usd.layout import write_root

    for look in looks:
        publish(look.cache)
    root = write_root(
        plan.outputs.root, plan.asset, looks, source=plan.source, choices=plan.choices
    )
    for folder in earlier - {clips_of(look.cache) for look in looks}:
        remove_clips(folder)
    return root.notes


def _one_file(plan: Plan, looks: Sequence[BakedLook]) -> tuple[str, ...]:
    """Flatten the layers; they are working files and go when the one file is there."""
    from gf_usd.usd.flatten import write_flat
    from gf_usd.usd.layout import write_root
    from gf_usd.usd.stage import refresh

    working = [replace(look, cache=partial_path(look.cache)) for look in looks]
    root = write_root(
        plan.outputs.layers, plan.asset, working, source=plan.source, choices=plan.choices,
        partial=True,
    )  # fmt: skip
    target = plan.outputs.root
    moved = {}
    if plan.converted is not None and plan.outputs.textures:
        moved = plan.converted.extract(target)
    notes = write_flat(
        target, root, plan.asset, source=plan.source, choices=plan.choices, moved=moved
    )
    publish(target)
    refresh(target)
    for path in (root.path, *(look.cache for look in working)):
        path.unlink()
    return (*root.notes, *notes)

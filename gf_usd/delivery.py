"""From finished caches to published files: layers over the asset, or one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from gf_usd.publish import partial_path, publish

if TYPE_CHECKING:
    from gf_usd.plan import Plan
    from gf_usd.usd.variants import BakedLook


def deliver(plan: Plan, looks: Sequence[BakedLook]) -> tuple[str, ...]:
    """Give the results their final names, none before all of it is there; returns notes.

    looks : with the final names of their caches, which still have their partial names.

    Raises BakeError where the disk refuses.
    """
    if plan.outputs.flat:
        return _one_file(plan, looks)
    from gf_usd.usd.layout import write_root

    for look in looks:
        publish(look.cache)
    root = write_root(
        plan.outputs.root, plan.asset, looks, source=plan.source, choices=plan.choices
    )
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

"""From finished caches to published files: layers over the asset, or one file.

A bake has its results to itself: from before it touches them to its end, however it ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.errors import UsageError
from gf_usd.pipeline.checkpoint import abandoned, folders
from gf_usd.prepare.outputs import stamp, stamps
from gf_usd.system import file_locks
from gf_usd.system.atomic_files import drop_working, partial_path, publish

if TYPE_CHECKING:
    from gf_usd.layers.variants import BakedVariant
    from gf_usd.prepare.outputs import SplatSequence
    from gf_usd.prepare.plan import Plan


def sweep(plan: Plan) -> set[Path]:
    """Delete the clips of a bake of these names that was interrupted and is not gone on with.

    Returns the folders of clips that a finished bake refers to: nothing touches these before the
    new one is there.
    """
    from gf_usd.layers.clips import clips_of, remove_clips

    for path in (plan.outputs.root, plan.outputs.layers, *plan.outputs.caches):
        drop_working(path)
    kept = {folder for cache in plan.outputs.caches if (folder := clips_of(cache))}
    stale = {folder for c in plan.outputs.caches if (folder := clips_of(partial_path(c)))}
    if not any(plan.standing):
        stale |= abandoned(plan.outputs)
    for folder in stale - kept - folders(plan.standing, plan.outputs):
        remove_clips(folder)
    return kept


def deliver(plan: Plan, looks: Sequence[BakedVariant], earlier: set[Path]) -> tuple[str, ...]:
    """Give the results their final names, none before all of it is there; returns notes.

    looks : with the final names of their caches, which still have their partial names.
    earlier : folders of clips that the bake replaces.

    Raises BakeError where the disk refuses.
    """
    if plan.outputs.flat:
        return _one_file(plan, looks)
    from gf_usd.layers.clips import clips_of, remove_clips
    from gf_usd.layers.root import write_root

    for look in looks:
        publish(look.cache)
    root = write_root(
        plan.outputs.root, plan.asset, looks, source=plan.source, choices=plan.choices
    )
    for folder in earlier - {clips_of(look.cache) for look in looks}:
        remove_clips(folder)
    return root.notes


def _one_file(plan: Plan, looks: Sequence[BakedVariant]) -> tuple[str, ...]:
    """Flatten the layers; they are working files and go when the one file is there."""
    from gf_usd.layers.flatten import write_flat
    from gf_usd.layers.root import write_root
    from gf_usd.layers.stage import refresh

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


@contextmanager
def alone(plan: Plan) -> Iterator[None]:
    """Hold the locks of all that a bake writes.

    Where the system has no file locks (Windows) nothing is held.

    Raises UsageError where another bake holds one, or wrote since the plan was made; BakeError
    where a lock cannot be made.
    """
    if not file_locks.AVAILABLE:
        yield
        return
    with ExitStack() as stack:
        for path in (plan.outputs.root, *map(_place, _sequences(plan))):
            if file_locks.inherited(path):
                continue
            held = file_locks.acquire(path)
            if held is None:
                raise UsageError(
                    f"another bake is writing {path}",
                    "wait until it is done, or choose another -o"
                    if path == plan.outputs.root
                    else "wait until it is done, or name another folder for the frames",
                )
            stack.callback(held.release, remove=True)
        if plan.seen and stamps(plan.outputs) != plan.seen:
            raise UsageError(
                f"another bake wrote {plan.outputs.root} while this one was prepared",
                "look at what is there, and repeat the command if it is still wanted",
            )
        yield


def write_source(plan: Plan) -> None:
    """Write the layer of a mesh file, which the bakes of that file share.

    Raises UsageError where another bake made it of another file, or in another way, since the plan
    was made: its results lie over it.
    """
    converted, target = plan.converted, plan.outputs.source
    if converted is None or target is None:
        return
    with _shared(target):
        if stamp(target) != plan.seen_source and not converted.is_at(target):
            raise UsageError(
                f"another bake made {target} of another file, or in another way, while this one was"
                " prepared",
                "bake them into another folder each with -o",
            )
        converted.write(target)


@contextmanager
def _shared(path: Path) -> Iterator[None]:
    """Hold the lock of a layer that several bakes share, waiting for it as long as it takes."""
    if not file_locks.AVAILABLE or file_locks.inherited(path):
        yield
        return
    with file_locks.locked(path, remove=True):
        yield


def _sequences(plan: Plan) -> Iterator[SplatSequence]:
    return (one for each in plan.sequences for one in each)


def _place(sequence: SplatSequence) -> Path:
    return sequence.folder / f"{sequence.stem}.{sequence.suffix}"

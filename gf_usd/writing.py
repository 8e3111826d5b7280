"""A bake has its results to itself: from before it touches them to its end, however it ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd import locks
from gf_usd.errors import UsageError
from gf_usd.output_files import Outputs

if TYPE_CHECKING:
    from gf_usd.plan import Plan
    from gf_usd.splat_sequence import SplatSequence

Stamp = tuple[int, int] | None  # (time of change [ns], inode); None: no such file
Stamps = tuple[Stamp, ...]


def stamps(files: Outputs) -> Stamps:
    """Of each result and checkpoint."""
    return tuple(
        stamp(path) for path in (files.root, *files.caches, files.report, *files.checkpoints)
    )


def stamp(path: Path) -> Stamp:
    """Which file lies there now."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_mtime_ns, found.st_ino


@contextmanager
def alone(plan: Plan) -> Iterator[None]:
    """Hold the locks of all that a bake writes.

    Where the system has no file locks (Windows) nothing is held.

    Raises UsageError where another bake holds one, or wrote since the plan was made; BakeError
    where a lock cannot be made.
    """
    if not locks.AVAILABLE:
        yield
        return
    with ExitStack() as stack:
        for path in (plan.outputs.root, *map(_place, _sequences(plan))):
            if locks.inherited(path):
                continue
            held = locks.acquire(path)
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
    if not locks.AVAILABLE or locks.inherited(path):
        yield
        return
    with locks.locked(path, remove=True):
        yield


def _sequences(plan: Plan) -> Iterator[SplatSequence]:
    return (one for each in plan.sequences for one in each)


def _place(sequence: SplatSequence) -> Path:
    return sequence.folder / f"{sequence.stem}.{sequence.suffix}"

"""Publishes finished caches: as layers over the asset, or as one file.

A bake locks its result files before it first touches them, and until its end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gf_usd.core.asset import Asset
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.choices import Choices
from gf_usd.pipeline.checkpoint import Resume, discard_checkpoints
from gf_usd.prepare.outputs.outputs import Outputs, Stamp, Stamps, stamp
from gf_usd.system import file_locks
from gf_usd.system.atomic_files import drop_working, partial_path, publish

if TYPE_CHECKING:
    from gf_usd.layers.root import RootSummary
    from gf_usd.layers.variants import BakedVariant
    from gf_usd.readers.mesh.to_usd import MeshSource


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """The files of a bake, and the source that its layers refer to."""

    files: Outputs
    asset: Asset
    source: Path  # the USD file that the layers refer to
    choices: Choices
    converted: MeshSource | None = None  # of an asset that is not USD

    def write_source(self, seen: Stamp) -> None:
        """Write the layer of a mesh file, which the bakes of that file share.

        seen : its state when the bake was planned.

        Raises UsageError if another bake has written it since then, from another file, with other
        options or by another version: the results of that bake refer to it.
        """
        converted, target = self.converted, self.files.source
        if converted is None or target is None:
            return
        with _shared(target):
            if stamp(target) != seen and not converted.is_at(target):
                raise UsageError(
                    f"another bake wrote {target} from another file, with other options or by "
                    f"another version of gf-usd while this one was prepared",
                    "use -o to bake each of them into its own folder",
                )
            converted.write(target)

    def write_root(self, variants: Sequence[BakedVariant], *, partial: bool) -> RootSummary:
        """Write the root layer over the caches; partial : under its partial name."""
        from gf_usd.layers.root import write_root

        return write_root(
            self.files.layers, self.asset, variants, source=self.source, choices=self.choices,
            partial=partial,
        )  # fmt: skip

    def publish(self, variants: Sequence[BakedVariant], earlier: set[Path]) -> tuple[str, ...]:
        """Give the results their final names, after all of them are complete; returns notes.

        variants : with the final names of their caches, which still have their partial names.
        earlier : folders of clips that the bake replaces.

        Raises BakeError where a file cannot be written.
        """
        if self.files.flat:
            return self._one_file(variants)
        from gf_usd.layers.clips import clips_of, remove_clips

        for variant in variants:
            publish(variant.cache)
        root = self.write_root(variants, partial=False)
        notes = root.notes
        if self.converted is not None and self.files.source is not None:
            notes = (*notes, *self.converted.notes_at(self.files.source))
        for folder in earlier - {clips_of(variant.cache) for variant in variants}:
            remove_clips(folder)
        return notes

    def _one_file(self, variants: Sequence[BakedVariant]) -> tuple[str, ...]:
        """Flatten the layers, and delete them when the one file is complete."""
        from gf_usd.layers.flatten import write_flat
        from gf_usd.layers.stage import refresh

        working = [replace(one, cache=partial_path(one.cache)) for one in variants]
        root = self.write_root(working, partial=True)
        target = self.files.root
        moved = {}
        if self.converted is not None and self.files.textures:
            moved = self.converted.extract(target)
        notes = write_flat(
            target, root, self.asset, source=self.source, choices=self.choices, moved=moved
        )
        publish(target)
        refresh(target)
        for path in (root.path, *(one.cache for one in working)):
            path.unlink()
        return (*root.notes, *notes)


def delete_interrupted_clips(files: Outputs, resume: Resume) -> set[Path]:
    """Delete the clips of an interrupted bake of these names that is not resumed.

    Returns the folders of clips that a finished bake refers to: they are kept until the new bake is
    published.
    """
    from gf_usd.layers.clips import clips_of, remove_clips

    for path in (files.root, files.layers, *files.caches):
        drop_working(path)
    kept = {folder for cache in files.caches if (folder := clips_of(cache))}
    stale = {folder for cache in files.caches if (folder := clips_of(partial_path(cache)))}
    if not any(resume.checkpoints):
        stale |= discard_checkpoints(files)
    for folder in stale - kept - resume.folders(files):
        remove_clips(folder)
    return kept


@contextmanager
def output_lock(root: Path, sequences: Sequence[Path], seen: Stamps) -> Iterator[None]:
    """Hold the locks of all that a bake writes.

    root : the root layer; sequences : a name for each sequence of splat files.
    seen : its state when the bake was planned.

    Raises UsageError where another bake holds one, or wrote since then; BakeError where a lock
    cannot be made.
    """
    elsewhere = dict.fromkeys(sequences, "give another folder for the frames")
    with ExitStack() as stack:
        for path in (root, *sequences):
            if file_locks.inherited(path):
                continue
            held = file_locks.acquire(path)
            if held is None:
                raise UsageError(
                    f"another bake is writing {path}",
                    f"wait until it is done, or {elsewhere.get(path, 'choose another -o')}",
                )
            stack.callback(held.release, remove=True)
        if any(stamp(path) != before for path, before in seen):
            raise UsageError(
                f"another bake wrote {root} while this one was prepared",
                "check that file, and repeat the command if it is still wanted",
            )
        yield


@contextmanager
def _shared(path: Path) -> Iterator[None]:
    """Hold the lock of a layer that several bakes share, waiting for it as long as it takes."""
    if file_locks.inherited(path):
        yield
        return
    with file_locks.locked(path, remove=True):
        yield

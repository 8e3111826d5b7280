"""A sequence of splat files, one for each frame: what viewers of Gaussians play."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gf_usd.errors import BakeError, UsageError
from gf_usd.publish import partial_path, publish
from gf_usd.splat_files import WRITERS
from gf_usd.splats import Splats

DIGITS = 4


@dataclass(frozen=True, kw_only=True)
class SplatSequence:
    """Where the frames of one bake go: ``FOLDER/bob.jelly.0001.ply`` and so on."""

    folder: Path
    stem: str  # "bob.jelly"
    suffix: str  # a key of WRITERS

    def path(self, index: int) -> Path:
        """The file of a frame, counted from 0; its name counts from 1."""
        return self.folder / f"{self.stem}.{index + 1:0{DIGITS}d}.{self.suffix}"

    def there(self) -> list[Path]:
        """Frames of this name that lie in the folder."""
        return sorted(self.folder.glob(f"{self.stem}.{'[0-9]' * DIGITS}*.{self.suffix}"))

    def write(self, splats: Splats, index: int) -> Path:
        """Write a frame, whole or not at all.  Raises BakeError where the disk refuses."""
        path = self.path(index)
        partial = partial_path(path)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            partial.write_bytes(WRITERS[self.suffix](splats))
        except OSError as error:
            raise BakeError(
                f"{partial} could not be written: {error.strerror}.",
                f"check that {self.folder} is writable and has space left",
            ) from error
        return publish(path)


def sequences(
    stem: str, looks: Sequence[str], *, ply: str | None, spz: str | None
) -> tuple[tuple[SplatSequence, ...], ...]:
    """The sequences of each look; none where no folder is given."""
    asked = [(folder, suffix) for folder, suffix in ((ply, "ply"), (spz, "spz")) if folder]
    return tuple(
        tuple(
            SplatSequence(folder=Path(folder), stem=f"{stem}.{look}", suffix=suffix)
            for folder, suffix in asked
        )
        for look in looks
    )


def require_free(asked: Sequence[Sequence[SplatSequence]], overwrite: bool) -> None:
    """Raise UsageError where a frame is there already, or a folder's name is that of a file."""
    for sequence in (one for each in asked for one in each):
        if sequence.folder.exists() and not sequence.folder.is_dir():
            raise UsageError(f"{sequence.folder} is no folder", "name another for the frames")
        there = sequence.there()
        if there and not overwrite:
            raise UsageError(
                f"{there[0]} exists already",
                "add --overwrite to replace it, or name another folder",
            )


def clear(asked: Sequence[SplatSequence]) -> None:
    """Remove the frames of an earlier bake, which may have been longer.

    Raises UsageError where one cannot be removed.
    """
    for path in (path for sequence in asked for path in sequence.there()):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise UsageError(
                f"{path} of an earlier bake cannot be removed: {error.strerror}",
                "remove it, or name another folder",
            ) from error

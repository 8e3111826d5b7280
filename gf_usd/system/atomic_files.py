"""Files that appear under their final name completely, or not at all.

A file is written as ``NAME.partial.EXT`` in the same folder, flushed to the disk, and renamed.  A
rename within a folder is atomic: if the process is killed at any moment, the final name has either
the old file or the new one.  Publish files before the files that refer to them.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from gf_usd.core.errors import BakeError, InputError, UsageError, counted

WORKING = re.compile(r"\.\w{6}")


def partial_path(path: Path) -> Path:
    """``duck.rubber.cache.usdc`` -> ``duck.rubber.cache.partial.usdc``, in the same folder."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def same_place(one: Path, other: Path) -> bool:
    """Whether two paths lead to the same file, which need not exist.

    A hard link is the same file, as is another spelling where case does not matter.  A symbolic
    link that leads to itself is not followed: `Path.resolve` raises a RuntimeError for it up to
    Python 3.12.
    """
    if os.path.realpath(one) == os.path.realpath(other):
        return True
    try:
        return os.path.samefile(one, other)
    except OSError:  # one of them does not exist, or cannot be followed
        return False


def drop_working(path: Path) -> None:
    """Delete the temporary file of USD that a killed process left next to `partial_path(path)`.

    USD saves to a file in the same folder, named without the suffix and with six random letters,
    and renames it.
    """
    stem = partial_path(path).stem
    for left in path.parent.glob(f"{glob.escape(stem)}.??????"):
        if WORKING.fullmatch(left.name.removeprefix(stem)):
            left.unlink(missing_ok=True)


@contextmanager
def dropped_on_failure(path: Path) -> Iterator[Path]:
    """Yield `partial_path(path)`, and delete that file where the block ends in an exception.

    For files that are of no use before they are complete.  After a success nothing is deleted: by
    then another process may be writing under the same partial name.
    """
    partial = partial_path(path)
    with ExitStack() as failed:
        failed.callback(_drop, partial)
        yield partial
        failed.pop_all()


def _drop(partial: Path) -> None:
    # The first error is already being raised; one of the deletion would hide it.
    with suppress(OSError):
        partial.unlink(missing_ok=True)


def publish(path: Path) -> Path:
    """Rename the finished ``partial_path(path)`` to its final name, replacing the old file; returns
    path.

    Raises
    ------
    BakeError : there is no partial file, or it cannot be renamed; the partial file then remains.
    """
    partial = partial_path(path)
    try:
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise BakeError(
            f"{partial} could not be published as {path.name}: {error.strerror}",
            f"check that {path.parent} is writable and that no other program has {path.name} open",
        ) from error
    return path


def publish_text(path: Path, text: str) -> Path:
    """Write a small UTF-8 text file atomically; returns path.

    Bytes of a file name that are not UTF-8 are written as backslash escapes.
    Raises BakeError where the file cannot be written.
    """
    return publish_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def publish_bytes(path: Path, data: bytes) -> Path:
    """Write a small file atomically; returns path.

    Raises BakeError where the file cannot be written; nothing of it remains then.
    """
    with dropped_on_failure(path) as partial:
        try:
            partial.write_bytes(data)
        except OSError as error:
            raise BakeError(
                f"{partial} could not be written: {error.strerror}",
                f"check that {path.parent} exists, is writable and has space left",
            ) from error
        return publish(path)


def _sync_folder(folder: Path) -> None:
    # the rename is durable only when the folder is flushed too; Windows cannot
    # open folders, and has a journal of its own
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def relative(path: Path, folder: Path) -> str:
    """A path relative to a folder, with forward slashes; absolute on another drive."""
    try:
        return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
    except ValueError:  # Windows, another drive
        return path.absolute().as_posix()


def require_working_folder() -> None:
    """Raise UsageError where the current working directory was deleted.

    Relative paths are undefined then, and Taichi does not start.
    """
    try:
        os.getcwd()
    except OSError as error:
        raise UsageError(
            f"the current folder cannot be found: {error.strerror}",
            "it may have been deleted: change to a folder that exists",
        ) from error


def is_utf8(path: Path) -> bool:
    """Whether all bytes of an absolute path are UTF-8, as USD requires."""
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError:
        return False
    return True


def require_utf8(path: Path) -> None:
    """Raise InputError for an asset that USD cannot open because of its path."""
    if not is_utf8(path):
        shown = str(path).encode(errors="backslashreplace").decode()
        raise InputError(
            f"{shown}: its path has bytes that are not UTF-8, and USD cannot open it",
            "rename the file, or the folder that has them in its name",
        )


def is_astray(target: Path, folder: Path) -> bool:
    """Whether the relative path leads elsewhere from where the folder is without symbolic links.

    USD finds a layer by the path by which it is opened, and takes ".." as text.  A folder that is
    a link to one elsewhere has other folders above it by its other path.
    """
    name = relative(target, folder)
    if not name.startswith("../"):
        return False
    there = os.path.normpath(os.path.join(os.path.realpath(folder), name))
    return os.path.realpath(there) != os.path.realpath(target)


def asset_path(target: Path, folder: Path) -> str:
    """The reference to ``target`` in a layer of ``folder``: relative, except for another drive and
    where it depends on a symbolic link (`is_astray`).
    """
    name = relative(target, folder)
    if is_astray(target, folder):
        return target.absolute().as_posix()
    return name if name.startswith("../") or Path(name).is_absolute() else f"./{name}"


def absolute_note(layer: Path, targets: Iterable[Path]) -> tuple[str, ...]:
    """A note where a layer refers to files by absolute paths (`asset_path`); none otherwise."""
    folder = layer.parent
    absolute = [
        target for target in dict.fromkeys(targets)
        if Path(asset_path(target, folder)).is_absolute()
    ]  # fmt: skip
    if not absolute:
        return ()
    more = len(absolute) - 1
    names = absolute[0].name + (f" and {counted(more, 'other file')}" if more else "")
    linked = any(is_astray(target, folder) for target in absolute)
    why = "is reached through a symbolic link" if linked else "is on another drive"
    return (
        f"{folder} {why}: {layer.name} refers to {names} by"
        f" {'absolute paths, which are' if more else 'its absolute path, which is'} the same"
        f" {'by any path to it' if linked else 'from any folder'}",
    )

"""Files that appear under their final name whole, or not at all.

A file is written as ``NAME.partial.EXT`` next to its final place, flushed to the disk, and renamed;
a rename within a folder is atomic, so a kill at any moment leaves either the old file or the new
one under the final name.  Publish what others refer to first, and what refers to it last.
"""

from __future__ import annotations

import glob
import os
import re
from pathlib import Path

from gf_usd.core.errors import BakeError, InputError, UsageError

WORKING = re.compile(r"\.\w{6}")


def partial_path(path: Path) -> Path:
    """``duck.rubber.cache.usdc`` -> ``duck.rubber.cache.partial.usdc``, in the same folder."""
    return path.with_name(f"{path.stem}.partial{path.suffix}")


def drop_working(path: Path) -> None:
    """Delete what a kill in the middle of USD's saving left of `partial_path(path)`.

    USD saves to a file next to it, its name without the suffix and six letters, and renames that.
    """
    stem = partial_path(path).stem
    for left in path.parent.glob(f"{glob.escape(stem)}.??????"):
        if WORKING.fullmatch(left.name.removeprefix(stem)):
            left.unlink(missing_ok=True)


def publish(path: Path) -> Path:
    """Give the finished ``partial_path(path)`` its final name, replacing what had it; returns path.

    Raises
    ------
    BakeError : there is no partial file, or the disk refuses; the partial file then remains.
    """
    partial = partial_path(path)
    try:
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise BakeError(
            f"{partial} could not be published as {path.name}: {error.strerror}.",
            f"check that {path.parent} is writable and that no other program holds {path.name}",
        ) from error
    return path


def publish_text(path: Path, text: str) -> Path:
    """Write a small UTF-8 text file under its final name in one step; returns path.

    Bytes of a file's name that are no UTF-8 are written as backslashes and numbers.  Raises
    BakeError where the folder or the disk refuses.
    """
    return publish_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def publish_bytes(path: Path, data: bytes) -> Path:
    """Write a small file under its final name in one step; returns path.

    Raises BakeError where the folder or the disk refuses.
    """
    partial = partial_path(path)
    try:
        partial.write_bytes(data)
    except OSError as error:
        raise BakeError(
            f"{partial} could not be written: {error.strerror}.",
            f"check that {path.parent} exists, is writable and has space left",
        ) from error
    return publish(path)


def _sync_folder(folder: Path) -> None:
    # the rename itself is lost in a power cut until its folder is on the disk; Windows cannot
    # open a folder and keeps its own journal
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def relative(path: Path, folder: Path) -> str:
    """A path as seen from a folder, with forward slashes; absolute on another drive."""
    try:
        return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
    except ValueError:  # Windows, another drive
        return path.absolute().as_posix()


def require_working_folder() -> None:
    """Raise UsageError where the folder that this process works in was deleted.

    Relative paths have no meaning there, and Taichi does not start.
    """
    try:
        os.getcwd()
    except OSError as error:
        raise UsageError(
            f"the current folder cannot be found: {error.strerror}",
            "it may have been deleted: change to a folder that exists",
        ) from error


def is_utf8(path: Path) -> bool:
    """Whether all bytes of an absolute path are UTF-8: USD opens no others."""
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


def asset_path(target: Path, folder: Path) -> str:
    """``target`` as a layer in ``folder`` refers to it: relative where the drive allows it."""
    name = relative(target, folder)
    return name if name.startswith("../") or Path(name).is_absolute() else f"./{name}"

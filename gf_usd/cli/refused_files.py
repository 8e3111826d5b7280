"""Errors of the system about a file, in the form of all errors: the fault and a hint."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

TOO_LONG = "give a shorter name"
READ_ONLY = "write to a folder on another file system (--output)"
UNKNOWN = (
    "check the permissions of the file and of the folders above it, and that no other program has"
    " it open"
)


def refusal(error: OSError) -> tuple[str, str] | None:
    """The fault and the hint of an error on a path that is too long, refused or on a read-only file
    system; None for other errors.
    """
    names = [os.fsdecode(name) for name in (error.filename, error.filename2) if _is_path(name)]
    if not names:
        return None
    if error.errno == errno.ENAMETOOLONG:
        return f"{names[0][:60]}...: {error.strerror}", TOO_LONG
    fault = f"{' or '.join(names)}: {error.strerror}"
    if error.errno == errno.EROFS:
        return fault, READ_ONLY
    if not isinstance(error, PermissionError):
        return None
    reasons = filter(None, (_reason(Path(name)) for name in names))
    return fault, next(reasons, UNKNOWN)


def _is_path(name: object) -> bool:
    """Whether an error names a path; it may name a number of an open file."""
    return bool(name) and isinstance(name, (str, bytes, os.PathLike))


def _reason(path: Path) -> str:
    """What refuses access to a path, and what to do about it; "" where that is not known."""
    parents = [*path.absolute().parents]
    with suppress(OSError, RuntimeError):  # links in a circle, or into a folder that is locked
        parents = [*path.resolve().parents, *parents]
    above = [folder for folder in dict.fromkeys(parents) if os.access(folder, os.F_OK)]
    for folder in reversed(above):
        if not os.access(folder, os.X_OK):
            return f"{folder} cannot be entered: change the permissions of that folder"
    exists, folder = os.access(path, os.F_OK), path.absolute().parent
    if exists and not os.access(path, os.R_OK):
        return f"{path} cannot be read: change its permissions"
    # A file is replaced as a whole, which its folder permits.
    if os.access(folder, os.F_OK) and not os.access(folder, os.W_OK):
        return f"{folder} cannot be written to: change the permissions of that folder"
    if exists and not os.access(path, os.W_OK):
        return f"{path} cannot be written: change its permissions"
    return ""

"""Errors of the system about a file, in the form of all errors: the fault and a hint."""

from __future__ import annotations

import errno
import os
from pathlib import Path

TOO_LONG = "give a shorter name"
UNKNOWN = (
    "check the permissions of the file and of the folders above it, and that no other program has"
    " it open"
)


def refusal(error: OSError) -> str:
    """The message of an error on a path that is too long or refused; "" for other errors."""
    names = [os.fsdecode(name) for name in (error.filename, error.filename2) if _is_path(name)]
    if not names:
        return ""
    if error.errno == errno.ENAMETOOLONG:
        return f"{names[0][:60]}...: {error.strerror}\n\nhint: {TOO_LONG}"
    if not isinstance(error, PermissionError):
        return ""
    reasons = filter(None, (_reason(Path(name)) for name in names))
    return f"{' or '.join(names)}: {error.strerror}\n\nhint: {next(reasons, UNKNOWN)}"


def _is_path(name: object) -> bool:
    """Whether an error names a path; it may name a number of an open file."""
    return bool(name) and isinstance(name, (str, bytes, os.PathLike))


def _reason(path: Path) -> str:
    """What refuses access to a path, and what to do about it; "" where that is not known."""
    above = [folder for folder in reversed(path.absolute().parents) if os.access(folder, os.F_OK)]
    for folder in above:
        if not os.access(folder, os.X_OK):
            return f"{folder} cannot be entered: change the permissions of that folder"
    if os.access(path, os.F_OK):
        for mode, use in ((os.R_OK, "read"), (os.W_OK, "written")):
            if not os.access(path, mode):
                return f"{path} cannot be {use}: change its permissions"
    if above and not os.access(above[-1], os.W_OK):
        return f"{above[-1]} cannot be written to: change the permissions of that folder"
    return ""

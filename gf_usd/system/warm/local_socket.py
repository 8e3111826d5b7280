"""A socket in the file system that only its owner can use."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

from gf_usd.core.errors import BakeError, UsageError
from gf_usd.system.file_locks import acquire

AVAILABLE = hasattr(socket, "AF_UNIX") and os.name == "posix"
VARIABLE = "GF_USD_SOCKET"  # environment variable with another path
PRIVATE = 0o700  # mode of the folder
LONGEST = 100  # bytes of a path: systems take 104 to 108
CREDENTIALS = struct.Struct("3i")  # process, user and group at the other end


def socket_path() -> Path:
    """Default path of this user's server."""
    if named := os.environ.get(VARIABLE):
        return Path(named)
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / "gf-usd" / "serve.sock"
    return Path(tempfile.gettempdir()) / f"gf-usd-{os.getuid()}" / "serve.sock"


def require_available() -> None:
    """Raise UsageError where the system has no such sockets."""
    if not AVAILABLE:
        raise UsageError(
            "gf-usd serve needs Unix sockets, which this system does not support",
            "run it under Linux, macOS or the Windows Subsystem for Linux, or bake without --serve",
        )


@contextlib.contextmanager
def listening_socket(path: Path) -> Iterator[socket.socket]:
    """Listen at a path; the socket and its lock are removed at the end of the block.

    A socket that a killed server left there is replaced.

    Raises
    ------
    UsageError : another server listens there, the path is too long or is not a socket, or other
        users can use the folder.
    BakeError : the folder cannot be written.
    """
    require_available()
    if len(os.fsencode(path)) > LONGEST:
        raise UsageError(
            f"{path}: the path of a socket has at most {LONGEST} bytes, but this one has "
            f"{len(os.fsencode(path))}",
            "give a shorter one: --socket PATH",
        )
    _make_private(path.parent)
    held = acquire(path)
    if held is None:
        raise UsageError(
            f"another gf-usd serve is already listening at {path}",
            "use that one, stop it with gf-usd serve --stop, or give another --socket",
        )
    try:
        if path.exists() and not path.is_socket():
            raise UsageError(f"{path} exists but is not a socket", "give another --socket")
        # its server does not hold the lock, so it was killed
        path.unlink(missing_ok=True)
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(str(path))
            path.chmod(0o600)
            end.listen()
            yield end
    finally:
        if path.is_socket():
            path.unlink(missing_ok=True)
        held.release(remove=True)


def _make_private(folder: Path) -> None:
    """Create a folder for this user only, or check that it is private."""
    try:
        folder.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError as error:
        raise BakeError(
            f"{folder} cannot be created: {error.strerror}", "give another --socket PATH"
        ) from error
    if found.st_uid != os.getuid() or found.st_mode & 0o077:
        another = "give another --socket in a folder that belongs to you alone"
        # a folder of all users, such as /tmp, has the sticky bit and must stay as it is
        own = found.st_uid == os.getuid() and not found.st_mode & stat.S_ISVTX
        raise UsageError(
            f"{folder} belongs to user {found.st_uid} and has mode {found.st_mode & 0o7777:o}:"
            " other users could replace the socket in it",
            f"chmod 700 {folder}, or {another}" if own else another,
        )


def connect(path: Path) -> socket.socket | None:
    """A connection to the server at a path; None where none listens.

    Raises UsageError where the server belongs to another user.
    """
    require_available()
    end = socket.socket(socket.AF_UNIX)
    try:
        end.connect(str(path))
    except OSError:
        end.close()
        return None
    if not is_same_user(end):
        end.close()
        raise UsageError(f"the server at {path} belongs to another user", "give another --socket")
    return end


def is_same_user(end: socket.socket) -> bool:
    """Whether the process at the other end belongs to this user.

    True where the system has no such call; the mode of the folder then excludes other users.
    """
    if not hasattr(socket, "SO_PEERCRED"):
        return True
    credentials = end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
    return CREDENTIALS.unpack(credentials)[1] == os.getuid()

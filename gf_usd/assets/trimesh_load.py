"""trimesh as a parser: bytes in, named triangle meshes out, and its errors in our words."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.assets.mesh_data import REPAIR
from gf_usd.errors import InputError
from gf_usd.model import Floats, Ints

# What trimesh raises on files that are not what they should be.  ImportError: it asks for packages
# that guess an encoding when the text is none.
UNREADABLE = (
    ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError, NameError,
    NotImplementedError, ImportError, RecursionError, OSError, MemoryError,
)  # fmt: skip


def load(path: Path, data: bytes, kind: str) -> list[tuple[str, Floats, Ints]]:
    """(name, points (V, 3), triangles (T, 3)) of each mesh in a file.

    Raises InputError for a file that trimesh cannot read, or in which it finds no triangle.
    """
    meshes = [
        (name, np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))
        for name, mesh in load_meshes(path, data, kind).items()
        if len(getattr(mesh, "faces", ()))
    ]
    if not meshes:
        raise InputError(f"{path}: there is no face in it", "give a file with a mesh in it")
    return meshes


def load_meshes(
    path: Path, data: bytes, kind: str, files: Mapping[str, bytes] | None = None
) -> dict[str, Any]:
    """trimesh's objects by name, their points and faces as in the file.

    `files`: what the data refers to by name.  Raises InputError as `load` does.
    """
    import trimesh  # most assets are USD and never need it

    try:
        with _quiet():
            resolver: Any = _Files(files or {})  # by its methods; trimesh's type names classes
            loaded: Any = trimesh.load(
                BytesIO(data), file_type=kind, process=False, resolver=resolver
            )
    except UNREADABLE as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InputError(f"{path} cannot be read as {kind.upper()}: {reason}", REPAIR) from error
    geometry = getattr(loaded, "geometry", None)
    return dict(geometry) if geometry is not None else {"mesh": loaded}


class _Files:
    """The resolver that trimesh asks for files by name: only those it is given."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self._files = files

    def get(self, name: str) -> bytes:
        """The bytes of a file; KeyError for one that is not there."""
        return self._files[name]

    __getitem__ = get

    def keys(self) -> list[str]:
        """Every name."""
        return list(self._files)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without trimesh's log on the screen: what it warns of is checked and said here."""
    log, sink = logging.getLogger("trimesh"), logging.NullHandler()
    before = log.propagate
    log.addHandler(sink)
    log.propagate = False
    try:
        yield
    finally:
        log.propagate = before
        log.removeHandler(sink)

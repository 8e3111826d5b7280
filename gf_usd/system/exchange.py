"""Serialization of values between two processes: a line of JSON, then arrays in NumPy's NPY format.

Supports frozen dataclasses of this package, tuples, lists, dicts, sets, paths, plain values and
arrays.  It does not use pickle: reading executes only the constructors of those dataclasses.  An
array or dataclass that is referred to several times is sent once, and is again one object.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

PACKAGE = "gf_usd."


def write(value: Any, file: BinaryIO) -> None:
    """Write a value.  Raises TypeError for an unsupported type."""
    writer = _Writer()
    tree = writer.encode(value)
    file.write(json.dumps([tree, writer.objects, len(writer.arrays)]).encode() + b"\n")
    for array in writer.arrays:
        np.lib.format.write_array(_Stream(file), array, allow_pickle=False)


class _Stream:
    """A file object without a position, such as a pipe, for which NumPy expects a regular file."""

    def __init__(self, file: BinaryIO) -> None:
        self.write = file.write


def read(data: bytes) -> Any:
    """Read the value that `write` wrote.  Raises ValueError for other bytes."""
    file = BytesIO(data)
    tree, rows, count = json.loads(file.readline())
    return _Reader(
        rows, [np.lib.format.read_array(file, allow_pickle=False) for _ in range(count)]
    ).decode(tree)


class _Writer:
    def __init__(self) -> None:
        self.arrays: list[np.ndarray] = []
        self.objects: list[tuple[str, str, dict[str, Any]]] = []  # module, name, fields
        # with the object, because its id is unique only while it exists
        self._seen: dict[int, tuple[Any, dict[str, int]]] = {}

    def encode(self, value: Any) -> Any:
        """JSON of a value: plain ones unchanged, others as {kind: content}."""
        if value is None or type(value) in (bool, int, float, str):
            return value
        if id(value) in self._seen:
            return self._seen[id(value)][1]
        if isinstance(value, np.ndarray | np.generic):
            self.arrays.append(np.asarray(value))
            kind = "array" if isinstance(value, np.ndarray) else "number"
            found = {kind: len(self.arrays) - 1}
        elif is_dataclass(value):
            of = type(value)
            row = {one.name: self.encode(getattr(value, one.name)) for one in fields(value)}
            self.objects.append((of.__module__, of.__qualname__, row))
            found = {"object": len(self.objects) - 1}
        else:
            return self._plain(value)
        self._seen[id(value)] = (value, found)
        return found

    def _plain(self, value: Any) -> dict[str, Any]:
        if isinstance(value, Path):
            return {"path": str(value)}
        if isinstance(value, Mapping):
            return {"dict": [[self.encode(k), self.encode(v)] for k, v in value.items()]}
        for kind, of in CONTAINERS.items():
            if isinstance(value, of):
                return {kind: [self.encode(one) for one in value]}
        raise TypeError(f"{type(value)} cannot be passed between processes")


CONTAINERS: dict[str, type] = {"tuple": tuple, "list": list, "set": frozenset}


class _Reader:
    def __init__(self, rows: list[Any], arrays: list[np.ndarray]) -> None:
        self._arrays = arrays
        self._objects: list[Any] = []
        for module, name, row in rows:  # a row refers to earlier objects only
            of = getattr(import_module(module), name) if module.startswith(PACKAGE) else None
            if not is_dataclass(of) or not isinstance(of, type):
                raise ValueError(f"{module}.{name} is not a dataclass of this package")
            self._objects.append(of(**{key: self.decode(value) for key, value in row.items()}))

    def decode(self, tree: Any) -> Any:
        """The value of the encoded `tree`."""
        if not isinstance(tree, dict):
            return tree
        ((kind, content),) = tree.items()
        if kind in CONTAINERS:
            return CONTAINERS[kind](self.decode(one) for one in content)
        if kind == "dict":
            return {self.decode(k): self.decode(v) for k, v in content}
        if kind == "path":
            return Path(content)
        if kind == "object":
            return self._objects[content]
        array = self._arrays[content]
        return array if kind == "array" else array[()]

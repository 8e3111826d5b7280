"""Parsing of the header and the body of a PLY file, text or binary, into one table per element."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR

TYPES = {
    name: kind
    for names, kind in (
        (("char", "int8"), "i1"),
        (("uchar", "uint8"), "u1"),
        (("short", "int16"), "i2"),
        (("ushort", "uint16"), "u2"),
        (("int", "int32"), "i4"),
        (("uint", "uint32"), "u4"),
        (("int64",), "i8"),
        (("uint64",), "u8"),
        (("float16",), "f2"),
        (("float", "float32"), "f4"),
        (("double", "float64"), "f8"),
    )
    for name in names
}

ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def header(path: Path, data: bytes) -> tuple[list[Element], str, str, int]:
    """Parse the header: elements, byte order ("" for text), texture name, start of the body."""
    if not data.startswith(b"ply") or b"end_header" not in data:
        raise InputError(
            f"{path} is not a PLY file: it does not begin with 'ply' and a header",
            "check the type of the file",
        )
    end = data.index(b"end_header")
    rest = data.find(b"\n", end)
    start = len(data) if rest < 0 else rest + 1
    elements: list[Element] = []
    order, texture = None, ""
    for number, line in enumerate(data[:end].decode("utf-8", errors="replace").splitlines(), 1):
        tokens = line.split()
        where = f"{path}, line {number}: '{line.strip()[:60]}'"
        if tokens[:1] == ["format"]:
            order = ENCODINGS.get(tokens[1] if len(tokens) > 1 else "")
        elif tokens[:1] == ["element"]:
            if len(tokens) != 3 or not tokens[2].isdigit():
                raise InputError(f"{where} is not an element with a count", REPAIR)
            elements.append(Element(tokens[1], int(tokens[2]), []))
        elif tokens[:1] == ["property"]:
            column = _column(where, tokens)
            if not elements or column.name in [c.name for c in elements[-1].columns]:
                raise InputError(
                    f"{where} comes before any element, or is in the same element twice", REPAIR
                )
            elements[-1].columns.append(column)
        elif tokens[:2] == ["comment", "TextureFile"]:
            texture = line.split("TextureFile", 1)[1].strip()
    if order is None:
        raise InputError(f"{path}: its header names no valid format", REPAIR)
    return elements, order, texture, start


def _column(where: str, tokens: list[str]) -> Column:
    kinds = tokens[2:4] if tokens[1:2] == ["list"] else tokens[1:2]
    if len(tokens) != len(kinds) + 2 + (tokens[1:2] == ["list"]):
        raise InputError(f"{where} is not a property", REPAIR)
    unknown = [kind for kind in kinds if kind not in TYPES]
    if unknown:
        raise InputError(f"{where} has the unknown type {unknown[0]}", REPAIR)
    types = [TYPES[kind] for kind in kinds]
    return Column(tokens[-1], types[-1], types[0] if len(types) == 2 else "")


@dataclass(frozen=True)
class Column:
    """A property: a number, or a list of them."""

    name: str
    type: str  # numpy's, without the byte order
    count_type: str = ""  # of the list's length; "": a single number


@dataclass(frozen=True)
class Element:
    """An element declared in the header."""

    name: str
    count: int
    columns: list[Column]


@dataclass(frozen=True)
class Ragged:
    """A list property: counts (n,) and concatenated values (sum of counts,)."""

    counts: Ints
    values: Floats | Ints


Table = dict[str, Floats | Ragged]


def read_body(
    path: Path, data: bytes, start: int, elements: list[Element], order: str
) -> dict[str, Table]:
    """The columns of all elements by name.

    Parameters
    ----------
    data : the whole file.   start : offset of the body.
    order : "<" or ">" of binary files, "" of text.

    Raises InputError for a body that is shorter than declared or contains a value that is not a
    number.
    """
    body = _Text(path, data, start) if not order else _Binary(path, data, start, order)
    return {element.name: body.read(element) for element in elements if element.columns}


class _Text:
    """Parse a text body, with one row per line."""

    def __init__(self, path: Path, data: bytes, start: int) -> None:
        self._path = path
        first = data[:start].count(b"\n") + 1
        lines = data[start:].decode("ascii", errors="replace").splitlines()
        split = ((n, line.split()) for n, line in enumerate(lines, first))
        self._rows = [(n, tokens) for n, tokens in split if tokens]
        self._at = 0

    def read(self, element: Element) -> Table:
        rows = self._rows[self._at : self._at + element.count]
        if len(rows) < element.count:
            raise _short(self._path, element, len(rows))
        self._at += element.count
        if not any(column.count_type for column in element.columns):
            return self._scalars(element, rows)
        values: dict[str, list[float]] = {c.name: [] for c in element.columns}
        counts: dict[str, list[int]] = {c.name: [] for c in element.columns}
        for number, tokens in rows:
            at = 0
            numbers = self._numbers(number, tokens)
            for column in element.columns:
                count = 1
                if column.count_type:
                    count = self._count(number, numbers[at : at + 1])
                    at += 1
                if at + count > len(numbers):
                    raise self._error(
                        number, f"{element.name} needs {at + count} numbers but has {len(numbers)}"
                    )
                values[column.name].extend(numbers[at : at + count])
                counts[column.name].append(count)
                at += count
        return {
            column.name: Ragged(np.array(counts[column.name]), _cast(values[column.name], column))
            if column.count_type
            else _cast(values[column.name], column)
            for column in element.columns
        }

    def _scalars(self, element: Element, rows: list[tuple[int, list[str]]]) -> Table:
        width = len(element.columns)
        flat: list[float] = []
        for number, tokens in rows:
            if len(tokens) < width:
                what = f"{element.name} needs {width} numbers but has {len(tokens)}"
                raise self._error(number, what)
            flat.extend(self._numbers(number, tokens[:width]))
        table = np.array(flat).reshape(-1, width)
        return {c.name: _cast(table[:, i], c) for i, c in enumerate(element.columns)}

    def _numbers(self, number: int, tokens: list[str]) -> list[float]:
        try:
            return [float(token) for token in tokens]
        except ValueError:
            shown = " ".join(tokens)[:60]
            raise self._error(number, f"'{shown}' contains a value that is not a number") from None

    def _count(self, number: int, found: list[float]) -> int:
        if not found or not (0 <= found[0] < 1e6 and found[0] == int(found[0])):
            raise self._error(number, f"a list has the length {found[0] if found else 'missing'}")
        return int(found[0])

    def _error(self, line: int, what: str) -> InputError:
        return InputError(f"{self._path}, line {line}: {what}", REPAIR)


class _Binary:
    """Parse a binary body of packed rows."""

    def __init__(self, path: Path, data: bytes, start: int, order: str) -> None:
        self._path, self._data, self._at, self._order = path, data, start, order

    def read(self, element: Element) -> Table:
        lengths = self._first_lengths(element)
        row = np.dtype(
            [
                field
                for column, length in zip(element.columns, lengths)
                for field in self._fields(column, length)
            ]
        )
        held = min(element.count, (len(self._data) - self._at) // max(1, row.itemsize))
        table = np.frombuffer(self._data, row, count=held, offset=self._at) if held else None
        if table is not None and held == element.count and _even(table, element, lengths):
            self._at += held * row.itemsize
            return {
                column.name: Ragged(np.full(held, length), table[column.name].reshape(-1))
                if column.count_type
                else table[column.name]
                for column, length in zip(element.columns, lengths)
            }
        if element.count and not any(column.count_type for column in element.columns):
            raise _short(self._path, element, held)
        return self._row_by_row(element)

    def _fields(self, column: Column, length: int) -> list[tuple]:
        kind = self._order + column.type
        if not column.count_type:
            return [(column.name, kind)]
        return [
            (f"#{column.name}", self._order + column.count_type),
            (column.name, kind, (length,)),
        ]

    def _first_lengths(self, element: Element) -> list[int]:
        """Lengths of the lists in the element's first row; 0 for a single number."""
        lengths, at = [], self._at
        for column in element.columns:
            length = 1
            if column.count_type:
                found = self._take(at, column.count_type, 1) if element.count else None
                length = int(found[0]) if found is not None else 0
                at += np.dtype(column.count_type).itemsize
            if not 0 <= length <= len(self._data):
                raise InputError(
                    f"{self._path}: a list of its first {element.name} has the length {length}",
                    REPAIR,
                )
            lengths.append(length)
            at += length * np.dtype(column.type).itemsize
        return lengths

    def _take(self, at: int, kind: str, count: int) -> np.ndarray | None:
        size = np.dtype(kind).itemsize
        if at + count * size > len(self._data):
            return None
        return np.frombuffer(self._data, self._order + kind, count=count, offset=at)

    def _row_by_row(self, element: Element) -> Table:
        parts: dict[str, list[np.ndarray]] = {c.name: [] for c in element.columns}
        at = self._at
        for done in range(element.count):
            for column in element.columns:
                count = 1
                if column.count_type:
                    length = self._take(at, column.count_type, 1)
                    if length is None or length[0] < 0:
                        raise _short(self._path, element, done)
                    count = int(length[0])
                    at += np.dtype(column.count_type).itemsize
                values = self._take(at, column.type, count)
                if values is None:
                    raise _short(self._path, element, done)
                parts[column.name].append(values)
                at += values.nbytes
        self._at = at
        return {
            column.name: Ragged(
                np.array([len(p) for p in parts[column.name]], np.int64),
                np.concatenate([np.zeros(0, column.type), *parts[column.name]]),
            )
            if column.count_type
            else np.concatenate([np.zeros(0, column.type), *parts[column.name]])
            for column in element.columns
        }


def _even(table: np.ndarray, element: Element, lengths: list[int]) -> bool:
    """Whether the lists of all rows have the lengths of the first row's."""
    return all(
        bool((table[f"#{column.name}"] == length).all())
        for column, length in zip(element.columns, lengths)
        if column.count_type
    )


def _cast(values: list[float] | Floats, column: Column) -> Floats:
    """Numbers of a text body in the declared type; integers out of its range are kept."""
    numbers = np.asarray(values, np.float64)
    kind = np.dtype(column.type)
    if kind.kind not in "iu" or not np.isfinite(numbers).all():
        return numbers
    fits = (numbers >= np.iinfo(kind).min) & (numbers <= np.iinfo(kind).max)
    return numbers.astype(kind if fits.all() else np.int64)


def _short(path: Path, element: Element, held: int) -> InputError:
    return InputError(
        f"{path}: its header declares {element.count} rows of element '{element.name}', but the "
        f"file holds {held}",
        "the file was truncated or altered: " + REPAIR,
    )

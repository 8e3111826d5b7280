"""The body of a PLY file, text or binary, as one table for each element."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gf_usd.assets.mesh_data import REPAIR
from gf_usd.errors import InputError
from gf_usd.model import Floats, Ints


@dataclass(frozen=True)
class Column:
    """A property: a number, or a list of them."""

    name: str
    type: str  # numpy's, without the byte order
    count_type: str = ""  # of the list's length; empty: a single number


@dataclass(frozen=True)
class Element:
    """What the header announces."""

    name: str
    count: int
    columns: list[Column]


@dataclass(frozen=True)
class Ragged:
    """A list property: counts (n,) and the values (sum of counts,) one after the other."""

    counts: Ints
    values: Floats | Ints


Table = dict[str, Floats | Ragged]


def read_body(
    path: Path, data: bytes, start: int, elements: list[Element], order: str
) -> dict[str, Table]:
    """The columns of every element by their names.

    Parameters
    ----------
    data : the whole file.   start : where its header ends.
    order : "<" or ">" of binary files, "" of text.

    Raises InputError for a body that is shorter than announced or holds what is no number.
    """
    body = _Text(path, data, start) if not order else _Binary(path, data, start, order)
    return {element.name: body.read(element) for element in elements if element.columns}


class _Text:
    """One row a line."""

    def __init__(self, path: Path, data: bytes, start: int) -> None:
        self._path = path
        first = data[:start].count(b"\n") + 1
        lines = data[start:].decode("ascii", errors="replace").splitlines()
        self._rows = [(n, words) for n, line in enumerate(lines, first) if (words := line.split())]
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
        for number, words in rows:
            at = 0
            numbers = self._numbers(number, words)
            for column in element.columns:
                count = 1
                if column.count_type:
                    count = self._count(number, numbers[at : at + 1])
                    at += 1
                if at + count > len(numbers):
                    raise self._error(
                        number, f"{element.name} needs {at + count} numbers, has {len(numbers)}"
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
        for number, words in rows:
            if len(words) < width:
                raise self._error(number, f"{element.name} needs {width} numbers, has {len(words)}")
            flat.extend(self._numbers(number, words[:width]))
        table = np.array(flat).reshape(-1, width)
        return {c.name: _cast(table[:, i], c) for i, c in enumerate(element.columns)}

    def _numbers(self, number: int, words: list[str]) -> list[float]:
        try:
            return [float(word) for word in words]
        except ValueError:
            raise self._error(number, f"'{' '.join(words)[:60]}' holds what is no number") from None

    def _count(self, number: int, found: list[float]) -> int:
        if not found or not (0 <= found[0] < 1e6 and found[0] == int(found[0])):
            raise self._error(number, f"a list has the length {found[0] if found else 'missing'}")
        return int(found[0])

    def _error(self, line: int, what: str) -> InputError:
        return InputError(f"{self._path}, line {line}: {what}", REPAIR)


class _Binary:
    """Rows packed one after the other."""

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
    """True where every row's lists are as long as the first row's."""
    return all(
        bool((table[f"#{column.name}"] == length).all())
        for column, length in zip(element.columns, lengths)
        if column.count_type
    )


def _cast(values: list[float] | Floats, column: Column) -> Floats:
    """Text numbers as the header's type; a whole number that does not fit stays as it is."""
    numbers = np.asarray(values, np.float64)
    kind = np.dtype(column.type)
    if kind.kind not in "iu" or not np.isfinite(numbers).all():
        return numbers
    fits = (numbers >= np.iinfo(kind).min) & (numbers <= np.iinfo(kind).max)
    return numbers.astype(kind if fits.all() else np.int64)


def _short(path: Path, element: Element, held: int) -> InputError:
    return InputError(
        f"{path}: its header announces {element.count} of element '{element.name}', "
        f"and the file holds {held}",
        "it was cut off or altered: " + REPAIR,
    )

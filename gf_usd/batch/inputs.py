"""What the jobs' assets consist of, found out in another process.

USD may crash on a damaged file; so it reads them in a child, which names each asset when it is done
with it.  What a crash was at is left out, and the child goes on with the next.
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gf_usd.batch.child import Children

AT_ONCE = 200  # assets of one child: a command line has an end
PATIENCE = 120.0  # [s] for one asset: a large mesh takes seconds


class InputTable:
    """The inputs of assets by path; each is read once.

    A row is ``{"files": [[path, sha256], ...], "missing": [...]}``, or ``{"error": why}`` for what
    cannot be read: a bake will say more.  Safe for threads.
    """

    def __init__(self, children: Children, rows: Mapping[str, Any] | None = None) -> None:
        self._children = children
        self._rows: dict[str, Any] = dict(rows or {})
        self._lock = threading.Lock()

    def read(self, paths: Iterable[Path]) -> dict[str, Any]:
        """The rows of these paths."""
        wanted = [str(path) for path in paths]
        with self._lock:
            todo = [name for name in dict.fromkeys(wanted) if name not in self._rows]
            for start in range(0, len(todo), AT_ONCE):
                self._rows.update(_ask(self._children, todo[start : start + AT_ONCE]))
        return {name: self._rows[name] for name in wanted}


def _ask(children: Children, names: Sequence[str]) -> dict[str, Any]:
    """Rows of all the names, asking as many children as crash."""
    rows: dict[str, Any] = {}
    while left := [name for name in names if name not in rows]:
        # it is a child itself, which may crash and has its time
        words = ("inputs", "--limits", "none", "--json")
        command = [sys.executable, "-m", "gf_usd", *words, *left]
        ended = children.run(command, lambda line: None, timeout=PATIENCE + len(left))
        if ended is None or ended.stopped:
            return {**{name: {"error": "interrupted"} for name in left}, **rows}
        # a line that a crash cut short says nothing
        for line in ended.out[: ended.out.rfind("\n") + 1].splitlines():
            row = json.loads(line)
            rows[row.pop("asset")] = row
        first = next((name for name in left if name not in rows), None)
        if first is not None:
            how = "took too long" if ended.timed_out else f"ended with status {ended.status}"
            rows[first] = {"error": f"reading {first} {how}"}
    return rows


def stamps(inputs: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
    """(size, time of change) of every file of the rows: another one means another content."""
    found = {}
    for name, row in inputs.items():
        for file, _ in row.get("files", ()):
            path = Path(name).absolute().parent / file
            try:
                seen = path.stat()
            except OSError:
                found[str(path)] = (-1, -1)
            else:
                found[str(path)] = (seen.st_size, seen.st_mtime_ns)
    return found

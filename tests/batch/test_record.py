"""The inputs of many assets, read in another process that may die."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from batch_jobs import TRIANGLE

from gf_usd.batch.record import InputTable
from gf_usd.system.processes import Children, ProcessResult


class Fragile(Children):
    """A reader that dies at some names and is slow at others."""

    def __init__(self, deadly: Sequence[str], slow: Sequence[str] = ()) -> None:
        super().__init__()
        self._deadly, self._slow, self.requests = deadly, slow, list[list[str]]()

    def run(
        self, command: Sequence[str], on_line: Callable[[str], None], **how: Any
    ) -> ProcessResult | None:
        names = list(command[command.index("--json") + 1 :])
        self.requests.append(names)
        out, status, late = "", 0, False
        for name in names:
            if name in self._deadly:
                out, status = out + '{"asset": "' + name, -11  # a crash in the middle of a line
                break
            if name in self._slow:
                status, late = -15, True
                break
            out += json.dumps({"asset": name, "files": [[name, "0"]], "missing": []}) + "\n"
        return ProcessResult(
            status=status, out=out, err="", seconds=1.0, cpu_seconds=1.0, peak_memory=1,
            timed_out=late, stopped=False,
        )  # fmt: skip


def test_a_crash_costs_one_asset(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in "abcde"]
    children = Fragile(deadly=[str(paths[1])], slow=[str(paths[3])])
    table = InputTable(children)
    rows = table.read(paths)
    assert [key for key, row in rows.items() if "error" in row] == [str(paths[1]), str(paths[3])]
    assert "ended with status -11" in rows[str(paths[1])]["error"]
    assert "took too long" in rows[str(paths[3])]["error"]
    assert [len(names) for names in children.requests] == [5, 3, 1]
    table.read(paths)
    assert len(children.requests) == 3, "what is known is not read again"


def test_nothing_is_read_once_all_is_stopped(tmp_path: Path) -> None:
    children = Children()
    children.stop()
    assert InputTable(children).read([tmp_path / "a"]) == {
        str(tmp_path / "a"): {"error": "interrupted"}
    }


@pytest.mark.slow
def test_the_real_reader(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.usda", tmp_path / "bad.usda"
    good.write_text(TRIANGLE, encoding="utf-8")
    bad.write_text(TRIANGLE[:120], encoding="utf-8")
    rows = InputTable(Children()).read([bad, good, tmp_path / "none.obj"])
    assert [name for name, _ in rows[str(good)]["files"]] == ["good.usda"]
    assert "is damaged" in rows[str(bad)]["error"]
    assert "does not exist" in rows[str(tmp_path / "none.obj")]["error"]


@pytest.mark.parametrize("count", [0, 1])
def test_few_are_enough(tmp_path: Path, count: int) -> None:
    assert len(InputTable(Fragile([])).read([tmp_path / "a"] * count)) == count

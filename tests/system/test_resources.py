"""The cores, the memory and the disk that a process may use."""

from __future__ import annotations

from pathlib import Path

import pytest

from gf_usd.system import resources, taichi_runtime


@pytest.mark.parametrize(
    ("limit", "found"),
    [("max 100000", 8), ("150000 100000", 2), ("100000 100000", 1), ("1000 100000", 1),
     ("1600000 100000", 8), (None, 8)],
)  # fmt: skip
def test_the_cores_of_a_container_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str | None, found: int
) -> None:
    monkeypatch.setattr(resources.os, "sched_getaffinity", lambda pid: set(range(8)), raising=False)
    path = tmp_path / "cpu.max"
    if limit:
        path.write_text(f"{limit}\n", encoding="ascii")
    monkeypatch.setattr(resources, "CPU_LIMIT", str(path))
    assert resources.cores() == found
    # a bake starts as many threads: more of them would wait for each other
    assert taichi_runtime.cores is resources.cores

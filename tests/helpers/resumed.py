"""A bake that was ended early and resumed, against the same bake in one go."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd

OWN = ("seconds", "notes", "outputs", "command")  # of the report: of the run, not of the motion


def samples(path: Path) -> dict:
    """Every sample of every attribute of a clip, as bytes."""
    layer = Sdf.Layer.OpenAsAnonymous(str(path))
    found = {}

    def visit(where: Sdf.Path) -> None:
        if where.IsPropertyPath():
            for code in layer.ListTimeSamplesForPath(where):
                value = np.array(layer.QueryTimeSample(where, code))
                found[str(where), code] = value.dtype.str, value.shape, value.tobytes()

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found


def require_same(one: Path, other: Path) -> None:
    """All files of two bakes are there, and hold the same bits."""
    clips = sorted(p.relative_to(one) for p in one.glob("*.clips/*.usdc"))
    assert clips
    assert clips == sorted(p.relative_to(other) for p in other.glob("*.clips/*.usdc"))
    for clip in clips:
        a, b = samples(one / clip), samples(other / clip)
        assert a.keys() == b.keys(), f"{clip}: {sorted(a.keys() ^ b.keys())}"
        differ = [key for key in a if a[key] != b[key]]
        assert not differ, f"{clip}: {differ}"
    for text in (path.relative_to(one) for path in one.glob("*.clips/manifest.usda")):
        assert (one / text).read_text() == (other / text).read_text(), str(text)
    for cache in one.glob("*.cache.usdc"):
        a, b = (
            Sdf.Layer.OpenAsAnonymous(str(folder / cache.name)).ExportToString()
            for folder in (one, other)
        )
        assert a == b, cache.name
    for report in one.glob("*.report.json"):
        a, b = (json.loads((folder / report.name).read_text()) for folder in (one, other))
        for bake in (*a["bakes"], *b["bakes"]):
            del bake["cache"]
        differ = [k for k in sorted({*a, *b} - {*OWN}) if a.get(k) != b.get(k)]
        assert not differ, f"{report.name}: {differ}"
    leftovers = [p.name for p in other.rglob("*") if "partial" in p.name or "checkpoint" in p.name]
    assert not leftovers, f"left: {leftovers}"


def require_whole(folder: Path) -> None:
    """What lies in a folder under a final name is no half of a file."""
    for path in folder.rglob("*"):
        if "partial" in path.name or path.is_dir():
            continue
        if path.suffix in (".usda", ".usdc"):
            assert Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path))), path
        elif path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                assert all(file[name] is not None for name in file.files)
        elif path.suffix == ".json":
            json.loads(path.read_text())


def start(*arguments: object) -> subprocess.Popen:
    """``gf-usd`` in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "gf_usd", *map(str, arguments)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env={**os.environ},
    )  # fmt: skip


def wait_for(process: subprocess.Popen, path: Path) -> None:
    """Until a file is there; fails where the process ends first, or a minute passes."""
    deadline = time.monotonic() + 60.0
    while not path.exists():
        assert process.poll() is None, "it ended before"
        assert time.monotonic() < deadline, f"no {path.name} within a minute"
        time.sleep(0.005)

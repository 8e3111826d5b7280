"""When a job is the same as before, and when it is not."""

from __future__ import annotations

import ast
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from batch_jobs import TRIANGLE, job, outcome

from gf_usd.batch import record
from gf_usd.batch.job import Job
from gf_usd.batch.record import (
    describe,
    file_stamps,
    finished,
    identity,
    input_paths,
    read_record,
    write_record,
)
from gf_usd.readers.inputs import read_inputs
from gf_usd.system.fingerprint import APART, PACKAGE


def rows(of: Job) -> dict:
    """What `gf-usd inputs` says of the job's assets."""
    found = {path: read_inputs(path) for path in input_paths(of)}
    return {
        str(path): {"files": [list(row) for row in i.files], "missing": list(i.missing)}
        for path, i in found.items()
    }


def name_of(of: Job) -> str:
    return identity(describe(of, rows(of)))


def with_texture(folder: Path) -> Job:
    made = job(folder, material="rubber", seed=1)
    text = TRIANGLE.replace("{\n", "{\n    asset inputs:file = @./t.png@\n", 1)
    made.asset.write_text(text, encoding="utf-8")
    (folder / "t.png").write_bytes(b"red")
    return made


CHANGES: dict[str, Callable[[Job, Path], Job]] = {
    "asset": lambda of, folder: [of.asset.write_text(of.asset.read_text() + "\n"), of][1],
    "texture": lambda of, folder: [(folder / "t.png").write_bytes(b"blue"), of][1],
    "texture gone": lambda of, folder: [(folder / "t.png").unlink(), of][1],
    "seed": lambda of, folder: replace(of, options={**of.options, "seed": 2}),
    "material": lambda of, folder: replace(of, options={**of.options, "material": "jelly"}),
    "place": lambda of, folder: replace(of, root=folder / "deep" / "er" / of.root.name),
    "name": lambda of, folder: replace(of, root=of.root.with_name("b.usda")),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_decides_the_result_decides_the_identity(tmp_path: Path, change: str) -> None:
    of = with_texture(tmp_path)
    before = name_of(of)
    assert name_of(of) == before
    assert name_of(CHANGES[change](of, tmp_path)) != before


def test_the_code_the_schema_and_libraries_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = job(tmp_path)
    known = record.program()
    assert len(known["code"]) == len(known["schema"]) == 64
    assert known["libraries"]["usd-core"]
    names = {name_of(of)}
    for change in ({"code": "x"}, {"schema": "x"}, {"libraries": {}}):
        monkeypatch.setattr(record, "program", lambda more=change: {**known, **more})
        names.add(name_of(of))
    assert len(names) == 4


def test_what_does_not_decide_it_does_not(tmp_path: Path) -> None:
    of = with_texture(tmp_path)
    before = name_of(of)
    more = {"threads": 2, "max_hours": 3.0, "strict": True}
    assert name_of(replace(of, options={**of.options, **more})) == before
    os.utime(of.asset, (1, 1))
    assert name_of(of) == before
    # rubber is what a bake takes where no material is given
    plain = {k: v for k, v in of.options.items() if k != "material"}
    assert name_of(replace(of, options=plain)) == before


def test_a_material_file_counts_by_its_content(tmp_path: Path) -> None:
    wax = tmp_path / "wax.usda"
    wax.write_text(TRIANGLE, encoding="utf-8")
    of = job(tmp_path, material=str(wax))
    before = name_of(of)
    wax.write_text(TRIANGLE + "\n", encoding="utf-8")
    assert name_of(of) != before


@pytest.mark.slow
def test_no_bake_runs_what_the_code_leaves_out() -> None:
    """The hash of the code is over everything but these; nothing else may import them."""
    apart = {f"gf_usd.{package}" for package in APART}
    for path in PACKAGE.rglob("*.py"):
        # An advisor is shown a picture; a batch, whose records the hash is for, uses none.  Nor
        # does it call the functions of the API that draw.  The package itself names types of
        # results, which are loaded when they are used.
        inside = path.relative_to(PACKAGE)
        if inside.parts[0] in (*APART, "__init__.py", "api", "cli"):
            continue
        if str(inside) == "pipeline/prepared.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            names = [alias.name for alias in getattr(node, "names", []) if hasattr(alias, "name")]
            found = {".".join(name.split(".")[:2]) for name in (module, *names)}
            assert not found & apart, f"{path} imports {found & apart}"


def baked(of: Job) -> list[Path]:
    """Files as a bake leaves them."""
    of.root.parent.mkdir(exist_ok=True)
    paths = [of.root, of.sibling(".cache.usdc")]
    for path in paths:
        path.write_text(path.name, encoding="utf-8")
    return paths


def test_a_finished_job_is_known_by_its_files(tmp_path: Path) -> None:
    of = job(tmp_path)
    paths = baked(of)
    done = outcome(of.name, "done", attempts=1, frames=4)
    write_record(of, done, identity="x", description={}, outputs=paths)
    kept = finished(of, "x")
    assert kept is not None
    assert (kept.state, kept.frames, kept.attempts) == ("kept", 4, 0)
    assert finished(of, "y") is None
    assert finished(of, None) is None
    # copied elsewhere and back: another time, the same content
    os.utime(paths[1], (1, 1))
    assert finished(of, "x") is not None
    paths[1].write_text(paths[1].name[::-1], encoding="utf-8")
    assert finished(of, "x") is None
    paths[1].unlink()
    assert finished(of, "x") is None


@pytest.mark.parametrize("state", ["failed", "crashed", "timeout", "refused"])
def test_a_job_that_failed_is_not_finished(tmp_path: Path, state: str) -> None:
    of = job(tmp_path)
    write_record(of, outcome(of.name, state), identity="x", description={}, outputs=baked(of))
    assert read_record(of) is not None
    assert finished(of, "x") is None


@pytest.mark.parametrize("text", ["", "{", "[]", '{"outcome": 3}', '{"outcome": {}}'])
def test_a_record_that_is_none_says_nothing(tmp_path: Path, text: str) -> None:
    of = job(tmp_path)
    of.root.parent.mkdir()
    of.record.write_text(text, encoding="utf-8")
    assert read_record(of) is None
    assert finished(of, "x") is None


def test_a_changed_file_has_another_stamp(tmp_path: Path) -> None:
    of = with_texture(tmp_path)
    known = rows(of)
    before = file_stamps(known)
    assert set(before) == {str(of.asset), str(tmp_path / "t.png")}
    assert file_stamps(known) == before
    (tmp_path / "t.png").write_bytes(b"other")
    assert file_stamps(known) != before
    (tmp_path / "t.png").unlink()
    assert file_stamps(known)[str(tmp_path / "t.png")] == (-1, -1)

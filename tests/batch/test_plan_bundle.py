"""Jobs that travel: the bundle's files, paths of another machine, ranges of tasks."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import pytest
from batch_jobs import TRIANGLE, job

from gf_usd.batch.openjd import template, write_bundle
from gf_usd.batch.plan import (
    BatchPlan,
    is_bundle,
    jobs_text,
    parse_task_range,
    read_jobs,
    with_mapped_paths,
    with_output_folder,
)
from gf_usd.batch.record import InputTable
from gf_usd.core.errors import BakeError, InputError, UsageError
from gf_usd.system.processes import Children

OPENJD = Path(sys.executable).with_name("openjd")


def plan(folder: Path, count: int = 3, **options: Any) -> BatchPlan:
    jobs = tuple(job(folder, f"a.seed{i}", seed=i, **options) for i in range(count))
    return BatchPlan(jobs=jobs, out=folder / "out", title="toys", timeout=60.0, retries=1)


def test_jobs_come_back_as_they_went(tmp_path: Path) -> None:
    planned = plan(tmp_path, pins=["/A"], repair=True)
    path = tmp_path / "jobs.json"
    path.write_text(jobs_text(planned), encoding="utf-8")
    assert is_bundle(path)
    assert read_jobs(path) == planned
    elsewhere = with_output_folder(planned, Path("/other"))
    assert elsewhere.jobs[1].root == Path("/other/a.seed1.usda")
    assert elsewhere.jobs[1].asset == planned.jobs[1].asset
    path.write_text('{"form": "gf-usd jobs 1", "jobs": [{}]}', encoding="utf-8")
    with pytest.raises(InputError, match="contains no jobs"):
        read_jobs(path)
    path.write_text("{}", encoding="utf-8")
    assert not is_bundle(path)


def rules(folder: Path, *rows: tuple[str, str, str]) -> Path:
    keys = ("source_path_format", "source_path", "destination_path")
    tree = {"version": "pathmapping-1.0", "path_mapping_rules": [dict(zip(keys, r)) for r in rows]}
    path = folder / "rules.json"
    path.write_text(json.dumps(tree), encoding="utf-8")
    return path


def test_paths_become_those_of_the_worker(tmp_path: Path) -> None:
    first = plan(tmp_path, 1)
    material = str(tmp_path / "looks" / "wax.usda")
    planned = replace(
        first, jobs=(replace(first.jobs[0], options={"material": f"rubber,{material}"}),)
    )
    made = with_mapped_paths(
        planned,
        # the longer source counts, whatever the order
        rules(tmp_path, ("POSIX", "/", "/wrong"), ("POSIX", str(tmp_path), "/sent"),
              ("POSIX", str(tmp_path / "out"), "/results")),
    )  # fmt: skip
    (found,) = made.jobs
    assert found.asset == Path("/sent/a.usda")
    assert found.root == Path("/results/a.seed0.usda")
    assert made.out == Path("/results")
    assert found.options["material"] == "rubber,/sent/looks/wax.usda"
    # whole parts of a path, not letters
    other = rules(tmp_path, ("POSIX", str(tmp_path)[:-1], "/wrong"))
    assert with_mapped_paths(planned, other).jobs == planned.jobs
    windows = replace(planned.jobs[0], asset=PurePosixPath(r"C:\props\duck.usda"))
    drive = rules(tmp_path, ("WINDOWS", "c:/props", "/mnt/props"))
    assert with_mapped_paths(replace(planned, jobs=(windows,)), drive).jobs[0].asset == Path(
        "/mnt/props/duck.usda"
    )
    drive.write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="no path mapping rules"):
        with_mapped_paths(planned, drive)


@pytest.mark.parametrize(
    ("text", "numbers"), [("0", (0,)), ("0-2", (0, 1, 2)), ("5,1-7:3,5", (5, 1, 4, 7))]
)
def test_ranges_name_jobs(text: str, numbers: tuple[int, ...]) -> None:
    assert parse_task_range(text, 8) == numbers


@pytest.mark.parametrize("text", ["", "a", "1-", "-1", "0-8", "3-2"])
def test_ranges_that_name_none_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--tasks"):
        parse_task_range(text, 8)


@pytest.mark.slow
def test_a_bundle_holds_what_a_farm_asks_for(tmp_path: Path) -> None:
    planned = plan(tmp_path)
    planned.jobs[0].asset.write_text(
        TRIANGLE.replace("{\n", "{\n    asset inputs:file = @./t.png@\n", 1), encoding="utf-8"
    )
    (tmp_path / "t.png").touch()
    folder = tmp_path / "bundle"
    files = write_bundle(planned, folder, chunk=2, program="py", table=InputTable(Children()))
    assert sorted(p.name for p in folder.iterdir()) == sorted(p.name for p in files)
    sent = json.loads((folder / "asset_references.json").read_text("utf-8"))["assetReferences"]
    assert sent["inputs"]["filenames"] == [str(tmp_path / "a.usda"), str(tmp_path / "t.png")]
    assert sent["outputs"]["directories"] == [str(tmp_path / "out")]
    values = json.loads((folder / "parameter_values.json").read_text("utf-8"))["parameterValues"]
    flat = json.loads((folder / "parameters.json").read_text("utf-8"))
    assert {row["name"]: row["value"] for row in values} == flat
    assert (flat["Jobs"], flat["JobsPerTask"], flat["Python"]) == ("0-2", 2, "py")
    with pytest.raises(UsageError, match="--chunk is 0"):
        write_bundle(planned, folder, chunk=0, program="py", table=InputTable(Children()))
    empty = replace(planned, jobs=())
    with pytest.raises(UsageError, match="no jobs"):
        write_bundle(empty, folder, chunk=1, program="py", table=InputTable(Children()))


def test_a_task_is_ended_in_time(tmp_path: Path) -> None:
    from gf_usd.system.processes import GRACE

    bake = template(plan(tmp_path), chunk=4)["steps"][0]["script"]["actions"]["onRun"]
    # four jobs of a minute, each twice at most, and a minute to start and end
    assert bake["timeout"] == 4 * 2 * 60 + 60
    assert bake["cancelation"]["mode"] == "NOTIFY_THEN_TERMINATE"
    assert bake["cancelation"]["notifyPeriodInSeconds"] > GRACE
    endless = replace(plan(tmp_path), timeout=None)
    assert "timeout" not in template(endless, chunk=4)["steps"][0]["script"]["actions"]["onRun"]


def test_chunks_grow_only_where_tasks_have_no_bound(tmp_path: Path) -> None:
    def target(planned: BatchPlan, slice: int | None = None) -> int:
        space = template(planned, 1, slice)["steps"][0]["parameterSpace"]
        return space["taskParameterDefinitions"][0]["chunks"]["targetRuntimeSeconds"]

    limited = plan(tmp_path, frames=9, clip_frames=2)
    endless = replace(limited, timeout=None)
    assert target(endless) == 900
    assert target(limited) == target(endless, slice=1) == 0


def test_a_folder_that_cannot_be_made_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    table = InputTable(Children())
    with pytest.raises(BakeError, match="cannot be created") as refused:
        write_bundle(plan(tmp_path), tmp_path / "file" / "b", chunk=1, program="py", table=table)
    assert "--openjd" in refused.value.hint


def test_slices_are_steps_that_wait_for_each_other(tmp_path: Path) -> None:
    planned = plan(tmp_path, frames=25, clip_frames=4)
    steps = template(planned, chunk=1, slice=2)["steps"]
    names = [step["name"] for step in steps]
    assert names == ["Bake 1 of 3", "Bake 2 of 3", "Bake 3 of 3", "Report"]
    before = [step.get("dependencies") for step in steps]
    assert before == [None, *([{"dependsOn": name}] for name in names[:3])]
    for number, step in enumerate(steps[:3], 1):
        arguments = step["script"]["actions"]["onRun"]["args"]
        assert arguments[-4:] == ["--slice", "2", "--part", f"{number}/3"]
    # the longest job says how many there are, and jobs that fit into one slice have one step
    mixed = replace(planned, jobs=(*planned.jobs, job(tmp_path, "b", frames=41, clip_frames=4)))
    assert len(template(mixed, chunk=1, slice=2)["steps"]) == 5 + 1
    assert [s["name"] for s in template(planned, chunk=1, slice=6)["steps"]] == ["Bake", "Report"]


@pytest.mark.slow
@pytest.mark.skipif(not OPENJD.is_file() and not shutil.which("openjd"), reason="no openjd-cli")
@pytest.mark.parametrize(("slice", "steps"), [(None, 2), (1, 5)])
def test_the_real_openjd_accepts_it(tmp_path: Path, slice: int | None, steps: int) -> None:
    program = str(OPENJD) if OPENJD.is_file() else "openjd"
    folder = tmp_path / "bundle"
    planned = plan(tmp_path, frames=9, clip_frames=2)
    write_bundle(planned, folder, chunk=2, program="py", table=InputTable(Children()), slice=slice)

    def ask(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [program, arguments[0], str(folder / "template.json"), *arguments[1:]],
            capture_output=True, text=True, check=False,
        )  # fmt: skip

    assert ask("check").returncode == 0
    done = ask("summary", "-p", f"file://{folder / 'parameters.json'}", "--output", "json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)["total_steps"] == steps
    # and it would say if it were none
    tree = json.loads((folder / "template.json").read_text("utf-8"))
    tree["steps"][0]["parameterSpace"]["taskParameterDefinitions"][0]["type"] = "CHUNK[WORD]"
    (folder / "template.json").write_text(json.dumps(tree), encoding="utf-8")
    assert ask("check").returncode != 0

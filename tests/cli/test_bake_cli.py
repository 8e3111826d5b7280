"""gf-usd bake, from the command line to the files, and how it refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

BALL = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Z"
    defaultPrim = "Toy"
    timeCodesPerSecond = 30
    startTimeCode = 101
)
def Xform "Toy" (kind = "component") {
    def Sphere "Ball" {
        double radius = 5
        color3f[] primvars:displayColor = [(0.8, 0.1, 0.1)]
    }
}
"""
SHEET = """#usda 1.0
(
    defaultPrim = "Cloth"
)
def Mesh "Cloth" {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
}
"""
SMALL = ("--particles", "200", "--frames", "3")


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A red ball of 5 cm in a folder of its own."""
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    path = tmp_path / "in" / "toy.usda"
    path.write_text(BALL, encoding="utf-8")
    return path


def bake(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The command in a folder, as a person runs it."""
    return subprocess.run(
        [sys.executable, "-m", "gf_usd", "bake", *map(str, arguments)],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


def files(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


def test_a_bake_writes_its_layers_and_leaves_the_asset_alone(toy):
    out = toy.parent.parent / "out"
    before = toy.read_bytes(), toy.stat().st_mtime_ns
    done = bake(out, toy, "--material", "jelly", *SMALL)
    assert done.returncode == 0, done.stderr
    assert files(out) == ["toy.jelly.cache.usdc", "toy.jelly.report.json", "toy.jelly.usda"]
    assert (toy.read_bytes(), toy.stat().st_mtime_ns) == before
    assert files(toy.parent) == ["toy.usda"]
    # Data and progress do not mix: the summary is on stdout, frames are on stderr.
    assert "toy.jelly.usda  " in done.stdout
    assert "jelly: 3 frames" in done.stdout
    assert "frame 3/3" in done.stderr
    assert "frame 3/3" not in done.stdout

    stage = Usd.Stage.Open(str(out / "toy.jelly.usda"))
    assert stage.GetDefaultPrim().GetPath() == "/Toy"
    assert stage.GetTimeCodesPerSecond() == 30.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (101.0, 103.0)
    (mesh,) = (UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    assert mesh.GetPointsAttr().GetTimeSamples() == [101.0, 102.0, 103.0]
    # Three radii over the floor and falling: g t^2 / 2 in cm after two frames of 1/30 s.
    low = [np.asarray(mesh.GetPointsAttr().Get(t))[:, 2].min() for t in (101.0, 103.0)]
    # r is that of a ball of the mesh's volume, a little less than the sphere's 5 cm.
    assert 14.5 < low[0] <= 15.0
    assert low[1] - low[0] == pytest.approx(-0.5 * 981.0 * (2.0 / 30.0) ** 2, rel=1e-5)


def test_json_on_stdout_has_paths_settings_and_health(toy):
    out = toy.parent.parent / "out"
    done = bake(out, toy, *SMALL, "--json", "--drop", "0", "--seed", "7", "-o", "a/film.usd")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert set(told) == {
        "root", "report", "particles", "frames", "seconds", "settings", "bakes", "notes", "check",
    }  # fmt: skip
    assert (told["root"], told["report"]) == ("a/film.usd", "a/film.report.json")
    assert told["frames"] == 3
    assert told["settings"]["seed"] == 7
    assert told["check"] == []
    (one,) = told["bakes"]
    assert one["look"] == one["material"]["name"] == "rubber"
    assert one["cache"] == "a/film.cache.usdc"
    assert one["health"]["frames"] == 3
    assert one["health"]["substeps"] > 0
    assert files(out) == ["a", "a/film.cache.usdc", "a/film.report.json", "a/film.usd"]
    report = json.loads((out / "a" / "film.report.json").read_text())
    assert len(report["bakes"][0]["per_frame"]) == 3
    assert report["particles"] == told["particles"]
    assert report["command"].startswith("gf-usd bake toy.usda --material rubber")


def test_a_dry_run_writes_nothing_and_says_the_same_as_the_bake(toy):
    out = toy.parent.parent / "out"
    planned = bake(out, toy, *SMALL, "--dry-run", "--json", "-o", "new/")
    assert planned.returncode == 0, planned.stderr
    assert files(out) == []
    told = json.loads(planned.stdout)
    assert told["outputs"] == [
        "new/toy.rubber.usda", "new/toy.rubber.cache.usdc", "new/toy.rubber.report.json",
    ]  # fmt: skip
    done = json.loads(bake(out, toy, *SMALL, "--json", "-o", "new/").stdout)
    assert files(out) == ["new", *sorted(told["outputs"])]
    assert done["particles"] == told["particles"]
    assert done["frames"] == told["frames"] == 3
    assert done["bakes"][0]["material"] == told["materials"][0]
    # Substeps of the first frame of motion; the solver halves the step only where it has to.
    assert done["bakes"][0]["health"]["substeps"] == 2 * told["substeps_per_frame"]["rubber"]
    words = bake(out, toy, *SMALL, "--dry-run", "-o", "other/")
    assert "would write other/toy.rubber.usda" in words.stdout
    assert files(out) == ["new", *sorted(told["outputs"])]


def test_results_are_replaced_only_when_asked(toy):
    out = toy.parent.parent / "out"
    assert bake(out, toy, *SMALL, "-q").returncode == 0
    kept = {name: (out / name).read_bytes() for name in files(out)}
    again = bake(out, toy, *SMALL, "-q", "--seed", "1")
    assert again.returncode == 2
    assert "exists already" in again.stderr
    assert "hint: add --overwrite" in again.stderr
    assert {name: (out / name).read_bytes() for name in files(out)} == kept
    forced = bake(out, toy, *SMALL, "-q", "--seed", "1", "--overwrite")
    assert forced.returncode == 0, forced.stderr
    assert (forced.stdout, forced.stderr) == ("", "")
    assert set(files(out)) == set(kept)
    cache = "toy.rubber.cache.usdc"
    assert (out / cache).read_bytes() != kept[cache]


def unwritable(tmp_path: Path) -> Path | None:
    """A folder without write permission; for the superuser, one of the kernel's."""
    folder = tmp_path / "sealed"
    folder.mkdir()
    folder.chmod(0o555)
    if not os.access(folder, os.W_OK):
        return folder
    kernel = Path("/proc/self")
    return kernel if kernel.is_dir() else None


@pytest.mark.parametrize(
    ("arguments", "status", "message", "hint"),
    [
        (("gone.usda",), 3, "gone.usda does not exist", "give a file that ends in"),
        (("text.usda",), 3, "text.usda is not a USD file", "check what the file really is"),
        (("sheet.usda",), 3, "</Cloth>|/Cloth: the surface is open", "give the mesh thickness"),
        (("toy.usda", "-m", "granite"), 2, "there is no material 'granite'", "choose one of"),
        (("toy.usda", "-o", "SEALED/"), 2, "SEALED cannot be written to", "choose another folder"),
    ],
    ids=["missing", "text", "no volume", "material", "unwritable"],
)
def test_wrong_inputs_are_refused_quickly_in_words(toy, tmp_path, arguments, status, message, hint):
    folder = toy.parent
    (folder / "text.usda").write_text("Dear artist, this is not a stage.\n")
    (folder / "sheet.usda").write_text(SHEET)
    if "SEALED/" in arguments:
        sealed = unwritable(tmp_path)
        if sealed is None:
            pytest.skip("every folder of this system can be written to")
        arguments = [a.replace("SEALED", str(sealed)) for a in arguments]
        message = message.replace("SEALED", str(sealed))
    before = files(tmp_path)
    began = time.perf_counter()
    done = bake(folder, *arguments)
    # The bound people were promised; it takes about one second.
    assert time.perf_counter() - began < 5.0
    assert done.returncode == status
    assert done.stdout == ""
    said, _, advice = done.stderr.partition("\n\nhint: ")
    assert said.startswith("error: ")
    assert any(part in said for part in message.split("|"))
    assert hint in advice
    assert "Traceback" not in done.stderr
    assert len(done.stderr) < 1000
    assert files(tmp_path) == before


def test_an_option_that_does_not_parse_is_a_matter_of_usage(toy):
    done = bake(toy.parent, toy, "--frames", "many")
    assert done.returncode == 2
    assert "--frames" in done.stderr
    assert files(toy.parent) == ["toy.usda"]

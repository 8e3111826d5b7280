"""gf-usd inspect: the page, the JSON, the exit status."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

DUCK = Path(__file__).parents[2] / "samples" / "duck.usda"
FEW = ["--particles", "300", "--frames", "3"]

# A Z-up sheet, and a box 120 units wide that is inside out.
STAGE = """#usda 1.0
(
    defaultPrim = "Root"
    upAxis = "Z"
    metersPerUnit = 1
)
def Xform "Root"
{{
    def Mesh "Sheet"
    {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    }}
{more}
}}
"""
BOX = """
    def Mesh "Box"
    {
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4,
                                   1, 5, 7, 3]
        point3f[] points = [(0, 0, 0), (120, 0, 0), (0, 120, 0), (120, 120, 0),
                            (0, 0, 120), (120, 0, 120), (0, 120, 120), (120, 120, 120)]
    }
"""


def gf_usd(folder, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "gf_usd", *map(str, arguments)],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture
def sheet(tmp_path):
    path = tmp_path / "sheet.usda"
    path.write_text(STAGE.format(more=""), encoding="utf-8")
    return path


@pytest.fixture
def odd(tmp_path):
    path = tmp_path / "odd.usda"
    path.write_text(STAGE.format(more=BOX), encoding="utf-8")
    return path


def test_a_sound_asset_on_a_page(tmp_path):
    done = gf_usd(tmp_path, "inspect", DUCK, "-m", "rubber,jelly", *FEW)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == str(DUCK)
    assert lines[1].startswith("1 unit = 0.01 m (from the file), Y up (from the file)")
    (body,) = (line for line in lines if line.startswith("/Duck/Geom/Body"))
    assert body.split() == [
        "/Duck/Geom/Body", "3490", "3488", "quads", "watertight", "1", "281", "cm³", "outward",
        "filled",
    ]  # fmt: skip
    assert sum(line.startswith(("rubber ", "jelly ")) for line in lines) == 2
    assert lines[-1] == "can be baked"
    assert list(tmp_path.iterdir()) == []


def test_a_refused_asset_ends_with_the_words_of_bake_and_status_3(sheet, tmp_path):
    done = gf_usd(tmp_path, "inspect", sheet)
    refused = gf_usd(tmp_path, "bake", sheet)
    assert done.returncode == refused.returncode == 3
    assert done.stderr == refused.stderr
    assert done.stderr.startswith("error: ")
    assert "hint: " in done.stderr
    assert "refused" in done.stdout
    assert done.stdout.splitlines()[-1] == "warning: with --repair it can be baked"


def test_json_on_stdout_whatever_the_verdict(sheet, odd, tmp_path):
    refused = gf_usd(tmp_path, "inspect", sheet, "--json")
    assert refused.returncode == 3
    out = json.loads(refused.stdout)
    assert out["bakeable"] is False
    assert (
        refused.stderr == f"error: {out['refusal']['message']}\n\nhint: {out['refusal']['hint']}\n"
    )
    fine = gf_usd(tmp_path, "inspect", odd, "--json", *FEW)
    assert (fine.returncode, fine.stderr) == (0, "")
    assert json.loads(fine.stdout)["bakeable"] is True


def test_a_file_that_cannot_be_read_is_json_too(tmp_path):
    done = gf_usd(tmp_path, "inspect", "none.usda", "--json")
    assert done.returncode == 3
    out = json.loads(done.stdout)
    assert (out["file"], out["bakeable"]) == ("none.usda", False)
    assert "does not exist" in out["refusal"]["message"]


def test_wrong_options_are_wrong_usage(tmp_path):
    done = gf_usd(tmp_path, "inspect", DUCK, "--particles", "0")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--particles is 0" in done.stderr


def test_oddities_and_what_to_do_about_them(odd, tmp_path):
    done = gf_usd(tmp_path, "inspect", odd, *FEW)
    assert done.returncode == 0
    assert "inside out  filled" in done.stdout
    assert "rides along" in done.stdout
    assert "</Root/Box> is filled in spite of 1 of 1 shell inside out" in done.stdout
    assert "with --meters-per-unit 0.01 it would be 1.2 m" in done.stdout
    options = ["--repair", "--meters-per-unit", "0.01"]
    mended = gf_usd(tmp_path, "inspect", odd, *options, *FEW)
    assert "repaired for the fill: turned 1 part that faced the wrong way" in mended.stdout
    assert "1 unit = 0.01 m (as asked)" in mended.stdout
    assert "warning" not in mended.stdout


def test_bake_repairs_and_reports_it(odd, tmp_path):
    sizes = ["--particles", "300", "--frames", "2"]
    done = gf_usd(tmp_path, "bake", odd, "--repair", *sizes)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "odd.rubber.report.json").read_text(encoding="utf-8"))
    assert any("turned 1 part" in note for note in report["notes"])
    assert "--repair" in report["command"]

"""gf-usd inspect: the page, the JSON, the exit status."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

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


@pytest.fixture(autouse=True)
def in_the_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


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


def test_a_sound_asset_on_a_page(gf_usd, tmp_path):
    done = gf_usd("inspect", DUCK, "-m", "rubber,jelly", *FEW)
    assert (done.status, done.err) == (0, "")
    lines = done.out.splitlines()
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


def test_a_refused_asset_ends_with_the_words_of_bake_and_status_3(gf_usd, sheet, tmp_path):
    done = gf_usd("inspect", sheet)
    refused = gf_usd("bake", sheet)
    assert done.status == refused.status == 3
    assert done.err == refused.err
    assert done.err.startswith("error: ")
    assert "hint: " in done.err
    assert "refused" in done.out
    assert done.out.splitlines()[-1] == "warning: it can be baked with --repair"


def test_repair_is_no_answer_to_another_refusal(gf_usd, here: Path, block: Path) -> None:
    """A sound mesh whose size is out of range is sound with --repair, too, and as large."""
    done = gf_usd("inspect", block, "--meters-per-unit", "1e20")
    assert done.status == 3
    assert "the bodies would weigh" in done.err
    assert "--repair" not in done.out + done.err


def test_json_on_stdout_whatever_the_verdict(gf_usd, sheet, odd, tmp_path):
    refused = gf_usd("inspect", sheet, "--json")
    assert refused.status == 3
    out = json.loads(refused.out)
    assert out["bakeable"] is False
    assert refused.err == f"error: {out['refusal']['message']}\n\nhint: {out['refusal']['hint']}\n"
    fine = gf_usd("inspect", odd, "--json", *FEW)
    assert (fine.status, fine.err) == (0, "")
    assert json.loads(fine.out)["bakeable"] is True


def test_a_file_that_cannot_be_read_is_json_too(gf_usd, tmp_path):
    done = gf_usd("inspect", "none.usda", "--json")
    assert done.status == 3
    out = json.loads(done.out)
    assert (out["file"], out["bakeable"]) == ("none.usda", False)
    assert "does not exist" in out["refusal"]["message"]


def test_progress_is_shown_on_a_terminal_only(gf_usd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    seen = gf_usd("inspect", DUCK, *FEW)
    assert "inspecting (thin parts)" in seen.err
    assert "inspecting" not in seen.out
    refused = gf_usd("inspect", "none.usda", "--json")
    assert "reading" not in refused.err
    monkeypatch.undo()
    assert gf_usd("inspect", "none.usda").err == refused.err


def test_the_steps_of_an_inspection_are_told_as_they_begin() -> None:
    """A mesh of two million triangles takes most of a minute."""
    from gf_usd.pipeline.inspect import inspect

    told: list[str] = []
    inspect(
        DUCK, particles=300, frames="3", watch=lambda now: told.append(f"{now.stage} {now.what}")
    )
    assert [one for one in told if not one.startswith("compiling")] == [
        "reading duck.usda",
        "inspecting (meshes)",
        "filling (checking the meshes)",
        "filling (placing particles)",
        "filling (sampling the surface)",
        "filling (preparing contact)",
        "filling (separating limbs)",
        "inspecting (time and memory)",
        "inspecting (thin parts)",
    ]


def test_wrong_options_are_wrong_usage(gf_usd, tmp_path):
    done = gf_usd("inspect", DUCK, "--particles", "0")
    assert (done.status, done.out) == (2, "")
    assert "--particles is 0" in done.err


def test_oddities_and_what_to_do_about_them(gf_usd, odd, tmp_path):
    done = gf_usd("inspect", odd, *FEW)
    assert done.status == 0
    assert "inside out  filled" in done.out
    assert "follows the solid" in done.out
    assert "</Root/Box> is filled despite 1 of 1 shell inside out" in done.out
    assert "with --meters-per-unit 0.01 it would be 1.2 m" in done.out
    options = ["--repair", "--meters-per-unit", "0.01"]
    mended = gf_usd("inspect", odd, *options, *FEW)
    assert "repaired for the fill: turned 1 part of reversed winding" in mended.out
    assert "1 unit = 0.01 m (as requested)" in mended.out
    assert "warning" not in mended.out


def test_bake_repairs_and_reports_it(gf_usd, odd, tmp_path):
    sizes = ["--particles", "300", "--frames", "2"]
    done = gf_usd("bake", odd, "--repair", *sizes)
    assert done.status == 0, done.err
    report = json.loads((tmp_path / "odd.rubber.report.json").read_text(encoding="utf-8"))
    assert any("turned 1 part" in note for note in report["notes"])
    assert "--repair" in report["command"]


@pytest.mark.slow
def test_a_face_that_encloses_nothing_does_not_make_a_bake_slow(gf_usd, tmp_path: Path) -> None:
    path = tmp_path / "fin.usda"
    path.write_text(
        '#usda 1.0\n(\n metersPerUnit = 1\n)\ndef Mesh "Box"\n{\n'
        ' uniform token subdivisionScheme = "none"\n'
        " int[] faceVertexCounts = [4, 4, 4, 4, 4, 4, 3]\n"
        " int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4,"
        " 1, 5, 7, 3, 0, 1, 8]\n"
        " point3f[] points = [(0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1), (1, 0, 0), (1, 0, 1),"
        " (1, 1, 0), (1, 1, 1), (-1, 0.5, 0.5)]\n}\n",
        encoding="utf-8",
    )
    for solver in ("tl", "ul"):
        done = gf_usd("inspect", path, "--particles", "2000", "--solver", solver, "--json")
        assert done.status == 0, done.err
        (row,) = json.loads(done.out)["materials"]
        assert row["contact_factor"] < 6.0  # 64 and 196 with springs of a layer that is not there


def test_specks_are_named_apart_from_poorly_filled_parts(gf_usd, tmp_path: Path) -> None:
    """They raised the suggested number of particles to hundreds of thousands."""
    shells = [trimesh.creation.icosphere(3, 0.5), trimesh.creation.icosphere(1, 0.01)]
    shells[1].apply_translation((0.8, 0.0, 0.0))
    trimesh.util.concatenate(shells).export(tmp_path / "scan.obj")
    done = gf_usd("inspect", "scan.obj", "--meters-per-unit", "1", "--particles", "2000")
    assert done.status == 0, done.err
    words = " ".join(done.out.split())
    assert "1 speck, 3.46 cm large, is apart from the rest and too small for the spacing" in words
    assert "poorly filled" not in words
    assert "would fill" not in words


def test_one_poor_part_is_in_the_plural_of_its_table(gf_usd, tmp_path: Path) -> None:
    rod = trimesh.creation.cylinder(0.03, 1.5)
    rod.apply_translation((0.0, 0.0, 1.6))
    trimesh.util.concatenate([trimesh.creation.icosphere(2), rod]).export(tmp_path / "a.obj")
    done = gf_usd("inspect", "a.obj", "--meters-per-unit", "1", *FEW)
    assert done.status == 0, done.err
    assert "such parts contain few particles or none" in done.out
    assert "would fill them" in done.out


def test_a_one_sided_strip_is_open_and_not_without_effect(gf_usd, tmp_path: Path) -> None:
    """The page said 0 holes, 0 % of the area, and that its boundary has no effect on the fill."""
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)[:, None]
    width = np.array([-0.3, 0.3])
    across = 1.0 + width * np.cos(turn / 2.0)
    points = np.stack([across * np.cos(turn), across * np.sin(turn), width * np.sin(turn / 2.0)], 2)
    rows = [(2 * k, 2 * k + 2, 2 * k + 3, 2 * k + 1) for k in range(23)] + [(46, 1, 0, 47)]
    lines = [f"v {x} {y} {z}" for x, y, z in points.reshape(-1, 3)]
    lines += ["f " + " ".join(str(i + 1) for i in row) for row in rows]
    (tmp_path / "strip.obj").write_text("\n".join(lines), encoding="utf-8")
    done = gf_usd("inspect", "strip.obj", "--meters-per-unit", "1")
    assert done.status == 3
    assert "48 boundary edges" in done.out
    assert "0 holes" not in done.out
    assert "do not affect" not in done.out


def test_prims_skipped_for_one_reason_share_a_line(gf_usd, tmp_path: Path) -> None:
    """The colliders of a robot filled all lines and hid the other reasons."""
    guides = "\n".join(
        f'def Sphere "c{k}" {{\nuniform token purpose = "guide"\n}}' for k in range(13)
    )
    (tmp_path / "robot.usda").write_text(
        f'#usda 1.0\ndef Xform "R"\n{{\ndef Sphere "body" {{}}\n{guides}\n'
        'def BasisCurves "cable" {}\n}\n'
    )
    done = gf_usd("inspect", "robot.usda", *FEW)
    lines = [line for line in done.out.splitlines() if line.startswith("skipped")]
    assert lines[0] == "skipped: </R/c0> and 12 more: purpose guide"
    assert lines[1].startswith("skipped: </R/cable>: BasisCurves")

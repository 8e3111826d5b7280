"""gf-usd compare on files: what it says, what it writes, how it ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, Vt

import gf_usd
from gf_usd.cli.main import execute

Run = Callable[..., tuple[int, str, str]]

CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (0, 2) for z in (-1, 1)], dtype=float)
QUADS = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]


def falling_box(
    path: Path, off: float = 0.0, *, codes: tuple[float, ...] = (1, 2, 3, 4), up: str = "Y"
) -> Path:
    """A box of two units, cm, that falls a unit a frame; from the third on it is `off` aside."""
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetMetadata("metersPerUnit", 0.01)
    stage.SetMetadata("upAxis", up)
    stage.SetTimeCodesPerSecond(24)
    mesh = UsdGeom.Mesh.Define(stage, "/Box")
    stage.SetDefaultPrim(mesh.GetPrim())
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(QUADS)
    for code in codes:
        x = CORNERS + (off if code >= 3 else 0.0, 10.0 - code, 0.0)
        if up == "Z":
            x = x[:, [0, 2, 1]] * (1, -1, 1)
        points = Vt.Vec3fArray([Gf.Vec3f(*map(float, p)) for p in x])
        mesh.CreatePointsAttr().Set(points, code)
    stage.Save()
    return path


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """The command: exit status, stdout, stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        status = execute(["compare", *map(str, arguments)])
        return status, *capfd.readouterr()

    return call


def test_the_distance_the_place_and_the_time_are_said(run: Run, tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5)
    status, output, _ = run(a, b, "--tolerance", "4mm")
    assert status == 1
    assert "1 mesh, 8 points, 4 frames" in output
    assert "largest distance 5 mm" in output  # half a unit of a cm
    assert "of </Box> at time code 3" in output
    assert "different: distance above 4 mm from time code 3 on" in output
    assert "volume of B relative to A: 1 to 1" in output


@pytest.mark.parametrize(("tolerance", "status"), [("6mm", 0), ("1%", 1), ("50%", 0)])
def test_the_exit_status_is_for_scripts(
    run: Run, tmp_path: Path, tolerance: str, status: int
) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5)
    assert run(a, b, "--tolerance", tolerance)[0] == status


def test_without_a_tolerance_nothing_fails(run: Run, tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5)
    status, output, _ = run(a, b)
    assert status == 0
    assert "different" not in output


def test_quiet_leaves_the_exit_status_and_json(run: Run, tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5, up="Z")
    assert run(a, b, "--tolerance", "1mm", "-q") == (1, "", "")
    status, output, errors = run(a, b, "-q", "--json")
    assert (status, errors) == (0, "")
    assert json.loads(output)["notes"]


def test_json_has_every_frame(run: Run, tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5, up="Z")
    status, output, _ = run(a, b, "--tolerance", "1mm", "--json")
    found = json.loads(output)
    assert status == 1
    assert found["same"] is False
    assert found["first_over"] == 3.0
    assert found["worst"]["time_code"] == 3.0
    # float32 points of up to 11 units of a cm
    expected = [0.0, 0.0, 5e-3, 5e-3]
    assert [f["largest"] for f in found["per_frame"]] == pytest.approx(expected, abs=1e-8)
    assert found["radius"] == pytest.approx(0.01 * (3 * 8 / (4 * np.pi)) ** (1 / 3), rel=1e-6)
    assert any("another up axis" in note for note in found["notes"])


@pytest.mark.slow
def test_a_page_and_a_picture_are_written(run: Run, tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5)
    page, picture = tmp_path / "out.html", tmp_path / "out.png"
    status, _, errors = run(a, b, "-o", page, "-o", picture, "--size", "320x240")
    assert status == 0, errors
    assert "out.html" in errors
    text = page.read_text(encoding="utf-8")
    assert '"Distance"' in text
    assert "a and b" in text  # the title names both files
    from PIL import Image

    with Image.open(picture) as image:
        assert image.size == (960, 240)
        parts = np.asarray(image.convert("RGB"), dtype=float).reshape(240, 3, 320, 3)
    # the third part is colored by distance, which is half a unit everywhere
    assert np.abs(parts[:, 1] - parts[:, 2]).max() > 50.0


@pytest.mark.slow
def test_a_film_has_three_parts(run: Run, tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5)
    for name in ("film.gif", "film.mp4"):
        status, _, errors = run(a, b, "-o", tmp_path / name, "--size", "321x241")
        assert status == 0, errors
    from PIL import Image

    with Image.open(tmp_path / "film.gif") as film:
        assert film.size == (963, 241)
        assert film.n_frames == 4  # type: ignore[attr-defined]
    assert (tmp_path / "film.mp4").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--tolerance", "3"], "has no unit"),
        (["--align", "middle"], "choose one of: time, start"),
        (["-o", "out.txt"], "compare writes a page, an image or a film"),
        (["-o", "nowhere/out.html"], "is not a folder"),
        (["--fps", "12"], "write a film"),
        (["--variant", "jelly"], "has no variant 'jelly'"),
    ],
)
def test_what_makes_no_sense_is_refused(
    run: Run, tmp_path: Path, arguments: list[str], says: str
) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5)
    status, _, errors = run(a, b, *arguments)
    assert status == 2, errors
    assert says in errors
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.usda", "b.usda"]


def test_motions_at_other_times_are_refused_and_aligned(run: Run, tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), tmp_path / "b.usda"
    stage = Usd.Stage.Open(str(falling_box(tmp_path / "c.usda", codes=(1, 2, 3, 4))))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Box")).GetPointsAttr()
    values = {code: points.Get(code) for code in (1, 2, 3, 4)}
    points.Clear()
    for code, value in values.items():
        points.Set(value, code + 100)
    stage.Export(str(b))
    status, _, errors = run(a, b)
    assert status == 3
    assert "these ranges do not overlap" in errors
    assert "--align start" in errors
    assert run(a, b, "--align", "start", "--tolerance", "0mm")[0] == 0


@pytest.mark.slow
def test_python_compares(tmp_path: Path) -> None:
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", 0.5)
    found = gf_usd.compare(a, b, tolerance=0.004)
    assert not found.same
    assert found.first_over == 3.0
    assert found.largest == pytest.approx([0.0, 0.0, 5e-3, 5e-3], abs=1e-8)
    assert gf_usd.compare(a, b, tmp_path / "page.html", tolerance="6mm").same
    assert (tmp_path / "page.html").is_file()
    with pytest.raises(gf_usd.UsageError, match="tolerance"):
        gf_usd.compare(a, b, tolerance=True)


def test_the_note_on_frames_that_are_left_out_names_b(run: Run, tmp_path: Path) -> None:
    """Two variants of one file have the same name."""
    a, b = falling_box(tmp_path / "a.usda"), falling_box(tmp_path / "b.usda", codes=(1, 2))
    _, _, errors = run(a, b)
    assert "2 of 4 frames are compared, at time codes 1 to 2: B (b.usda) has only these" in errors


def test_a_picture_names_the_variants(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two variants of one file had the captions A and B."""
    seen: list[str] = []

    def label(pixels: np.ndarray, text: str) -> np.ndarray:
        seen.append(text)
        return pixels

    monkeypatch.setattr("gf_usd.view.legend.label", label)
    monkeypatch.setattr(
        "gf_usd.view.render.render.render_linear",  # which no other module imports by name
        lambda scene, camera, size: np.zeros((size[1], size[0], 3), np.float32),
    )
    both, one = tmp_path / "box.usda", tmp_path / "box.jelly.usda"
    for path in (both, one):
        stage = Usd.Stage.Open(str(falling_box(path, codes=(1, 2))))
        bakes = stage.GetDefaultPrim().GetVariantSets().AddVariantSet("gaussianFlesh")
        for name in ("rubber", "jelly"):
            bakes.AddVariant(name)
        stage.Save()
    picture = tmp_path / "out.png"
    options = ["--variant", "rubber", "--other-variant", "jelly", "-o", picture]
    for other in (both, one):
        status, _, errors = run(both, other, *options, "--size", "240x180")
        assert status == 0, errors
    assert seen == ["box rubber", "box jelly", "box rubber", "box.jelly"]

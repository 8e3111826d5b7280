"""gf-usd report, from a real bake to the page."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from small_bakes import BLOCK, names


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small bake of two variants; tests copy it."""
    from gf_usd.api.bake import bake

    folder = tmp_path_factory.mktemp("baked")
    (folder / "block.usda").write_text(BLOCK, encoding="utf-8")
    bake(
        folder / "block.usda", material="rubber,jelly", output=folder / "block.soft.usda",
        particles=300, frames=6, drop="0.1r",
    )  # fmt: skip
    return folder


@pytest.fixture
def work(baked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "work"
    shutil.copytree(baked, folder)
    monkeypatch.chdir(folder)
    return folder


def data(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    found = re.search('<script type="text/plain" id="page">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


def test_quiet(gf_usd, work):
    done = gf_usd("report", "block.soft.usda", "-q")
    assert (done.status, done.out, done.err) == (0, "", "")
    assert (work / "block.soft.html").exists()


@pytest.mark.slow
def test_a_bake_becomes_one_page_of_all_its_variants(gf_usd, work):
    inputs = {path.name: path.read_bytes() for path in work.iterdir()}
    done = gf_usd("report", "block.soft.usda")
    assert (done.status, done.out) == (0, "")
    assert done.err.startswith("block.soft.html: ")
    assert names(work) == sorted([*inputs, "block.soft.html"])
    assert {name: (work / name).read_bytes() for name in inputs} == inputs
    page = work / "block.soft.html"
    assert page.stat().st_size < 20_000_000
    variants = data(page)["variants"]
    # the variant that the file shows comes first
    assert [variant["name"] for variant in variants] == ["rubber", "jelly"]
    report = json.loads((work / "block.soft.report.json").read_text())
    for variant, bake in zip(variants, report["bakes"]):
        plots = {plot["title"]: plot for plot in variant["plots"]}
        assert set(plots) == {"Height", "Stretch", "Volume ratio J", "Energy", "Depth in the floor"}
        (center,) = [c for c in plots["Height"]["curves"] if c["name"] == "center of mass"]
        truth = [frame["center"][2] for frame in bake["per_frame"]]  # Z is up
        factor = {"m": 1.0, "cm": 0.01, "mm": 0.001}[plots["Height"]["unit"]]
        assert [y * factor for y in center["y"]] == pytest.approx(truth, rel=1e-5)
        assert variant["codes"] == [101 + i for i in range(6)]
        assert variant["up"] == "Z"
    text = page.read_text(encoding="utf-8")
    assert f"all {report['particles']} Gaussians" in text
    assert "Missing:" not in text


def test_one_variant_thinned_by_the_old_name_of_the_option(gf_usd, work):
    done = gf_usd(
        "report", "block.soft.usda", "-o", "one.html", "--look", "jelly", "--max-frames", 3,
        "--max-vertices", 100,
    )  # fmt: skip
    assert done.status == 0
    (variant,) = data(work / "one.html")["variants"]
    assert (variant["name"], variant["codes"]) == ("jelly", [101, 103, 106])
    assert variant["table"]["positions"]["shape"] == [3, 100, 3]
    assert "3 of 6 frames" in (work / "one.html").read_text(encoding="utf-8")


def test_without_the_json_the_root_layer_is_asked(gf_usd, work):
    (work / "block.soft.report.json").unlink()
    assert gf_usd("report", "block.soft.usda", "--variant", "rubber").status == 0
    text = (work / "block.soft.html").read_text(encoding="utf-8")
    assert "Missing: there is no block.soft.report.json next to the file" in text
    assert "Smallest volume ratio" in text
    assert "neoHookean" in text
    titles = [plot["title"] for plot in data(work / "block.soft.html")["variants"][0]["plots"]]
    assert titles == ["Height", "Stretch", "Volume ratio J"]


def test_a_page_is_replaced(gf_usd, work):
    (work / "x.html").write_text("old", encoding="utf-8")
    assert gf_usd("report", "block.soft.usda", "-o", "x.html", "--variant", "jelly").status == 0
    assert (work / "x.html").read_bytes().startswith(b"<!doctype html>")


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("block.soft.usda", "--variant", "liquid"), 2, "no variant 'liquid'"),
        (("block.soft.usda", "-o", "page.pdf"), 2, "does not end in .html"),
        (("block.soft.usda", "-o", "nowhere/page.html"), 2, "nowhere is not a folder"),
        (("block.soft.usda", "-o", "folder.html"), 2, "folder.html is a folder"),
        (("loop.usda",), 3, "loop.usda does not exist"),
        (("block.soft.usda", "--max-frames", 1), 2, "max-frames"),
        (("block.usda",), 3, "nothing in this file moves"),
        (("gone.usda",), 3, "does not exist"),
    ],
)
def test_wrong_uses_are_refused_in_words(gf_usd, work, arguments, status, message):
    (work / "folder.html").mkdir()
    (work / "loop.usda").symlink_to("loop.usda")
    before = names(work)
    done = gf_usd("report", *arguments)
    assert (done.status, done.out) == (status, "")
    assert message in done.err
    assert names(work) == before


def test_the_input_is_never_replaced(gf_usd, work):
    # a stage may have any name
    shutil.copy("block.soft.usda", "page.html")
    before = Path("page.html").read_bytes()
    done = gf_usd("report", "page.html", "-o", "./page.html")
    assert done.status == 2
    assert "is the input itself" in done.err
    assert Path("page.html").read_bytes() == before


def test_a_page_of_splats_shows_the_particles_of_every_variant(gf_usd, work):
    inputs = {path.name: path.read_bytes() for path in work.iterdir()}
    done = gf_usd("report", "--splats", "block.soft.usda", "--max-splats", "200")
    assert (done.status, done.out) == (0, "")
    assert done.err.startswith("block.soft.splats.html: ")
    assert names(work) == sorted([*inputs, "block.soft.splats.html"])
    assert {name: (work / name).read_bytes() for name in inputs} == inputs
    page = work / "block.soft.splats.html"
    variants = data(page)["variants"]
    assert [variant["name"] for variant in variants] == ["rubber", "jelly"]
    for variant in variants:
        assert variant["table"]["positions"]["shape"] == [6, 200, 3]
    assert len(re.findall(r"200 of \d+ Gaussians", page.read_text(encoding="utf-8"))) == 2


def test_a_page_of_splats_prefers_a_capture(gf_usd, tmp_path, monkeypatch):
    from moving_splats import FRAMES, moving_splats

    monkeypatch.chdir(tmp_path)
    moving_splats(tmp_path / "ball.usdc", particles=True, degree=2)
    assert gf_usd("report", "--splats", "ball.usdc", "-o", "page.html").status == 0
    (variant,) = data(tmp_path / "page.html")["variants"]
    assert variant["table"]["positions"]["shape"] == [FRAMES, 200, 3]
    assert variant["table"]["light"]["shape"] == [200, 8, 3]
    assert variant["up"] == "Z"


def test_a_page_of_splats_without_any_is_refused(gf_usd, work):
    done = gf_usd("report", "--splats", "block.usda")
    assert done.status == 3
    assert "contains no moving Gaussians" in done.err
    assert not (work / "block.splats.html").exists()

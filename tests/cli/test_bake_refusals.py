"""How gf-usd bake ends when it cannot: words, exit status, and what is left on the disk."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import names

SMALL = ("--particles", "300", "--frames", "3")
SHEET = """#usda 1.0
(
    defaultPrim = "Cloth"
    metersPerUnit = 1
    upAxis = "Y"
)
def Mesh "Cloth"
{
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
}
"""


@pytest.fixture
def sealed(tmp_path: Path) -> Iterator[Path]:
    """A folder that nobody may write to; for root, who may write anywhere, one of the kernel's."""
    folder = tmp_path / "sealed"
    folder.mkdir()
    folder.chmod(0o555)
    kernel = Path("/proc/self")
    if not os.access(folder, os.W_OK):
        yield folder
    elif kernel.is_dir():
        yield kernel
    else:
        pytest.skip("every folder of this system can be written to")
    folder.chmod(0o755)


def refused(done, status: int, message: str, hint: str) -> None:
    """It ended with these words on stderr, which hold no traceback, and with nothing on stdout."""
    said, _, advice = done.err.partition("\n\nhint: ")
    assert done.status == status, done.err
    assert done.out == ""
    assert said.startswith(f"error: {message}")
    assert hint in advice
    assert "Traceback" not in done.err
    assert len(done.err) < 1000


def test_a_missing_file(gf_usd, here: Path) -> None:
    done = gf_usd("bake", "duck.usda")
    refused(done, 3, "duck.usda does not exist", "give a file that ends in ")
    assert names(here) == []


def test_a_text_file_named_usda(gf_usd, here: Path) -> None:
    (here / "text.usda").write_text("Dear artist, this is not a stage.\n")
    done = gf_usd("bake", "text.usda")
    refused(done, 3, "text.usda is not a USD file", "check what the file really is")
    assert names(here) == ["text.usda"]


def test_a_mesh_without_volume(gf_usd, here: Path) -> None:
    (here / "sheet.usda").write_text(SHEET)
    done = gf_usd("bake", "sheet.usda")
    refused(done, 3, "", "thickness")
    assert "/Cloth" in done.err
    assert names(here) == ["sheet.usda"]


def test_an_unknown_material(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, "-m", "rubber,ruber")
    refused(done, 2, "there is no material 'ruber'\n", "did you mean rubber? choose one of ")
    assert names(here) == []


def test_a_folder_that_cannot_be_written(gf_usd, here: Path, block: Path, sealed: Path) -> None:
    done = gf_usd("bake", block, "-o", f"{sealed}/")
    refused(done, 2, f"{sealed} cannot be written to: ", "choose another folder with -o, or change")
    assert names(here) == []


def test_the_asset_is_not_written_even_when_asked(gf_usd, here: Path, block: Path) -> None:
    before = block.read_bytes(), names(block.parent)
    done = gf_usd("bake", block, *SMALL, "-o", block, "--overwrite")
    refused(done, 2, f"{block} is the asset itself, which is never written to", "another -o")
    assert (block.read_bytes(), names(block.parent)) == before
    assert names(here) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-m", "jelly,jelly"), "--material has 2 materials named 'jelly'"),
        (("-m", "jelly,"), "there is no material ''"),
        (("-m", "soft.usda"), "soft.usda does not exist"),
        (("--law", "stvk"), "there is no law 'stvk'"),
        (("--device", "tpu"), "there is no device 'tpu'"),
        (("--frames", "0"), "--frames is 0"),
        (("--gravity", "down"), "--gravity: 'down' is no number"),
        (("-o", "shot.usdz"), "-o shot.usdz: a root layer ends in .usda, .usd or .usdc"),
    ],
)
def test_wrong_options(gf_usd, here: Path, block: Path, options, message: str) -> None:
    refused(gf_usd("bake", block, *options), 3 if "exist" in message else 2, message, " ")
    assert names(here) == []


def test_options_are_judged_before_the_asset_is_read(gf_usd, here: Path) -> None:
    refused(gf_usd("bake", "no.usda", "--fps", "0"), 2, "--fps is 0", "give a number above 0")


def test_a_material_file_with_a_fault(gf_usd, here: Path, block: Path) -> None:
    (here / "soft.usda").write_text(
        '#usda 1.0\ndef Material "Soft"\n{\n    float physics:youngsModulus = 1e4\n'
        "    float physics:poissonsRatio = 0.3\n    float physics:density = 0.001\n"
        '    uniform token gaussianFlesh:law = "hyper"\n}\n'
    )
    done = gf_usd("bake", block, "-m", "soft.usda")
    refused(done, 3, "soft.usda: </Soft>: gaussianFlesh:law is 'hyper'", "choose one of corotated")
    assert names(here) == ["soft.usda"]


def test_too_few_particles(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, "--particles", "3")
    refused(done, 3, "only ", "--particles")
    assert names(here) == []


def test_words_that_are_no_option(gf_usd, here: Path, block: Path) -> None:
    for words in (("--frames", "many"), ("--speed", "1"), ("more",)):
        done = gf_usd("bake", block, *words)
        assert (done.status, done.out) == (2, "")
        assert words[-2] in done.err or words[-1] in done.err
    assert names(here) == []


def test_a_process_of_its_own_ends_the_same_way(here: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", "bake", "duck.usda"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("error: duck.usda does not exist\n\nhint: ")
    assert names(here) == []


@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize(
    ("number", "status", "word"),
    [(signal.SIGTERM, 143, "terminated"), (signal.SIGINT, 130, "interrupted")],
)
def test_a_bake_that_is_stopped_leaves_partial_files_only(
    here: Path, block: Path, number: int, status: int, word: str
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "gf_usd", "bake", str(block), "--particles", "300",
         "--frames", "100000", "--drop", "150", "-q"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + 60.0
        while not names(here) and process.poll() is None:
            assert time.monotonic() < deadline, "the bake never began to write"
            time.sleep(0.02)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == status
    assert (out, err) == ("", f"{word}; only *.partial.* files remain\n")
    assert names(here) == ["block.rubber.cache.partial.usdc"]

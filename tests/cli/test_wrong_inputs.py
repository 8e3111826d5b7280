"""Five typical wrong inputs: refused with a message, quickly, and without a file."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from slow_parameters import slow_but
from small_bakes import Done

BALL = """#usda 1.0
(
    defaultPrim = "Ball"
    metersPerUnit = 1
    upAxis = "Y"
)
def Sphere "Ball" {
    double radius = 0.5
}
"""
SHEET = """#usda 1.0
(
    defaultPrim = "Cloth"
    metersPerUnit = 1
    upAxis = "Y"
)
def Mesh "Cloth" {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
}
"""


def unwritable(folder: Path) -> Path:
    """A folder without write permission; for the superuser, one of the kernel's."""
    folder.mkdir()
    folder.chmod(0o555)
    if not os.access(folder, os.W_OK):
        return folder
    kernel = Path("/proc/self")
    if not kernel.is_dir():
        pytest.skip("every folder of this system can be written to")
    return kernel


def child_seconds() -> float:
    """Processor time [s] of all commands run so far."""
    spent = os.times()
    return spent.children_user + spent.children_system


def files(folder: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def as_program(*arguments: str) -> Done:
    """`gf-usd` as a process, within what people are promised.

    In seconds of the processor: a busy machine proves nothing.
    """
    began = child_seconds()
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", *arguments], capture_output=True, text=True, check=False
    )
    assert child_seconds() - began < 5.0
    return Done(done.returncode, done.stdout, done.stderr)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "status", "message", "hint"),
    [
        (["bal.usda"], 3, "bal.usda does not exist", "did you mean ball.usda"),
        (["text.usda"], 3, "text.usda is not a USD file", "check the type of the file"),
        (["sheet.usda"], 3, "</Cloth>: the surface is open", "give the mesh thickness"),
        (["ball.usda", "-m", "granite"], 2, "there is no material 'granite'", "choose one of"),
        (["ball.usda", "-o", "SEALED/"], 2, "cannot be written to", "choose another folder"),
    ],
    ids=["missing file", "text file", "no volume", "unknown material", "unwritable folder"],
)
def test_refused_in_words_and_without_a_file(
    tmp_path: Path,
    here: Path,
    gf_usd: Callable[..., Done],
    arguments: list[str],
    status: int,
    message: str,
    hint: str,
) -> None:
    """As programs of their own: the one that is refused last, when its meshes are known, and one
    that is refused before anything is read.
    """
    for name, text in (("ball", BALL), ("sheet", SHEET), ("text", "Dear artist,\nhello.\n")):
        (here / f"{name}.usda").write_text(text, encoding="utf-8")
    if arguments[-1] == "SEALED/":
        arguments = [*arguments[:-1], f"{unwritable(tmp_path / 'sealed')}/"]
    before = files(tmp_path)
    run = as_program if status == 3 and "text" not in arguments[0] else gf_usd
    done = run("bake", *arguments)
    assert done.status == status
    assert done.out == ""
    # A machine that takes seconds to start a process is shown the stage first.
    printed = done.err.removeprefix(f"reading {arguments[0]}\n")
    error, _, advice = printed.partition("\n\nhint: ")
    assert error.startswith("error: ")
    assert message in error
    assert hint in advice
    assert "Traceback" not in done.err
    assert len(done.err) < 1000  # short: a screen's third
    assert files(tmp_path) == before


@pytest.mark.slow
def test_an_option_that_does_not_parse_is_a_matter_of_usage(tmp_path: Path) -> None:
    (tmp_path / "ball.usda").write_text(BALL, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", "bake", "ball.usda", "--frames", "many"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "--frames" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["ball.usda"]


@pytest.mark.skipif(os.name == "nt", reason="a folder that is worked in cannot be deleted there")
@pytest.mark.parametrize(
    "line",
    slow_but(
        [
            "-m gf_usd bake FILE", "-m gf_usd inspect FILE", "-m gf_usd batch FILE",
            "-c import_gf_usd;gf_usd.bake('FILE')", "-c import_gf_usd;gf_usd.inspect('FILE')",
            "-c import_gf_usd;gf_usd.simulate(gf_usd.Scene())",
        ],
        "-m gf_usd bake FILE", "-m gf_usd batch FILE", "-c import_gf_usd;gf_usd.bake('FILE')",
    ),
)  # fmt: skip
def test_a_deleted_folder_to_work_in_is_said_in_words(tmp_path: Path, line: str) -> None:
    file = tmp_path / "ball.usda"
    file.write_text(BALL)
    gone = tmp_path / "gone"
    gone.mkdir()
    arguments = [word.replace("FILE", str(file)) for word in line.split()]
    arguments = [word.replace("import_gf_usd", "import gf_usd") for word in arguments]
    root = str(Path(__file__).parents[2])
    command = [sys.executable, *arguments]
    code = f"import os, sys; os.rmdir(os.getcwd()); os.execv(sys.executable, {command})"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=gone, env={**os.environ, "PYTHONPATH": root},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == (2 if "-m" in line else 1)
    assert "the current folder cannot be found: No such file or directory" in done.stderr
    assert "change to a folder that exists" in done.stderr

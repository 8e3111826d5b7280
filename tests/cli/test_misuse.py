"""Wrong command lines: each is an error message with a hint, and leaves no file."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
import typer

from gf_usd.cli.help import in_range
from gf_usd.cli.main import program

ASSET = "{asset}"
MISUSES = (
    """
bake LONG.usda
bake {asset} -o LONG.usda
check LONG.usda
inspect LONG.usda
batch LONG.usda
bkae {asset}
cook
bake
bake no.usda
bake .
bake {asset} {asset}
bake {asset} --materail rubber
bake {asset} --matrial=rubber
bake {asset} --material
bake {asset} --material rubbr
bake {asset} --material rubber,,jelly
bake {asset} --material no.usda
bake {asset} --material auto:nobody
bake {asset} --frames ten
bake {asset} --frames 0
bake {asset} --frames -3
bake {asset} --frames 2.5
bake {asset} --fps 0
bake {asset} --fps nan
bake {asset} --fps fast
bake {asset} --start nan
bake {asset} --start now
bake {asset} --particles 0
bake {asset} --particles many
bake {asset} --particles 100 --spacing 1
bake {asset} --spacing -1
bake {asset} --spacing 0
bake {asset} --seed -1
bake {asset} --seed 2147483648
bake {asset} --time-scale slow
bake {asset} --time-scale 0
bake {asset} --time-scale 1e-300
bake {asset} --drop high
bake {asset} --drop 1e300
bake {asset} --drop -1
bake {asset} --drop 3m
bake {asset} --gravity down
bake {asset} --gravity 1,2
bake {asset} --gravity 1e30
bake {asset} --velocity 1
bake {asset} --velocity up,0,0
bake {asset} --velocity 1e20,0,0
bake {asset} --spin 1,2,3,4
bake {asset} --spin nan,0,0
bake {asset} --collider no.obj
bake {asset} --collider .
bake {asset} --collider
bake {asset} --pin paint:nothing
bake {asset} --pin joint:
bake {asset} --drop 1e9
bake {asset} --floor under
bake {asset} --floor 1e300
bake {asset} --floor -1e20
bake {asset} --floor 1e20 --pin box:-9,-9,-9,9,9,9
bake {asset} --floor 0:1,2
bake {asset} --floor 0:0,0,0
bake {asset} --drag -1
bake {asset} --device gpu
bake {asset} --threads 0
bake {asset} --pin
bake {asset} --pin box:1,2,3
bake {asset} --pin box:a,b,c,d,e,f
bake {asset} --bone-radius 7
bake {asset} --friction -1
bake {asset} --restitution 2
bake {asset} --damping-time -1
bake {asset} --material-box rubber
bake {asset} --material-box nothing:0,0,0,1,1,1
bake {asset} --material-label part
bake {asset} --blend-width -1
bake {asset} --mass-scaling 0.5
bake {asset} --filter-rate -1
bake {asset} --skin embd
bake {asset} --solver implicit
bake {asset} --preset papre
bake {asset} --law hooke
bake {asset} --procrustes 2
bake {asset} --clamp 5:1
bake {asset} --stress-cap -1
bake {asset} --only meshes
bake {asset} --samples-per-frame 0
bake {asset} --range 5
bake {asset} --range b:a
bake {asset} --handles -1
bake {asset} --clip-frames -1
bake {asset} --slice 0
bake {asset} --flatten --clip-frames 5
bake {asset} --limits time=soon
bake {asset} --max-hours -1
bake {asset} --max-hours nan
bake {asset} --meters-per-unit 0
bake {asset} --up-axis X
bake {asset} --prim /Nobody
bake {asset} --json --events -
bake {asset} -o x.obj
inspect
inspect no.usda
check
check no.usda
preview
preview no.usda
preview {asset} --size big
preview {asset} --time-codes x:y
preview {asset} --color heat
preview {asset} --show bones
report
report no.usda
batch
batch no.toml
batch {asset} --memory nan
batch {asset} --timeout nan
fit {asset} --max-minutes nan --target squash=0.1
materials rubber
verify --nonsense
schema-path here
help unit
""".replace("LONG", 300 * "x")
    .strip()
    .splitlines()
)


def test_there_are_as_many_as_were_promised() -> None:
    assert len(MISUSES) == len(set(MISUSES)) >= 75


@pytest.mark.parametrize("line", MISUSES)
def test_a_misuse_is_answered_in_words(gf_usd, here: Path, block: Path, line: str) -> None:
    done = gf_usd(*line.replace(ASSET, str(block)).split(" "))
    assert done.status in (2, 3), done.err + done.out
    first, _, rest = done.err.partition("\n\nhint: ")
    assert first.startswith("error: ")
    assert first.count("error: ") == 1
    assert rest.strip(), done.err
    for word in ("Traceback", "Usage:", "Error:", "<class"):
        assert word not in done.err
    assert done.out == ""
    assert list(here.iterdir()) == []


RANGES = [
    (name, param.opts[0])
    for name, command in typer.main.get_command(program()).commands.items()  # type: ignore[attr-defined]
    for param in command.params
    if in_range(param)
]


@pytest.mark.parametrize(("command", "flag"), RANGES)
def test_no_number_is_in_no_range(gf_usd, here: Path, block: Path, command: str, flag: str) -> None:
    asset = ["--status"] if command == "serve" else [str(block)]  # which does not listen
    needed = ["--target", "squash=0.1"] if command == "fit" else []
    done = gf_usd(command, *asset, *needed, flag, "nan")
    assert done.err.startswith(f"error: {flag}: nan is not a number\n\nhint: ")
    assert done.status == 2
    assert list(here.iterdir()) == []


def test_a_number_of_another_kind_has_the_kind_as_its_hint(gf_usd) -> None:
    done = gf_usd("inspect", "a.usda", "--particles", "1500.5")
    assert done.status == 2
    assert done.err.startswith("error: --particles: '1500.5' is not a whole number\n\n")
    assert "hint: give a whole number. Fill the bodies" in done.err


@pytest.mark.parametrize(
    ("line", "guess"),
    [
        ("bkae x", "bake"),
        ("bake x --materail rubber", "--material"),
        ("bake {asset} --skin embd", "embed"),
        ("bake {asset} -m rubbr", "rubber"),
        ("help unit", "units"),
    ],
)
def test_what_was_meant_is_named(gf_usd, here: Path, block: Path, line: str, guess: str) -> None:
    done = gf_usd(*line.replace(ASSET, str(block)).split(" "))
    assert f"hint: did you mean {guess}?" in done.err


@pytest.mark.parametrize(
    ("line", "needed", "whole"),
    [
        ("compare a.usda", "B", "gf-usd compare A B"),
        ("deliver a.usda", "--output PATH", "gf-usd deliver BAKE --output PATH"),
        ("check", "FILE", "gf-usd check FILE"),
    ],
)
def test_what_is_missing_is_named_with_the_whole_line(
    gf_usd, line: str, needed: str, whole: str
) -> None:
    done = gf_usd(*line.split(" "))
    command = line.split(" ")[0]
    assert done.err.startswith(f"error: gf-usd {command} needs {needed}\n\nhint: give {whole};")


def test_a_number_out_of_range_names_the_option_and_the_range(gf_usd) -> None:
    done = gf_usd("serve", "--jobs", "0")
    assert done.err.startswith("error: --jobs: 0 is not in the range x>=1\n\n")
    assert "hint: give a number of 1 or more. Number of bakes" in done.err


def test_an_option_of_bake_that_inspect_lacks_is_left_out(gf_usd) -> None:
    done = gf_usd("inspect", "a.usda", "--overwrite")
    assert "hint: leave it out: inspect writes no results; " in done.err


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("bake my duck.usda", "quote a path that contains spaces; gf-usd batch bakes several"),
        ("check my duck.usda", "quote a path that contains spaces; gf-usd check --help"),
    ],
)
def test_a_path_with_spaces_that_is_not_quoted_is_recognized(gf_usd, line: str, hint: str) -> None:
    done = gf_usd(*line.split(" "))
    command = line.split(" ")[0]
    assert done.err.startswith(f"error: gf-usd {command} does not take duck.usda as well\n\n")
    assert f"hint: {hint}" in done.err
    assert done.status == 2


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("--flesh", "hint: give it to every job: --set flesh=true"),
        ("--drop 2r", "hint: give it to every job: --set drop=VALUE"),
        ("--pin /A", "hint: give it to every job: --set pins=VALUE"),
        ("--resume", "hint: leave it out: a batch continues by itself"),
    ],
)
def test_a_batch_says_how_it_takes_an_option_of_bake(gf_usd, block, words: str, hint: str) -> None:
    done = gf_usd("batch", str(block), *words.split(" "))
    assert done.status == 2
    assert done.err.startswith(f"error: gf-usd batch has no option {words.split(' ')[0]}\n\n{hint}")
    assert "did you mean" not in done.err


@pytest.mark.parametrize("command", ["bake", "inspect", "check", "preview", "deliver", "report"])
def test_a_folder_that_cannot_be_searched_is_named(
    gf_usd, here: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """As the system answers to a path below such a folder, except to root."""
    sealed = Path("sealed/duck.usda")
    stat = Path.stat

    def denied(self: Path, *, follow_symlinks: bool = True) -> os.stat_result:
        if "sealed" in self.parts:
            raise PermissionError(errno.EACCES, "Permission denied", str(self))
        return stat(self, follow_symlinks=follow_symlinks)

    monkeypatch.setattr(Path, "stat", denied)
    output = ["-o", "out.glb"] if command == "deliver" else []
    done = gf_usd(command, sealed, *output)
    assert done.err == (
        "error: sealed/duck.usda: Permission denied\n\nhint: check the permissions of the file and"
        " of the folders above it, and that no other program has it open\n"
    )
    assert done.status == 2


@pytest.mark.parametrize(
    ("mode", "hint"),
    [
        (os.X_OK, "FOLDER cannot be entered: change the permissions of that folder"),
        (os.W_OK, "FOLDER cannot be written to: change the permissions of that folder"),
    ],
)
def test_a_file_that_is_refused_within_a_bake_is_named(
    gf_usd, here: Path, block: Path, monkeypatch: pytest.MonkeyPatch, mode: int, hint: str
) -> None:
    """Not as wrong usage, and with what refuses it: root may write everywhere."""
    access = os.access
    Path("b.usda").touch()
    # the file itself too: that it cannot be written does not prevent its replacement
    kept = {(here, mode), (here / "b.usda", os.W_OK), (Path("b.usda"), os.W_OK)}
    monkeypatch.setattr(os, "access", lambda p, m: access(p, m) and (Path(p), m) not in kept)

    def denied(*arguments: object) -> None:
        Path("block.rubber.cache.partial.usdc").touch()
        raise PermissionError(errno.EACCES, "Permission denied", "a.usda", None, "b.usda")

    monkeypatch.setattr("gf_usd.pipeline.run.run.run_variant", denied)
    done = gf_usd("bake", block, "--particles", "100", "--frames", "2", "-q")
    assert done.err == (
        "error: a.usda or b.usda: Permission denied; only *.partial.* files remain\n\n"
        f"hint: {hint.replace('FOLDER', str(here))}\n"
    )
    assert done.status == 1


def test_a_file_system_that_becomes_read_only_within_a_bake_is_named(
    gf_usd, here: Path, block: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Linux makes one after an error of its disk."""

    def denied(*arguments: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system", "a.usda")

    monkeypatch.setattr("gf_usd.pipeline.run.run.run_variant", denied)
    done = gf_usd("bake", block, "--particles", "100", "--frames", "2", "-q")
    assert done.err == (
        "error: a.usda: Read-only file system\n\n"
        "hint: write to a folder on another file system (--output)\n"
    )
    assert done.status == 2  # nothing is left that would make it more than wrong usage

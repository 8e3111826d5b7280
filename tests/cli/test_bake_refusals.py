"""How gf-usd bake ends where an option or a file does not do, or a signal stops it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
from small_bakes import names

SMALL = ("--particles", "300", "--frames", "3")


def refused(done, status: int, message: str, hint: str) -> None:
    """It ended with this message on stderr, which hold no traceback, and with nothing on stdout."""
    error, _, advice = done.err.partition("\n\nhint: ")
    assert done.status == status, done.err
    assert done.out == ""
    assert error.startswith(f"error: {message}")
    assert hint in advice
    assert "Traceback" not in done.err
    assert len(done.err) < 1000


SHOT = """#usda 1.0
(
    defaultPrim = "Shot"
    metersPerUnit = 0.01
    upAxis = "Z"
)
def Xform "Shot" (
    references = @./part.usda@
    variants = {
        string side = "left"
    }
    prepend variantSets = "side"
)
{
    variantSet "side" = {
        "left" {
        }
        "right" (
            references = @./variant.usda@
        ) {
        }
    }
}
"""
SOFT = """#usda 1.0
(
    defaultPrim = "soft"
    metersPerUnit = 1
)
def Material "soft" (
    prepend apiSchemas = ["PhysicsDeformableBodyMaterialAPI"]
)
{
    float physics:youngsModulus = 20000
    float physics:poissonsRatio = 0.3
    float physics:density = 1000
}
"""


def test_an_unknown_material(gf_usd, here: Path, block: Path) -> None:
    done = gf_usd("bake", block, "-m", "rubber,ruber")
    refused(done, 2, "there is no material 'ruber'", "did you mean rubber? choose one of ")
    assert names(here) == []


def test_the_asset_is_not_written_even_when_asked(gf_usd, here: Path, block: Path) -> None:
    before = block.read_bytes(), names(block.parent)
    done = gf_usd("bake", block, *SMALL, "-o", block, "--overwrite")
    refused(done, 2, f"{block} is the asset itself, which is never modified", "another -o")
    assert (block.read_bytes(), names(block.parent)) == before
    assert names(here) == []


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--flatten",)])
def test_no_file_that_the_asset_is_composed_of_is_written(
    gf_usd, here: Path, block, options
) -> None:
    """A damaged layer of a variant that is not shown does not hinder that."""
    part, variant = here / "part.usda", here / "variant.usda"
    part.write_bytes(block.read_bytes())
    variant.write_text("damaged")
    shot = here / "shot.usda"
    shot.write_text(SHOT)
    before = part.read_bytes(), names(here)
    for written in (part, variant):
        done = gf_usd("bake", shot, *SMALL, *options, "-o", written, "--overwrite")
        refused(done, 2, f"{written} is a file that the bake reads", "another -o")
    assert (part.read_bytes(), names(here)) == before
    assert gf_usd("bake", shot, *SMALL, *options, "-o", "new.usda").status == 0
    assert gf_usd("bake", shot, *SMALL, *options, "-o", "new.usda", "--overwrite").status == 0


def test_no_collider_and_no_file_of_a_material_is_written(gf_usd, here: Path, block: Path) -> None:
    box, soft = here / "box.usda", here / "soft.usda"
    box.write_bytes(block.read_bytes())
    soft.write_text(SOFT)
    before = box.read_bytes(), soft.read_bytes()
    for written in (box, soft):
        options = ("-m", soft, "--collider", box, "-o", written, "--overwrite")
        done = gf_usd("bake", block, *SMALL, *options)
        refused(done, 2, f"{written} is a file that the bake reads", "another -o")
    assert (box.read_bytes(), soft.read_bytes()) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-m", "jelly,jelly"), "--material has 2 materials named 'jelly'"),
        (("-m", "jelly,"), "there is no material ''"),
        (("-m", "soft.usda"), "soft.usda does not exist"),
        (("--law", "stvk"), "there is no law 'stvk'"),
        (("--device", "tpu"), "there is no device 'tpu'"),
        (("--frames", "0"), "--frames is 0"),
        (("--gravity", "down"), "--gravity: 'down' is not a number"),
        (("-o", "shot.obj"), "-o shot.obj: a root layer ends in .usda, .usd or .usdc"),
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
    refused(done, 3, f"{block}: only ", "--particles")
    assert names(here) == []


@pytest.mark.parametrize("inside", [False, True], ids=["folder", "package"])
def test_an_empty_texture_is_refused_where_a_package_is_written(
    gf_usd, here: Path, block: Path, inside: bool
) -> None:
    """USD cannot package it: the bake failed at its end, with a hint on disk space."""
    picture = 'def Shader "Picture"\n{\n    asset inputs:file = @./skin.png@\n}\n'
    block.write_text(block.read_text().rstrip().removesuffix("}") + picture + "}\n")
    (block.parent / "skin.png").touch()
    found = block.parent / "skin.png"
    if inside:
        source, block = block, block.with_suffix(".usdz")
        with zipfile.ZipFile(block, "w") as archive:
            archive.write(source, source.name)
            archive.write(found, found.name)
        found = f"{block}[skin.png]"
    done = gf_usd("bake", block, *SMALL, "-o", "a.usdz")
    message = f"{block}: {found} is empty (0 bytes), and USD cannot put it into a package;"
    refused(done, 3, message, "export it again")
    assert "</World/Picture.inputs:file> refers to it" in done.err
    assert names(here) == []
    assert gf_usd("bake", block, *SMALL, "-o", "a.usda").status == 0
    delivered = gf_usd("deliver", "a.usda", "-o", "b.usdz")
    refused(delivered, 3, f"a.usda: {found} is empty (0 bytes)", "export it again")
    assert gf_usd("deliver", "a.usda", "-o", "b.usda").status == 0


@pytest.mark.parametrize("prim", ["over", "class", "instance"])
def test_an_empty_texture_is_found_on_every_prim_that_a_package_has(
    gf_usd, here: Path, block: Path, prim: str
) -> None:
    """Also below instances and on prims without a definition, which a plain traversal skips."""
    shader = 'def Shader "Picture"\n{\n    asset inputs:file = @./skin.png@\n}\n'
    (block.parent / "skin.png").touch()
    (block.parent / "look.usda").write_text(
        f'#usda 1.0\n(\n    defaultPrim = "Look"\n)\ndef Scope "Look"\n{{\n{shader}}}\n'
    )
    added = {
        "over": shader.replace("def", "over"),
        "class": shader.replace("def", "class"),
        "instance": 'def "Look" (\n    instanceable = true\n    references = @./look.usda@\n)\n'
        "{\n}\n",
    }[prim]
    block.write_text(block.read_text().rstrip().removesuffix("}") + added + "}\n")
    done = gf_usd("bake", block, *SMALL, "-o", "a.usdz")
    refused(done, 3, f"{block}: {block.parent / 'skin.png'} is empty (0 bytes)", "export it again")
    assert names(here) == []


METADATA = {
    "customData of </World>": "customData = {{ dictionary deep = {{ {} }} }}",
    "assetInfo of </World>": "assetInfo = {{ dictionary deep = {{ {} }} }}",
    "customData of </World.note>": "customData = {{ {} }}",
    "customData of </World.target>": "customData = {{ {} }}",
    "customLayerData of the stage": "customLayerData = {{ dictionary deep = {{ {} }} }}",
}


@pytest.mark.parametrize("where", METADATA)
@pytest.mark.parametrize("named", ["asset to = @./skin.png@", "asset[] to = [@./skin.png@]"])
def test_an_empty_file_that_metadata_names_is_refused_where_a_package_is_written(
    gf_usd, here: Path, where: str, named: str
) -> None:
    (here / "skin.png").touch()
    metadata = METADATA[where].format(named)
    of_prim, of_note, of_target = (
        metadata if where.endswith(f"</World{name}>") else "" for name in ("", ".note", ".target")
    )
    of_layer = f"({metadata})" if where.endswith("the stage") else ""
    (here / "cube.usda").write_text(
        f"""#usda 1.0
{of_layer}
def Xform "World" (
    {of_prim}
)
{{
    custom string note = "" (
        {of_note}
    )
    rel target = </World> (
        {of_target}
    )
    def Cube "Cube"
    {{
    }}
}}
"""
    )
    done = gf_usd("bake", "cube.usda", *SMALL, "-o", "a.usdz")
    refused(done, 3, f"cube.usda: {here / 'skin.png'} is empty (0 bytes)", "export it again")
    assert f"; {where} refers to it" in done.err
    assert names(here) == ["cube.usda", "skin.png"]


def test_words_that_are_no_option(gf_usd, here: Path, block: Path) -> None:
    for arguments, named in (
        (("--frames", "x"), "--frames"),
        (("--speed",), "--speed"),
        (("b",), "b"),
    ):
        done = gf_usd("bake", block, *arguments)
        assert (done.status, done.out) == (2, "")
        assert named in done.err
    assert names(here) == []


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize(
    ("number", "status", "word"),
    [
        (signal.SIGTERM, 143, "terminated"),
        pytest.param(signal.SIGINT, 130, "interrupted", marks=pytest.mark.slow),
    ],
)
def test_a_bake_that_is_stopped_leaves_partial_files_only(
    here: Path, block: Path, number: int, status: int, word: str
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "gf_usd", "bake", str(block), "--particles", "300",
         "--frames", "100000", "--drop", "150", "--clip-frames", "0", "-q"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + 60.0
        while "block.rubber.cache.partial.usdc" not in names(here) and process.poll() is None:
            assert time.monotonic() < deadline, "the bake never began to write"
            time.sleep(0.02)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == status
    assert (out, err) == ("", f"{word}; only *.partial.* files remain\n")
    assert names(here) == ["block.rubber.cache.partial.usdc"]


IN_A_CALLBACK = """
import signal, time, weakref
from gf_usd.cli import main

class Lock: pass

names = {"signal": signal}
source = "def cb(_): signal.raise_signal(signal.SIGTERM)"
exec(compile(source, main.BOOTSTRAP, "exec"), names)
signal.signal(signal.SIGTERM, main._stop)
lock = Lock()
watched = weakref.ref(lock, names["cb"])
del lock
time.sleep(600.0)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_signal_within_the_callback_of_an_import_lock_is_not_lost() -> None:
    """Python ignores exceptions there, and the bake would continue and wait for something else."""
    done = subprocess.run(
        [sys.executable, "-c", IN_A_CALLBACK],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert "terminated" in done.stderr
    assert "ignored" not in done.stderr

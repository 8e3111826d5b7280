"""Odd meshes and odd sizes through the whole command: a sound bake, or a refusal with a hint."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hostile_files import STAGE, sound
from hostile_shapes import SCALES, SHAPES, ball, shells, usda
from isolated_tasks import stopped
from pxr import Sdf, Vt

import gf_usd
from gf_usd.core.errors import GfUsdError, InputError
from gf_usd.layers.check.run import check_file
from gf_usd.system.sandbox import Limits

EACH = Limits(time=60.0, memory=8e9, output=1e8)


def outcome(file: Path, **options: object) -> str:
    """ "baked" with nothing for `check` to find, or "refused" with a message and a hint.

    In both cases no file is half-written, and after a refusal there is none.
    """
    folder = file.parent / "out"
    try:
        result = gf_usd.bake(
            file,
            output=f"{folder}/",
            material="rubber",
            particles=100,
            frames=3,
            overwrite=True,
            **options,  # type: ignore[arg-type]
        )
    except GfUsdError as refusal:
        error = refusal
    else:
        assert result.findings == ()
        assert check_file(result.root).ok or not check_file(file).ok  # the source's own faults
        assert not list(folder.rglob("*.partial.*"))
        return "baked"
    assert error.message
    assert error.hint
    assert not isinstance(error, InputError) or not folder.exists()
    return f"refused: {error.message}"


SOUND = {"inside_out", "half_inside_out", "touching_in_a_point", "through_itself", "overlapping",
         "every_face_twice", "loose_point", "three_on_an_edge"}  # fmt: skip
QUICK = {"half_inside_out", "flat", "back_to_back", "spike", "noise"}


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in SHAPES]
)
def test_odd_mesh(tmp_path: Path, name: str) -> None:
    file = tmp_path / f"{name}.usda"
    file.write_text(usda(SHAPES[name]()))
    ending = outcome(file)
    if name in SOUND:
        assert ending == "baked"
    if ending != "baked":
        outcome(file, repair=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCALES)
def test_absurd_size(tmp_path: Path, name: str) -> None:
    file = tmp_path / "ball.usda"
    file.write_text(usda(SCALES[name]()))
    outcome(file, time_scale="auto")


@pytest.mark.parametrize("unit", [1e-9, pytest.param(1e9, marks=pytest.mark.slow)])
def test_absurd_unit(tmp_path: Path, unit: float) -> None:
    file = tmp_path / "ball.usda"
    file.write_text(usda(ball(), meters_per_unit=unit))
    outcome(file, time_scale="auto")


@pytest.mark.slow
@pytest.mark.acceptance
def test_thousands_of_shells_end(tmp_path: Path) -> None:
    """In one mesh; the time limit is for a hang, not for speed."""
    file = tmp_path / "shells.usda"
    file.write_text(usda(shells(2000)))
    arguments = [
        "bake",
        str(file),
        "-o",
        f"{tmp_path}/out/",
        "--particles",
        "4000",
        "--frames",
        "2",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", *arguments], capture_output=True, text=True, timeout=150,
        check=False,
    )  # fmt: skip
    assert done.returncode in (0, 3), done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 0 or "hint: " in done.stderr


def test_metadata_of_single_precision(tmp_path: Path) -> None:
    """As Blender's older crates have it."""
    text, file = tmp_path / "text.usda", tmp_path / "single.usdc"
    text.write_text(usda(ball()))
    layer = Sdf.Layer.FindOrOpen(str(text))
    layer.pseudoRoot.SetInfo("metersPerUnit", Vt.Float(0.01))
    layer.Export(str(file))
    del layer
    assert outcome(file) == "baked"


def test_texture_that_is_missing(tmp_path: Path) -> None:
    file = tmp_path / "a.usda"
    look = """
    def Material "Look" {
        token outputs:surface.connect = </Look/S.outputs:surface>
        def Shader "S" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </Look/T.outputs:rgb>
            token outputs:surface
        }
        def Shader "T" {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./gone/nowhere.png@
            float3 outputs:rgb
        }
    }
"""
    bound = usda(ball(), more="        rel material:binding = </Look>\n").replace(
        'def Mesh "Skin"', 'def Mesh "Skin" (prepend apiSchemas = ["MaterialBindingAPI"])'
    )
    file.write_text(bound + look)
    assert outcome(file) == "baked"


@pytest.mark.slow
@pytest.mark.parametrize("cut", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_every_format_cut_short(tmp_path: Path, cut: float) -> None:
    """At a share of its bytes, and one byte before its end."""
    files = []
    for number, whole in enumerate(sound(tmp_path / "sound")):
        content = whole.read_bytes()
        files.append(tmp_path / f"cut{number}{whole.suffix}")
        files[-1].write_bytes(content[: min(int(cut * len(content)), len(content) - 1)])
    assert stopped(files, EACH) == {}


@pytest.mark.slow
def test_two_layers_that_refer_to_each_other(tmp_path: Path) -> None:
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.usda").write_text(
            STAGE.replace('def Xform "A" {', f'def Xform "A" (references = @./{other}.usda@) {{')
        )
    file = tmp_path / "a.usda"
    assert stopped([file], EACH) == {}
    outcome(file)

"""Opening USD: facts of the stage, and files that are not what their name says."""

import gc
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from gf_usd.core.errors import InputError
from gf_usd.readers import read_asset
from gf_usd.readers.usd.stage import layers_kept, open_stage, reading

BALL = 'def Sphere "Ball" {}'


def test_facts_of_a_stage_that_says_everything(read):
    facts = read(
        """#usda 1.0
        (
            defaultPrim = "A"
            metersPerUnit = 0.01
            kilogramsPerUnit = 0.001
            upAxis = "Z"
            startTimeCode = 101
            endTimeCode = 148
            timeCodesPerSecond = 48
        )
        def Sphere "A" {}
        class "Hidden" {}
        def Xform "B" (active = false) {}
        def PhysicsScene "Physics" {}
        """
    ).facts
    assert facts.units.meters_per_unit == 0.01
    assert facts.units.kilograms_per_unit == 0.001
    assert facts.up_axis == "Z"
    np.testing.assert_array_equal(facts.up, [0, 0, 1])
    assert (facts.start_time_code, facts.end_time_code) == (101, 148)
    assert facts.time_codes_per_second == 48
    assert facts.root_prims == ("/A", "/B", "/Physics")
    assert facts.default_prim == "/A"
    assert facts.says_physics
    assert facts.notes == ()
    assert (facts.unit_from, facts.axis_from) == ("file", "file")


def test_facts_of_a_stage_that_says_nothing(read):
    facts = read("#usda 1.0\n" + BALL).facts
    assert facts.units.meters_per_unit == 0.01
    assert facts.up_axis == "Y"
    assert facts.time_codes_per_second is facts.start_time_code is facts.end_time_code is None
    assert facts.default_prim is None
    assert not facts.says_physics
    assert facts.notes == (
        "metersPerUnit is not authored: 0.01 (centimeters), the default of USD, is assumed",
        "upAxis is not authored: Y, the default of USD, is assumed",
    )
    assert (facts.unit_from, facts.axis_from) == ("assumed", "assumed")


def test_frames_per_second_stand_in_for_time_codes_per_second(read):
    facts = read(f"#usda 1.0\n(framesPerSecond = 30)\n{BALL}").facts
    assert (facts.time_codes_per_second, facts.frames_per_second) == (30, 30)


def test_frames_per_second_are_those_of_playback(read):
    metadata = "framesPerSecond = 24\n timeCodesPerSecond = 48"
    facts = read(f"#usda 1.0\n({metadata})\n{BALL}").facts
    assert (facts.time_codes_per_second, facts.frames_per_second) == (48, 24)


def test_an_applied_physics_schema_counts_as_physics(read):
    body = 'def Sphere "Ball" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {}'
    assert read(body).facts.says_physics


def test_options_override_units_and_axis(read):
    asset = read(BALL, meters_per_unit=0.5, up_axis="z")
    assert asset.facts.units.meters_per_unit == 0.5
    assert asset.facts.up_axis == "Z"
    assert asset.surfaces[0].points.max() == pytest.approx(0.5)
    assert len(asset.facts.notes) == 2


def test_meters_per_unit_authored_as_a_float(tmp_path):
    """Old exporters wrote a float where a double belongs, and UsdGeom refuses to read it."""
    path = tmp_path / "old.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetMetadata("metersPerUnit", 0.5)
    UsdGeom.Sphere.Define(stage, "/Ball")
    stage.Save()
    del stage
    # The crate stores 0.5 inline: float bits, then the type, 9 = double, 8 = float.
    as_double, as_float = (bytes.fromhex(f"0000003f00000{n}40") for n in (9, 8))
    content = path.read_bytes()
    assert content.count(as_double) == 1
    path.write_bytes(content.replace(as_double, as_float))
    assert read_asset(path).facts.units.meters_per_unit == 0.5


@pytest.mark.parametrize("name", ["a b.obj", "ball.GLB", "x.spz"])
def test_a_file_of_another_format_is_not_quoted(write, name):
    """The error had the bytes that the file begins with."""
    path = write(b"glTF\x02\x00\x00\x00", name=name)
    with pytest.raises(InputError) as error:
        open_stage(path)
    assert error.value.message == f"{path} is not a USD file"
    assert error.value.hint.endswith("the root layer that gf-usd bake writes")


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz", "usd"])
def test_a_text_file_is_not_usd(write, suffix, capfd):
    path = write(b"hello world\nthis is a letter", name=f"letter.{suffix}")
    with pytest.raises(InputError) as error:
        read_asset(path)
    assert error.value.message == f"{path} is not a USD file: it begins with 'hello world'"
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('#usda 1.0\ndef Mesh "a"\n{\n    int x =\n}\n', r"asset\.usda:4"),
        (
            '#usda 1.0\ndef Mesh "a"\n{\n    point3f[] points = [(0, 0\n',
            r":5:1: TupleValueClose",
        ),
        ("#usda 1.0\ndef Mesh a {}\n", r":2:1: eof is expected at 'def Mesh a {}'"),
        ('#usda 1.0\ndef Mesh "a"\n{\n    string b = "c\n', r":4:1\d: syntax error at ''"),
        ("#usda 1.0\n(\n    upAxis = 3\n)\n", r"asset\.usda:3:14: Error parsing simple value"),
    ],
    ids=["no value", "open tuple", "no quotes", "open string", "wrong type"],
)
def test_broken_syntax_names_the_line(write, capfd, text, fault):
    path = write(text)
    with pytest.raises(InputError, match=rf"is damaged: .*{fault}") as error:
        read_asset(path)
    assert "pxrInternal" not in error.value.message
    assert "::" not in error.value.message
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("kept", [12, 90, 0.5, 0.9])
def test_a_truncated_crate_is_damaged(tmp_path, kept, capfd):
    whole = tmp_path / "whole.usdc"
    stage = Usd.Stage.CreateNew(str(whole))
    UsdGeom.Sphere.Define(stage, "/Ball")
    stage.Save()
    del stage
    content = whole.read_bytes()
    path = tmp_path / "part.usdc"
    path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    with pytest.raises(InputError, match="is damaged"):
        read_asset(path)
    assert capfd.readouterr().err == ""


def test_a_zip_that_is_no_usdz(write):
    with pytest.raises(InputError, match="is damaged"):
        read_asset(write(b"PK\x03\x04 and nothing more", name="box.usdz"))


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ("timeCodesPerSecond = 0", "timeCodesPerSecond = 0; it must be above 0"),
        ("timeCodesPerSecond = -24", "timeCodesPerSecond = -24; it must be above 0"),
        ("metersPerUnit = 0", "metersPerUnit = 0.0; it must be a number above 0"),
        ("metersPerUnit = -1", "metersPerUnit = -1.0; it must be a number above 0"),
        (
            "metersPerUnit = 1e-300",
            "metersPerUnit = 1e-300; it must be a number from 1e-30 to 1e30",
        ),
        ("metersPerUnit = inf", "metersPerUnit = inf; it must be a number from 1e-30 to 1e30"),
        ("kilogramsPerUnit = 0", "kilogramsPerUnit = 0.0; it must be a number above 0"),
        ('upAxis = "X"', "upAxis = 'X'; USD allows only Y and Z"),
    ],
)
def test_metadata_that_makes_no_sense(read, metadata, message):
    with pytest.raises(InputError) as error:
        read(f"#usda 1.0\n({metadata})\n{BALL}")
    assert error.value.message.endswith(message)


def test_zero_time_codes_in_a_sublayer_are_refused_before_samples_are_read(write):
    # Samples under such a layer are never done being read (usd-core 26.11).
    write(
        "#usda 1.0\n(timeCodesPerSecond = 0)\n"
        'over "Ball" {\ndouble radius.timeSamples = { 1: 2 }\n}\n',
        name="sub.usda",
    )
    path = write(f"#usda 1.0\n(subLayers = [@sub.usda@])\n{BALL}")
    with pytest.raises(InputError, match=r"timeCodesPerSecond = 0 in .*sub\.usda"):
        read_asset(path)


def test_options_that_make_no_sense(write):
    path = write(BALL)
    with pytest.raises(InputError, match="--meters-per-unit -1 is not a valid unit size"):
        read_asset(path, meters_per_unit=-1.0)
    with pytest.raises(InputError, match="up axis 'X'"):
        read_asset(path, up_axis="X")


@pytest.mark.parametrize("value", ["</A>", "{ int a = 1 }"])
def test_a_rate_that_is_no_number_is_refused(write, value):
    file = write(f"#usda 1.0\n(\n    timeCodesPerSecond = {value}\n)\n{BALL}\n")
    with pytest.raises(InputError, match="which is not a number; it must be above 0") as caught:
        read_asset(file)
    assert "set timeCodesPerSecond" in caught.value.hint


@pytest.mark.parametrize("name", ["startTimeCode", "endTimeCode"])
@pytest.mark.parametrize("value", ["nan", "inf", "-1e300", "2e9"])
def test_time_codes_that_no_frame_can_have_are_refused(write, name, value):
    path = write(f"#usda 1.0\n(\n{name} = {value}\n)\n{BALL}")
    with pytest.raises(InputError) as caught:
        read_asset(path)
    assert caught.value.message.startswith(f"{path}: {name} = {float(value):g};")
    assert name in caught.value.hint


def test_a_usd_error_may_quote_bytes_that_are_no_text(tmp_path):
    file = tmp_path / "a.usda"
    file.write_bytes(b'#usda 1.0\n(\n    defaultPrim = "\xff"\n)\n' + BALL.encode())
    with pytest.raises(InputError, match="is damaged: it holds bytes that are not UTF-8"):
        read_asset(file)


def test_a_composition_error_may_quote_bytes_that_are_no_text(write, monkeypatch):
    class Quoting:
        def __str__(self) -> str:
            return b"\xff".decode()  # as USD's own do; no file is known that makes one

    file = write(f"#usda 1.0\n{BALL}\n")
    monkeypatch.setattr(Usd.Stage, "GetCompositionErrors", lambda stage: [Quoting()])
    notes = read_asset(file).facts.notes
    assert "does not compose: it holds bytes that are not UTF-8" in notes


@pytest.mark.parametrize(
    ("metadata", "asset"),
    [
        (
            'dictionary gaussianFlesh = { string command = "gf-usd bake a.usda -o b.usda" }',
            "a.usda",
        ),
        ('dictionary gaussianFlesh = { string command = "gf-usd bake \'a b" }', ""),
        ('dictionary gaussianFlesh = { string command = "gf-usd" }', ""),
        ("dictionary gaussianFlesh = { int command = 3 }", ""),
        ('string gaussianFlesh = "of another program"', ""),
    ],
)
def test_the_asset_of_a_bake_is_that_of_its_command(read, metadata: str, asset: str) -> None:
    text = f"#usda 1.0\n(\ncustomLayerData = {{\n{metadata}\n}}\n)\n{BALL}"
    assert read(text).facts.baked_from == asset


def test_layers_are_parsed_once_where_they_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0\n")
    with layers_kept(), layers_kept():
        open_stage(path)
        path.write_text("#usda 1.0\ndef (")  # it is not parsed again
        open_stage(path)
    gc.collect()
    with pytest.raises(InputError, match="is damaged"), reading(path):
        open_stage(path)

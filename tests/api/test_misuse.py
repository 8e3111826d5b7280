"""What `gf_usd.bake` and `gf_usd.inspect` answer where a call makes no sense: errors of ours."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd
from small_bakes import BLOCK

import gf_usd
from gf_usd.api import deliver as api
from gf_usd.delivery import deliver
from gf_usd.delivery.splats.clouds import CHOICES
from gf_usd.prepare.options.table import OPTIONS, taken

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
SOUND: dict[str, Any] = {
    "law": "neoHookean", "density": 1000.0, "youngs_modulus": 3e4, "poissons_ratio": 0.3,
}  # fmt: skip


def material(**values: Any) -> gf_usd.Material:
    return gf_usd.Material(**{"name": "soft", **SOUND, **values})


def takes_nothing() -> None:
    """No function of (frames done, total frames)."""


def named(value: Any) -> str:
    """An id that is the same in every process: without the addresses of objects."""
    return re.sub(r" at 0x[0-9a-f]+", "", str(value))[:40]


# keywords, words of the message, words of the hint
MISUSES: list[tuple[dict[str, Any], str, str]] = [
    ({"partikles": 4}, "has no option 'partikles'", "did you mean particles?"),
    ({"max-hours": 4}, "has no option 'max-hours'", "did you mean max_hours?"),
    ({"pin": "/A"}, "has no option 'pin'", "did you mean pins?"),
    ({"dt": 0.1}, "has no option 'dt'", "its options are adaptive_samples, "),
    ({"particles": "4000"}, "particles is '4000', of type str", "without quotes: particles=4000"),
    ({"particles": "many"}, "particles is 'many'", "give a whole number"),
    ({"particles": 0.5}, "particles is 0.5", "give a whole number"),
    ({"particles": True}, "particles is True, of type bool", "give a whole number"),
    ({"particles": [300]}, "particles is [300], of type list", "give a whole number"),
    ({"particles": math.nan}, "particles is nan", "give a whole number"),
    ({"particles": 0}, "particles is 0", "give a number above 0"),
    ({"particles": 300, "spacing": 0.1}, "particles=300 and spacing=0.1 were both", "give one"),
    ({"fps": np.array([24.0, 25.0])}, "fps is array([24., 25.]), of type ndarray", "a number"),
    ({"restitution": 1.5}, "restitution is 1.5", "give a number from 0 to 1"),
    ({"overwrite": 1}, "overwrite is 1, of type int", "give True or False: overwrite=True"),
    ({"repair": "yes"}, "repair is 'yes'", "give True or False: repair=True"),
    ({"device": "tpu"}, "there is no device 'tpu'", "choose cpu or cuda"),
    ({"device": 0}, "device is 0, of type int", "one of 'cpu', 'cuda'"),
    ({"law": "hooke"}, "there is no law 'hooke'", "choose one of corotated, neoHookean"),
    ({"material": "ruber"}, "there is no material 'ruber'", "did you mean rubber?"),
    ({"material": ["rubber", "rubber"]}, "2 materials named 'rubber'", "name each once"),
    ({"material": []}, "material is [], of type list", "give a preset such as 'rubber'"),
    ({"material": 3}, "material is 3, of type int", "give a preset such as 'rubber'"),
    ({"material": {"/Duck": "metal"}}, "of type dict", "material_boxes and material_labels"),
    (
        {"material": material(poissons_ratio=0.5)},
        "poissons_ratio is 0.5",
        "between -1 and 0.5, without",
    ),
    ({"material": material(density=-1.0)}, "density is -1", "give a number above 0"),
    (
        {"material": material(youngs_modulus=math.nan)},
        "youngs_modulus is nan",
        "give a number above 0",
    ),
    ({"material": material(law="hooke")}, "there is no law 'hooke'", "choose one of"),
    ({"material": material(name="a b")}, "named 'a b'", "letters, digits, _ and -"),
    ({"material": material(parameters={"yield_stress": 1.0})}, "has no parameter", "none"),
    ({"drop": (1, 2)}, "drop is (1, 2), of type tuple", "'3r' (radii of the body)"),
    ({"drop": -1.0}, "drop is -1", "give a length of 0 or more"),
    ({"drop": "3 radii"}, "drop: '3 radii' is not a number", "3r (radii of the body)"),
    ({"gravity": (0, -9.81)}, "gravity is (0, -9.81)", "three numbers: (0, -9.81, 0)"),
    ({"velocity": (0, 1)}, "velocity is (0, 1)", "three numbers: (0, 2, 0)"),
    ({"velocity": 3.0}, "velocity is 3.0", "three numbers: (0, 2, 0)"),
    ({"spin": (0, "fast", 0)}, "spin is (0, 'fast', 0)", "three numbers: (0, 2, 0)"),
    ({"spin": (0, 1e12, 0)}, "spin is 0,1000000000000,0", "give at most 1e+09 degrees per second"),
    ({"colliders": 3}, "colliders is 3", "the path of a file, or a list of them"),
    ({"gravity": 1e30}, "gravity is 1e+30", "give at most 1e+09 m/s^2"),
    ({"floor": True}, "floor is True, of type bool", "a height such as 0.5"),
    ({"floor": (0.0, (0, -1, 0))}, "does not point up", "give none, a height"),
    ({"range": range(1, 24)}, "range is range(1, 24)", "the last one is included"),
    ({"range": (24, 1)}, "range is '24:1'", "give two time codes"),
    ({"clamp": 5.0}, "clamp is 5.0, of type float", "two stretches about 1 such as (0.2, 5)"),
    ({"only": ["mesh", "voxels"]}, "there is no 'voxels'", "mesh, gaussians, points"),
    ({"prims": 7}, "prims is 7, of type int", "such as '/World/Duck'"),
    ({"pins": [(0, 0, 0)]}, "pins is (0, 0, 0)", "two corners of a box"),
    ({"material_boxes": {"metal": (0, 1)}}, "material_boxes is", "{'metal': ((-1, 0, -1)"),
    ({"material_boxes": {"metal": ((0, 0, 0), (0, 1, 1))}}, "has no volume", "opposite corners"),
    ({"material_labels": {"label": "metal"}}, "material_labels is", "{'label': {3: 'metal'}}"),
    ({"limits": {"time": -1}}, "limits: 'time' is -1", "numbers above 0 for time, memory, output"),
    ({"limits": {"cpu": 1}}, "limits: 'cpu' is 1", "numbers above 0 for time, memory, output"),
    ({"progress": 3}, "progress is 3, of type int", "a function of (frames done, total frames)"),
    ({"progress": takes_nothing}, "of type function", "a function of (frames done, total frames)"),
    ({"max_hours": -1}, "max_hours is -1", "give a number of 0 or more"),
    ({"max_hours": math.nan}, "max_hours is nan", "give a number of 0 or more"),
    ({"only": []}, "only is [], of type list", "give a word, or a list of words"),
    ({"material_labels": {"label": {"3": "metal"}}}, "material_labels is", "{'label': {3: 'metal'"),
    ({"output": b"out"}, "output is b'out', of type bytes", "an object of pathlib"),
    ({"solver": "ul", "pins": "/A"}, "solver ul does not support pins", "or use solver tl"),
    ({"max_hours": "1"}, "max_hours is '1'", "without quotes: max_hours=1"),
]


@pytest.mark.parametrize("function", [gf_usd.bake])
@pytest.mark.parametrize(("options", "message", "hint"), MISUSES, ids=named)
def test_a_misuse_is_a_usage_error_that_names_keywords(
    function: Any, options: dict[str, Any], message: str, hint: str, tmp_path: Path
) -> None:
    with pytest.raises(gf_usd.UsageError) as caught:
        function(SPHERE, **{"output": f"{tmp_path}/", **options})
    assert message in caught.value.message
    assert hint in caught.value.hint
    assert "--" not in str(caught.value), "an option of the command line"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message", "hint"),
    [
        ((), "the asset is None", "give the path of a file"),
        ((3,), "the asset is 3, of type int", "give the path of a file"),
        (("",), "the asset is ''", "give the path of a file"),
        ((["a.usda", "b.usda"],), "of type list", "gf-usd batch, bakes several"),
        ((Usd.Stage.CreateInMemory(),), "the asset is a stage", "stage.Export('asset.usda')"),
        ((str(SPHERE), "rubber"), "'rubber' has no keyword", "material='rubber'"),
    ],
)
def test_what_is_no_asset_is_refused(arguments: tuple[Any, ...], message: str, hint: str) -> None:
    with pytest.raises(gf_usd.UsageError) as caught:
        gf_usd.bake(*arguments)
    assert message in caught.value.message
    assert hint in caught.value.hint


def test_a_file_that_is_not_there_is_an_input_error() -> None:
    with pytest.raises(gf_usd.InputError, match=r"nope\.usda does not exist"):
        gf_usd.bake("nope.usda")


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("drop", 3, "3"),
        ("drop", np.float32(0.5), "0.5"),
        ("drop", "3r", "3r"),
        ("time_scale", 0.2, "0.2"),
        ("velocity", np.array([0.0, 1.5, 0.0]), "0,1.5,0"),
        ("gravity", 1.62, "1.62"),
        ("gravity", (0, -9.81, 0), "0,-9.81,0"),
        ("gravity", np.array([0.0, -9.81, 0.0]), "0,-9.81,0"),
        ("floor", 0, "0"),
        ("floor", False, "none"),
        ("floor", (0.2, 1, 0), "0.2,1,0"),
        ("floor", (0.5, [0.2, 1, 0]), "0.5:0.2,1,0"),
        ("range", (1, 10), "1:10"),
        ("range", [10, None], "10:"),
        ("clamp", (0.2, 5), "0.2:5"),
        ("clamp", False, "none"),
        ("stress_cap", 2e4, "20000"),
        ("only", ["mesh", "points"], "mesh,points"),
        ("material", ["rubber", Path("a/b.usda")], "rubber,a/b.usda"),
        ("output", Path("out"), "out/"),
        ("output", Path("out/a.usda"), "out/a.usda"),
        ("prims", "/Duck", ("/Duck",)),
        ("prims", [Sdf.Path("/Duck"), "/A"], ("/Duck", "/A")),
        ("pins", ((-1, 0, -1), (1, 0.2, 1)), ("box:-1,0,-1,1,0.2,1",)),
        ("pins", ["/A", ((-1, 0, -1), (1, 0.2, 1))], ("/A", "box:-1,0,-1,1,0.2,1")),
        ("material_boxes", {"metal": ((0, 0, 0), (1, 1, 1))}, ("metal:0,0,0,1,1,1",)),
        (
            "material_boxes",
            {"clay": [((0, 0, 0), (1, 1, 1)), ((2, 0, 0), (3, 1, 1))]},
            ("clay:0,0,0,1,1,1", "clay:2,0,0,3,1,1"),
        ),
        ("material_labels", {"label": {3: "metal"}}, ("label=3:metal",)),
        ("material_sweep", ("youngs", 1e4, 1e6, 5), "youngs=10000:1000000:5"),
        ("particles", 4e3, 4000),
        ("seed", np.int64(7), 7),
        ("wls", np.bool_(True), True),
        ("filter_rate", math.inf, math.inf),
        ("limits", False, None),
    ],
)
def test_a_value_of_python_is_what_the_command_line_has(name: str, value: Any, text: Any) -> None:
    found = taken({name: value}, "bake")[name]
    assert (found, type(found)) == (text, type(text))


@pytest.mark.parametrize("name", OPTIONS)
def test_none_is_the_same_as_nothing(name: str) -> None:
    assert taken({name: None}, "bake") == {name: OPTIONS[name].default}


def test_every_text_option_takes_values_of_python() -> None:
    plain = {name for name, row in OPTIONS.items() if row.parse and not row.write}
    assert plain == set()


def test_python_values_are_baked_and_recorded_in_the_command(tmp_path: Path) -> None:
    done: list[int] = []
    result = gf_usd.bake(
        SPHERE, material=["jelly", material()], drop=1.0, floor=0, range=(1, 3),
        gravity=(0, -9.81, 0), prims="/Sphere", particles=100, output=tmp_path / "out",
        overwrite=True, progress=lambda frame, total: done.append(frame),
    )  # fmt: skip
    assert result.root == tmp_path / "out" / "sphere.jelly-soft.usda"
    assert (result.settings.frames, result.settings.lift[1] > 0.0, len(done)) == (3, True, 6)
    soft = result.bakes[1].material
    assert (soft.name, soft.youngs_modulus) == ("soft", 3e4)
    command = "--material jelly,soft --drop 1 --floor 0 --range 1:3 --gravity 0,-9.81,0 --particles"
    assert command in result.report.read_text(encoding="utf-8").replace("--prim /Sphere ", "")
    assert any("material soft were given by the caller" in note for note in result.notes)


@pytest.mark.parametrize("targets", [3, None, [3]])
def test_targets_that_are_none_are_refused(targets: Any) -> None:
    with pytest.raises(gf_usd.UsageError, match=r"^targets is (3|None|\[3\]), of type"):
        gf_usd.fit("duck.usda", targets)


# function, keywords, words of the message, words of the hint
OTHER_MISUSES: list[tuple[str, dict[str, Any], str, str]] = [
    ("fit", {"unknowns": 5}, "unknowns is 5, of type int", "such as ['E', 'nu']"),
    ("fit", {"unknowns": ["E", 3]}, "unknowns is 3, of type int", "such as ['E', 'nu']"),
    ("fit", {"evaluations": 5}, "evaluations is 5, of type int", "give a path"),
    ("fit", {"jobs": 0}, "jobs is 0", "give 1 or more"),
    ("fit", {"jobs": "2"}, "jobs is '2', of type str", "without quotes: jobs=2"),
    ("fit", {"jobs": 1.5}, "jobs is 1.5", "give a whole number"),
    ("fit", {"overwrite": "no"}, "overwrite is 'no'", "give True or False: overwrite=True"),
    ("fit", {"progress": 3}, "progress is 3, of type int", "(frames done, total frames)"),
    ("compare", {"output": 3}, "output is 3, of type int", "a path, or a list of them"),
    ("compare", {"variant": 3}, "variant is 3, of type int", "the name of a variant"),
    ("compare", {"other_variant": []}, "other_variant is [], of type", "the name of a variant"),
    ("compare", {"progress": 3}, "progress is 3, of type int", "(frames done, total frames)"),
    ("preview", {"camera": 3}, "camera is 3, of type int", "the path of a camera"),
    ("preview", {"progress": "bar"}, "progress is 'bar'", "(frames done, total frames)"),
    ("report", {"splats": "all"}, "splats is 'all'", "give True or False: splats=True"),
    ("report", {"output": []}, "output is [], of type list", "give a path"),
    ("report", {"variant": 3}, "variant is 3, of type int", "the name of a variant"),
    ("deliver", {"variant": 3}, "variant is 3, of type int", "the name of a variant"),
    ("deliver", {"kind": object()}, "kind is <object", "'joints'"),
    ("deliver", {"splats": None}, "splats is None", "'captured'"),
    ("deliver", {"bind_splats": 1}, "bind_splats is 1", "'skin'"),
    ("deliver", {"max_joints": 0}, "max_joints is 0", "give 1 or more"),
    ("deliver", {"max_shapes": -1}, "max_shapes is -1", "give 1 or more"),
]
NEEDED: dict[str, dict[str, Any]] = {
    "fit": {"targets": {"squash": 0.3}, "max_minutes": 0.0, "particles": 100, "frames": 1},
    "compare": {"other": SPHERE},
    "deliver": {"output": "sphere.glb"},
    "report": {"output": "sphere.html"},
}


@pytest.mark.parametrize(("function", "options", "message", "hint"), OTHER_MISUSES, ids=named)
def test_a_misuse_of_another_function_is_a_usage_error(
    function: str,
    options: dict[str, Any],
    message: str,
    hint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(gf_usd.UsageError) as caught:
        getattr(gf_usd, function)(SPHERE, **{**NEEDED.get(function, {}), **options})
    assert message in caught.value.message
    assert hint in caught.value.hint
    assert "--" not in str(caught.value), "an option of the command line"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("radius", [-1.0, 0.0, math.nan, math.inf])
def test_a_dimensionless_preset_refuses_an_invalid_radius(radius: float) -> None:
    with pytest.raises(gf_usd.UsageError, match=rf"^preset rubber: the radius is {radius:g}\n"):
        gf_usd.materials()["rubber"].material(radius)


@pytest.mark.parametrize("minutes", [math.nan, -1.0])
def test_a_time_for_a_fit_that_is_none_is_refused(minutes: float) -> None:
    with pytest.raises(gf_usd.UsageError, match=rf"^max_minutes is {minutes:g}\n"):
        gf_usd.fit("duck.usda", {"squash": 0.1}, max_minutes=minutes)


def test_a_refusal_that_is_part_of_the_result_names_keywords(tmp_path: Path) -> None:
    path = tmp_path / "block.usda"
    path.write_text(BLOCK, encoding="utf-8")
    far = {"metal": ((90, 90, 90), (91, 91, 91))}
    refusal = gf_usd.inspect(path, particles=100, material_boxes=far).refusal
    assert refusal is not None
    assert refusal.message.startswith("material_boxes metal:90,90,90,91,91,91 contains none")
    assert "--" not in str(refusal)


def test_the_word_default_is_the_same_as_leaving_an_option_out() -> None:
    assert taken({name: "default" for name in OPTIONS if name != "output"}, "gf_usd.bake") == {
        name: row.default for name, row in OPTIONS.items() if name != "output"
    }
    assert taken({"output": "default"}, "gf_usd.bake") == {"output": "default"}


def test_deliver_of_python_has_the_choices_of_the_command_line() -> None:
    """It cannot import them: in a host with an OpenUSD of its own they are in another process."""
    assert api.KINDS == deliver.KINDS
    assert set(api.SPLATS) == set(CHOICES)
    assert api.BINDINGS == deliver.BINDINGS

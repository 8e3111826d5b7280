"""Materials out of a USD file: the names of the field, in the units of the file."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Sdf, Usd
from small_stages import RUBBER

from gf_usd.core.errors import InputError
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.units import StageUnits
from gf_usd.layers.materials import write_materials
from gf_usd.readers.usd_bake.material_file import is_material_file, read_material

CM = "metersPerUnit = 0.01"
SOUND = {"youngsModulus": "1e4", "poissonsRatio": "0.3", "density": "0.0011"}
REL = 1e-6  # values in a file are float32


def attributes(prefix: str, values: dict[str, str]) -> str:
    """Lines of usda."""
    return "\n".join(f"    float {prefix}{name} = {value}" for name, value in values.items())


def material(name: str, *lines: str) -> str:
    """A Material prim."""
    return f'def Material "{name}"\n{{\n' + "\n".join(lines) + "\n}\n"


@pytest.fixture
def write(tmp_path: Path):
    """Write a layer in centimeters, or with another head."""

    def write(*prims: str, head: str = CM, name: str = "soft.usda") -> Path:
        path = tmp_path / name
        path.write_text(f"#usda 1.0\n(\n{head}\n)\n" + "".join(prims), encoding="utf-8")
        return path

    return write


def refusal(path: Path) -> tuple[str, str]:
    """Message, without the file's name at its head, and hint."""
    with pytest.raises(InputError) as caught:
        read_material(path)
    assert caught.value.exit_status == 3
    assert caught.value.message.startswith(str(path))
    return caught.value.message[len(str(path)) :], caught.value.hint


@pytest.mark.parametrize("prefix", ["physics:", "newton:mpm:", "omniphysics:"])
def test_every_vocabulary_is_read_in_the_file_s_units(write, prefix: str) -> None:
    values = {**SOUND, "dynamicFriction": "0.25", "restitution": "0.5"}
    made = read_material(write(material("Soft", attributes(prefix, values))))
    # A pressure is a force over an area in cm: kg / (cm s^2) = 100 Pa; kg / cm^3 = 1e6 kg / m^3.
    assert made.youngs_modulus == pytest.approx(1e6, rel=REL)
    assert made.density == pytest.approx(1100.0, rel=REL)
    assert made.poissons_ratio == pytest.approx(0.3, rel=REL)
    assert (made.friction, made.restitution) == (0.25, 0.5)
    assert made.name == "Soft"


def test_what_is_not_said_is_assumed_as_documented(write) -> None:
    made = read_material(write(material("Soft", attributes("physics:", SOUND))))
    assert (made.law, made.damping_time) == ("neoHookean", 0.0)
    assert (made.friction, made.restitution) == (0.8, 0.85)


def test_a_file_without_units_is_in_centimeters_and_kilograms(write) -> None:
    made = read_material(write(material("Soft", attributes("physics:", SOUND)), head=""))
    assert made.youngs_modulus == pytest.approx(1e6, rel=REL)


def test_kilograms_per_unit_count(write) -> None:
    head = "metersPerUnit = 0.1\nkilogramsPerUnit = 0.001"
    made = read_material(write(material("Soft", attributes("physics:", SOUND)), head=head))
    assert made.youngs_modulus == pytest.approx(1e4 * 0.001 / 0.1, rel=REL)
    assert made.density == pytest.approx(0.0011 * 0.001 / 0.1**3, rel=REL)


def test_the_first_vocabulary_wins_name_by_name(write) -> None:
    path = write(
        material(
            "Soft",
            attributes("omniphysics:", {"youngsModulus": "3", "density": "3", **SOUND}),
            attributes("newton:mpm:", {"youngsModulus": "2e4", "poissonsRatio": "0.2"}),
            attributes("physics:", {"youngsModulus": "5e4"}),
        )
    )
    made = read_material(path)
    assert made.youngs_modulus == pytest.approx(5e6, rel=REL)
    assert made.poissons_ratio == pytest.approx(0.2, rel=REL)
    assert made.density == pytest.approx(1100.0, rel=REL)


def test_law_and_damping_are_read_by_our_names(write) -> None:
    ours = 'uniform token gaussianFlesh:law = "corotated"\nfloat gaussianFlesh:dampingTime = 0.02'
    made = read_material(write(material("Soft", attributes("physics:", SOUND), ours)))
    assert made.law == "corotated"
    assert made.damping_time == pytest.approx(0.02, rel=REL)


@pytest.mark.parametrize("meters", [1.0, 0.01])
def test_what_a_bake_writes_is_read_back(tmp_path: Path, meters: float) -> None:
    path = tmp_path / "baked.usda"
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetMetadata("metersPerUnit", meters)
    units = StageUnits(meters_per_unit=meters)
    write_materials(stage, Sdf.Path("/Materials"), [RUBBER], "rubber", units)
    stage.Save()
    made = read_material(path)
    for name, value in RUBBER.__dict__.items():
        expected = value if isinstance(value, str) else pytest.approx(value, rel=REL)
        assert getattr(made, name) == expected, name


def test_the_default_prim_is_chosen_among_several(write) -> None:
    both = [material(n, attributes("physics:", SOUND)) for n in ("Soft", "Softer")]
    look = material("Paint", "color3f inputs:diffuseColor = (1, 0, 0)")
    assert read_material(write(look, both[0])).name == "Soft"
    chosen = write(*both, head=f'{CM}\ndefaultPrim = "Softer"')
    assert read_material(chosen).name == "Softer"
    message, hint = refusal(write(*both))
    assert message == " has 2 materials: </Soft>, </Softer>"
    assert hint == "make one of them the default prim"


def test_a_file_without_a_physical_material(write) -> None:
    expected = (
        " has no material with a Young's modulus",
        "author physics:youngsModulus and physics:poissonsRatio on a Material prim",
    )
    assert refusal(write(material("Paint", "color3f inputs:diffuseColor = (1, 0, 0)"))) == expected
    scope = f'def Scope "Soft"\n{{\n{attributes("physics:", SOUND)}\n}}\n'
    assert refusal(write(scope)) == expected


@pytest.mark.parametrize("name", ["poissonsRatio", "density"])
def test_what_has_no_default_must_be_there(write, name: str) -> None:
    values = {key: value for key, value in SOUND.items() if key != name}
    word = {"poissonsRatio": "Poisson's ratio", "density": "density"}[name]
    assert refusal(write(material("Soft", attributes("physics:", values)))) == (
        f": </Soft> has no {word}",
        f"author physics:{name}",
    )


@pytest.mark.parametrize(
    ("values", "message", "hint"),
    [
        ({"youngsModulus": "0"}, "Young's modulus [Pa] is 0", "between 0 and 1e+13"),
        ({"youngsModulus": "-2"}, "Young's modulus [Pa] is -200", "between 0 and 1e+13"),
        ({"youngsModulus": "inf"}, "Young's modulus [Pa] is inf", "between 0 and 1e+13"),
        ({"poissonsRatio": "0.5"}, "Poisson's ratio is 0.5", "between -1 and 0.5"),
        ({"poissonsRatio": "-1"}, "Poisson's ratio is -1", "between -1 and 0.5"),
        ({"density": "0"}, "physics:density [kg/m^3] is 0", "between 0 and 1e+06"),
        ({"density": "2"}, "physics:density [kg/m^3] is 2e+06", "between 0 and 1e+06"),
        ({"density": "nan"}, "physics:density [kg/m^3] is nan", "between 0 and 1e+06"),
        ({"dynamicFriction": "-0.5"}, "friction is -0.5", "from 0 to 100"),
        ({"restitution": "1.5"}, "restitution is 1.5", "from 0 to 1"),
    ],
)
def test_values_out_of_range(write, values: dict[str, str], message: str, hint: str) -> None:
    path = write(material("Soft", attributes("physics:", {**SOUND, **values})))
    assert refusal(path) == (f": </Soft>: {message}", f"give a value {hint}")


@pytest.mark.parametrize(
    ("line", "message", "hint"),
    [
        (
            'uniform token gaussianFlesh:law = "hyper"',
            "gaussianFlesh:law is 'hyper'",
            f"choose one of {', '.join(LAWS)}",
        ),
        (
            "float gaussianFlesh:dampingTime = -1",
            "damping time [s] is -1",
            "give a value from 0 to 1e+06",
        ),
    ],
)
def test_values_of_ours_that_do_not_do(write, line: str, message: str, hint: str) -> None:
    path = write(material("Soft", attributes("physics:", SOUND), line))
    assert refusal(path) == (f": </Soft>: {message}", hint)


@pytest.mark.parametrize("name", ["metersPerUnit", "kilogramsPerUnit"])
@pytest.mark.parametrize("size", ["0", "-1", "inf"])
def test_units_that_are_none(write, name: str, size: str) -> None:
    path = write(material("Soft", attributes("physics:", SOUND)), head=f"{name} = {size}")
    assert refusal(path) == (f": {name} is {size}", f"author a {name} above 0")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert refusal(tmp_path / "no.usda") == (
        " does not exist",
        "check the spelling of --material",
    )
    text = tmp_path / "text.usda"
    text.write_text("rubber, please")
    assert refusal(text) == (" cannot be read as USD", "check it with usdcat or gf-usd check")


def test_a_file_is_distinguished_from_a_preset_by_its_suffix() -> None:
    assert all(is_material_file(f"a/soft{s}") for s in (".usd", ".usda", ".USDC", ".usdz"))
    assert not any(is_material_file(name) for name in ("rubber", "soft-silicone", "usda", "a.obj"))

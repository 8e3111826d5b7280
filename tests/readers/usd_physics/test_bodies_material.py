"""Physics materials as bound to bodies and to parts of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from physics_stages import bound, head, mesh, physics_of, prim

from gf_usd.core.errors import InputError
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import StagePhysics
from gf_usd.core.units import StageUnits
from gf_usd.readers.usd_physics.materials import read_material_spec

Write = Callable[..., Path]

REL = 1e-6  # values in a file are float32
SOFT = ("float physics:youngsModulus = 1e4", "float physics:poissonsRatio = 0.25")
HARD = ("float physics:youngsModulus = 5e6", "float physics:poissonsRatio = 0.25")
DENSE = "float physics:density = 1200"
BINDING = ("MaterialBindingAPI",)
BASE = Material(
    name="base", law="corotated", density=900.0, youngs_modulus=1e5, poissons_ratio=0.3,
    damping_time=0.5, friction=0.1, restitution=0.2,
)  # fmt: skip


def material(name: str, *lines: str) -> str:
    return prim("Material", name, *lines, apis=["PhysicsMaterialAPI"])


def subset(name: str, faces: str, *lines: str, kind: str = "face") -> str:
    return prim(
        "GeomSubset",
        name,
        f'uniform token elementType = "{kind}"',
        'uniform token familyName = "materialBind"',
        f"int[] indices = [{faces}]",
        *lines,
        apis=BINDING,
    )


@pytest.fixture
def read_physics(write: Write) -> Callable[..., StagePhysics]:
    """What a stage says of /Duck."""

    def read_physics(*prims: str, layer: str = head(), body: str = "/Duck") -> StagePhysics:
        return physics_of(write(layer + "".join(prims)), body)

    return read_physics


def duck(*lines: str) -> str:
    return mesh("Duck", *lines, apis=BINDING)


def test_the_bound_material_in_si(read_physics) -> None:
    layer = head(0.01, kilograms=0.001)
    friction = "float physics:staticFriction = 0.75\nfloat physics:dynamicFriction = 0.5"
    ours = 'uniform token gaussianFlesh:law = "corotated"\nfloat gaussianFlesh:dampingTime = 0.25'
    stated = material("Soft", *SOFT, "float physics:density = 2", friction, ours)
    (body,) = read_physics(stated, duck(bound("/Soft")), layer=layer).bodies
    made = body.material
    assert made is not None
    # g / (cm s^2) = 0.1 Pa; g / cm^3 = 1000 kg/m^3
    assert made.youngs_modulus == pytest.approx(1e3, rel=REL)
    assert made.density == pytest.approx(2000.0, rel=REL)
    assert (made.name, made.law, made.poissons_ratio) == ("Soft", "corotated", 0.25)
    assert (made.friction, made.damping_time, body.spec.static_friction) == (0.5, 0.25, 0.75)
    assert body.resolve(BASE) == made


@pytest.mark.parametrize("prefix", ["newton:mpm:", "omniphysics:"])
def test_the_neighbors_moduli_are_read_after_those_of_the_field(read_physics, prefix: str) -> None:
    theirs = [line.replace("physics:", prefix) for line in SOFT]
    (body,) = read_physics(material("Soft", DENSE, *theirs), duck(bound("/Soft"))).bodies
    assert body.material is not None
    assert body.material.youngs_modulus == pytest.approx(1e4)
    (body,) = read_physics(material("Soft", DENSE, *theirs, HARD[0]), duck(bound("/Soft"))).bodies
    assert body.material is not None
    assert body.material.youngs_modulus == pytest.approx(5e6)


@pytest.mark.parametrize("nothing", ["0", "-inf"])
def test_what_stands_for_nothing_leaves_the_word_to_the_next(read_physics, nothing: str) -> None:
    silent = f"float physics:youngsModulus = {nothing}"
    theirs = [line.replace("physics:", "newton:mpm:") for line in SOFT]
    (body,) = read_physics(material("Soft", DENSE, silent, *theirs), duck(bound("/Soft"))).bodies
    assert body.material is not None
    assert body.material.youngs_modulus == pytest.approx(1e4)
    (body,) = read_physics(material("Soft", DENSE, silent), duck(bound("/Soft"))).bodies
    assert body.material is None


def test_newtons_damping_is_a_viscosity(read_physics) -> None:
    viscous = "float newton:mpm:elasticDamping = 50"
    stated = material("Soft", "float physics:density = 0.001", *SOFT, viscous)
    # E is a hundredfold in Pa, and so is the viscosity in Pa s: their ratio is in seconds
    for layer in (head(), head(0.01)):
        made = read_physics(stated, duck(bound("/Soft")), layer=layer).bodies[0].material
        assert made is not None
        assert made.damping_time == pytest.approx(50 / 1e4)
    ours = "float gaussianFlesh:dampingTime = 0.25"
    (body,) = read_physics(
        material("Soft", DENSE, *SOFT, viscous, ours), duck(bound("/Soft"))
    ).bodies
    assert body.spec.damping_time == 0.25


def test_what_is_assumed_is_said(read_physics) -> None:
    found = read_physics(material("Soft", SOFT[0]), duck(bound("/Soft")))
    made = found.bodies[0].material
    assert made is not None
    assert (made.poissons_ratio, made.density, made.law) == (0.3, 1000.0, "neoHookean")
    assert found.notes == (
        "</Soft>: no Poisson's ratio is stated: 0.3 is assumed",
        "</Soft>: no density is stated: 1000 kg/m^3 is assumed",
    )
    half = "float physics:poissonsRatio = 0.5"
    found = read_physics(material("Soft", SOFT[0], half, DENSE), duck(bound("/Soft")))
    assert found.bodies[0].material is not None
    assert found.bodies[0].material.poissons_ratio == 0.47
    assert found.notes == ("</Soft>: Poisson's ratio is 0.5 (incompressible): 0.47 is used",)


def test_a_material_without_moduli_goes_over_the_preset(read_physics) -> None:
    friction = "float physics:dynamicFriction = 0.5\nfloat physics:restitution = 0.25"
    (body,) = read_physics(material("Wet", DENSE, friction), duck(bound("/Wet"))).bodies
    assert body.material is None
    made = body.resolve(BASE)
    assert (made.density, made.friction, made.restitution) == (1200.0, 0.5, 0.25)
    assert (made.name, made.law, made.youngs_modulus) == ("base", "corotated", 1e5)
    assert made.damping_time == 0.5


def test_the_density_of_the_mass_api_goes_before_the_material_s(read_physics) -> None:
    own = "float physics:density = 700"
    heavy = mesh("Duck", own, bound("/Soft"), apis=["MaterialBindingAPI", "PhysicsMassAPI"])
    found = read_physics(material("Soft", *SOFT), heavy)
    assert found.bodies[0].resolve(BASE).density == 700.0
    assert found.notes == ()  # no density had to be assumed


def test_the_physics_purpose_goes_before_all_purposes_and_above_before_nothing(
    read_physics,
) -> None:
    stage = material("Soft", DENSE, *SOFT) + material("Hard", DENSE, *HARD)

    def path(*lines: str) -> str:
        (body,) = read_physics(stage, *lines, body="/Pond/Duck").bodies
        return body.spec.path

    def pond(inside: str, *lines: str) -> str:
        return prim("Xform", "Pond", *lines, inside, apis=BINDING)

    assert path(pond(duck(bound("/Soft"), bound("/Hard", "")))) == "/Soft"
    assert path(pond(duck(bound("/Hard", "")))) == "/Hard"
    assert path(pond(duck(), bound("/Soft"))) == "/Soft"
    assert path(pond(duck(bound("/Hard", "")), bound("/Soft"))) == "/Soft"
    assert path(pond(duck())) == ""


def test_a_shading_material_has_no_physics(read_physics) -> None:
    paint = prim("Material", "Paint", "token outputs:surface")
    (body,) = read_physics(paint, duck(bound("/Paint", ""))).bodies
    assert (body.spec.path, body.material) == ("/Paint", None)
    assert body.resolve(BASE) == BASE


def test_a_binding_that_composition_brings(read_physics, tmp_path: Path) -> None:
    stage = material("Soft", DENSE, *SOFT) + material("Hard", DENSE, *HARD)
    style = f'class "Style" (prepend apiSchemas = ["{BINDING[0]}"]) {{\n{bound("/Soft")}\n}}\n'
    (body,) = read_physics(stage, style, mesh("Duck", meta="inherits = </Style>")).bodies
    assert body.spec.path == "/Soft"

    (tmp_path / "ref.usda").write_text(
        head() + prim("Xform", "Duck", material("Own", DENSE, *SOFT), duck(bound("/Duck/Own")))
    )
    there = prim("Xform", "There", meta="prepend references = @ref.usda@</Duck>")
    (body,) = read_physics(there, body="/There/Duck").bodies
    assert body.spec.path == "/There/Own"

    sets = """
    variantSet "feel" = {
        "soft" {
            rel material:binding:physics = </Soft>
        }
        "hard" {
            rel material:binding:physics = </Hard>
        }
    }
    """
    for feel, expected in (("soft", "/Soft"), ("hard", "/Hard")):
        meta = f'variants = {{ string feel = "{feel}" }}\nprepend variantSets = "feel"'
        (body,) = read_physics(stage, mesh("Duck", sets, apis=BINDING, meta=meta)).bodies
        assert body.spec.path == expected


@pytest.mark.parametrize(
    ("line", "message", "hint"),
    [
        ("float physics:youngsModulus = -2", "Young's modulus [Pa] is -2", "between 0 and 1e+13"),
        ("float physics:youngsModulus = nan", "Young's modulus [Pa] is nan", "between 0"),
        ("float physics:density = -1", "physics:density [kg/m^3] is -1", "between 0 and 1e+06"),
        ("float physics:dynamicFriction = -1", "friction is -1", "from 0 to 100"),
        ("float physics:restitution = 2", "restitution is 2", "from 0 to 1"),
        ("float newton:mpm:poissonsRatio = 0.6", "Poisson's ratio is 0.6", "between -1 and 0.5"),
        ('uniform token gaussianFlesh:law = "hyper"', "gaussianFlesh:law is 'hyper'", "choose"),
        ('string omniphysics:density = "thick"', "omniphysics:density is 'thick'", "float"),
    ],
)
def test_values_that_make_no_sense_are_refused(
    read_physics, line: str, message: str, hint: str
) -> None:
    young = [] if "youngs" in line else [SOFT[0]]
    with pytest.raises(InputError) as caught:
        read_physics(material("Soft", *young, line), duck(bound("/Soft")))
    assert f"</Soft>: {message}" in caught.value.message
    assert hint in caught.value.hint


def test_parts_of_a_mesh_have_materials_of_their_own(read_physics) -> None:
    stage = material("Soft", DENSE, *SOFT) + material("Hard", DENSE, *HARD)
    hard = subset("beak", "4, 1, 4", bound("/Hard"))
    same = subset("tail", "2", bound("/Soft"))
    (body,) = read_physics(stage, duck(bound("/Soft"), hard, same)).bodies
    (beak,) = body.subsets
    assert beak.path == "/Duck/beak"
    np.testing.assert_array_equal(beak.faces, [1, 4])
    assert beak.material is not None
    assert beak.material.youngs_modulus == pytest.approx(5e6)
    assert beak.resolve(BASE, density=5.0).density == 5.0
    # a look on some faces is no physics material, with or without one on the mesh
    look = prim("Material", "Paint")
    eye = subset("eye", "3", bound("/Paint", ""))
    for whole in ("", bound("/Soft")):
        (body,) = read_physics(stage, look, duck(whole, eye)).bodies
        assert body.subsets == ()


def test_a_face_in_two_parts_belongs_to_the_first_and_this_is_said(read_physics) -> None:
    stage = material("Soft", DENSE, *SOFT) + material("Hard", DENSE, *HARD)
    parts = [subset("one", "0, 1", bound("/Soft")), subset("two", "1, 2", bound("/Hard"))]
    found = read_physics(stage, duck(*parts))
    assert [part.faces.tolist() for part in found.bodies[0].subsets] == [[0, 1], [2]]
    assert found.notes == ("</Duck/two>: shares faces with an earlier subset, which keeps them",)


def test_parts_that_are_no_faces(read_physics) -> None:
    stage = material("Hard", DENSE, *HARD)
    points = subset("dots", "0, 1", bound("/Hard"), kind="point")
    found = read_physics(stage, duck(points))
    assert found.bodies[0].subsets == ()
    assert found.notes == (
        "</Duck/dots> is not a subset of faces: its physics material is ignored",
    )
    with pytest.raises(InputError) as caught:
        read_physics(stage, duck(subset("beak", "5, 6", bound("/Hard"))))
    assert "</Duck/beak>: 1 of its 2 indices do not refer to any of the 6" in (caught.value.message)


def test_a_density_in_kg_per_cubic_meter_on_a_stage_in_centimeters_is_explained() -> None:
    """The message gave a density of 1e+09, which nobody had authored."""
    authored = {"physics:density": 1000.0}.get
    with pytest.raises(InputError) as caught:
        read_material_spec(authored, "/M", StageUnits(meters_per_unit=0.01), where="a.usda: </M>")
    assert caught.value.message == (
        "a.usda: </M>: physics:density [kg/m^3] is 1e+09: it is authored as 1000 mass units per"
        " cubic stage unit, of 1 kg and (0.01 m)^3"
    )
    assert caught.value.hint.endswith("; 1000 kg/m^3 is 0.001 in this stage")

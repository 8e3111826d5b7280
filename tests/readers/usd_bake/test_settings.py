"""Bake settings that a stage carries."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from physics_stages import head, mesh, prim

from gf_usd.core.errors import InputError
from gf_usd.core.stage import PrimBake
from gf_usd.readers import read_asset
from gf_usd.readers.usd_bake.settings import read_bake_settings

Write = Callable[..., Path]
API = "GaussianFleshBakeAPI"


@pytest.fixture
def read_settings(write: Write) -> Callable[..., tuple[PrimBake, ...]]:
    """The settings of some prims of a stage."""

    def read_settings(*prims: str, of: tuple[str, ...] = ("/Duck",), layer: str = head()):
        path = write(layer + "".join(prims))
        return read_bake_settings(path, read_asset(path).facts, of)

    return read_settings


def ours(**values: str) -> str:
    """Lines of attributes: name = "type value"."""
    pairs = {name: value.split(" ", 1) for name, value in values.items()}
    return "\n".join(
        f"uniform {kind} gaussianFlesh:{name} = {value}" for name, (kind, value) in pairs.items()
    )


def test_a_stage_that_says_nothing(read_settings) -> None:
    assert read_settings(mesh("Duck")) == (PrimBake(path="/Duck"),)
    # the fallbacks of the schema are nobody's word
    assert read_settings(mesh("Duck", apis=[API])) == (PrimBake(path="/Duck"),)


def test_all_settings_are_read(read_settings) -> None:
    lines = ours(
        enabled="bool false",
        material='token "jelly"',
        spacing="float 2.5",
        seed="int 7",
        solver='token "updatedLagrangian"',
    )
    (bake,) = read_settings(mesh("Duck", lines, apis=[API]), layer=head(0.01, "Z"))
    assert bake == PrimBake(
        path="/Duck", enabled=False, material="jelly", spacing=0.025, seed=7, solver="ul"
    )


def test_the_nearest_prim_above_counts_for_each_setting(read_settings) -> None:
    inner = prim("Xform", "Duck", ours(seed="int 2"), mesh("Body"), mesh("Eye", ours(seed="int 3")))
    stage = prim("Xform", "Pond", ours(seed="int 1", material='token "jelly"'), inner, apis=[API])
    body, eye = read_settings(stage, of=("/Pond/Duck/Body", "/Pond/Duck/Eye"))
    assert (body.seed, eye.seed) == (2, 3)
    assert (body.material, eye.material) == ("jelly", "jelly")


def test_an_empty_material_gives_the_word_back_to_the_binding(read_settings) -> None:
    inner = mesh("Duck", ours(material='token ""'))
    stage = prim("Xform", "Pond", ours(material='token "jelly"'), inner)
    assert read_settings(stage, of=("/Pond/Duck",))[0].material is None


def test_spacing_and_particles_exclude_each_other(read_settings) -> None:
    def resolution(above: str, own: str) -> tuple[float | None, int | None, str]:
        stage = prim("Xform", "Pond", above, mesh("Duck", own))
        (bake,) = read_settings(stage, of=("/Pond/Duck",))
        return bake.spacing, bake.particles, bake.particles_of

    few, fine = ours(particles="int 500"), ours(spacing="float 0.25")
    assert resolution(few, "") == (None, 500, "/Pond")
    assert resolution(fine, few) == (None, 500, "/Pond/Duck")
    assert resolution(few, fine) == (0.25, None, "")
    assert resolution("", few + "\n" + fine) == (0.25, None, "")
    # 0 cancels the value of a parent
    assert resolution(fine, ours(spacing="float 0")) == (None, None, "")
    assert resolution(few + "\n" + fine, ours(spacing="float 0")) == (None, 500, "/Pond")
    assert resolution(few, ours(particles="int 0")) == (None, None, "")


def test_settings_that_composition_brings(read_settings) -> None:
    sets = f"""
    variantSet "feel" = {{
        "soft" {{
            {ours(material='token "jelly"')}
        }}
        "hard" {{
            {ours(material='token "metal"')}
        }}
    }}
    """
    for feel, expected in (("soft", "jelly"), ("hard", "metal")):
        meta = f'variants = {{ string feel = "{feel}" }}\nprepend variantSets = "feel"'
        (bake,) = read_settings(mesh("Duck", sets, meta=meta))
        assert bake.material == expected
    style = f'class "Style" {{\n{ours(seed="int 5")}\n}}\n'
    assert read_settings(style, mesh("Duck", meta="inherits = </Style>"))[0].seed == 5


@pytest.mark.parametrize(
    ("apis", "lines", "role", "obstacle"),
    [
        ([], "", "", False),
        (["PhysicsCollisionAPI"], "", "static", True),
        (["PhysicsCollisionAPI"], "bool physics:collisionEnabled = false", "", False),
        (["PhysicsCollisionAPI"], ours(enabled="bool true"), "static", False),
        (["PhysicsCollisionAPI", "PhysicsRigidBodyAPI"], "", "dynamic", False),
        (["PhysicsRigidBodyAPI"], "bool physics:kinematicEnabled = true", "kinematic", True),
        (["PhysicsCollisionAPI", "PhysicsDeformableBodyAPI"], "", "dynamic", False),
    ],
)
def test_what_physics_holds_still_is_an_obstacle_unless_asked_for(
    read_settings, apis: list[str], lines: str, role: str, obstacle: bool
) -> None:
    (bake,) = read_settings(mesh("Duck", lines, apis=apis))
    assert (bake.role, bake.obstacle) == (role, obstacle)


@pytest.mark.parametrize(
    ("values", "message", "hint"),
    [
        ({"spacing": "float -1"}, "spacing is -1", "0 or more"),
        ({"spacing": "float nan"}, "spacing is nan", "0 or more"),
        ({"particles": "int -5"}, "particles is -5", "0 or more"),
        ({"seed": "int -1"}, "seed is -1", "0 or more"),
        ({"solver": 'token "tl"'}, "solver is 'tl'", "totalLagrangian, updatedLagrangian"),
        ({"material": 'token "jely"'}, "material is 'jely'", "did you mean jelly?"),
    ],
)
def test_values_that_make_no_sense_are_refused(
    read_settings, values: dict[str, str], message: str, hint: str
) -> None:
    stage = prim("Xform", "Pond", ours(**values), mesh("Duck"))
    with pytest.raises(InputError) as caught:
        read_settings(stage, of=("/Pond/Duck",))
    assert f"</Pond>: gaussianFlesh:{message}" in caught.value.message
    assert hint in caught.value.hint


def test_a_prim_that_is_none_is_refused(read_settings) -> None:
    with pytest.raises(InputError, match="there is no prim /Goose"):
        read_settings(mesh("Duck"), of=("/Goose",))

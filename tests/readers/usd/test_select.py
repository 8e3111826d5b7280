"""Which prims are read, which are left alone and why, and the errors of empty stages."""

import pytest

from gf_usd.core.errors import InputError
from gf_usd.readers import read_asset

TWO_ROOTS = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    %s
)
def Xform "A"
{
    def Cube "Box" {}
    def Sphere "Ball" {}
}
def Xform "B"
{
    def Cube "Box" {}
}
"""


def paths(asset):
    return [surface.path for surface in asset.surfaces]


def test_every_root_prim_without_a_default_prim(read):
    assert paths(read(TWO_ROOTS % "")) == ["/A/Box", "/A/Ball", "/B/Box"]


def test_the_default_prim(read):
    assert paths(read(TWO_ROOTS % 'defaultPrim = "B"')) == ["/B/Box"]


def test_a_default_prim_that_is_missing_is_said(read):
    asset = read(TWO_ROOTS % 'defaultPrim = "C"')
    assert len(asset.surfaces) == 3
    assert "defaultPrim names 'C'" in asset.facts.notes[0]


def test_prims_by_name_each_once(read):
    asset = read(TWO_ROOTS % 'defaultPrim = "B"', prims=["/A/Ball", "/A", "/A/Box"])
    assert paths(asset) == ["/A/Ball", "/A/Box"]


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("/A/Bax", "did you mean /A/Box"),
        ("Ball", "did you mean /A/Ball"),
        ("/B/Ball", "did you mean /A/Ball"),
        ("/A/Wxyz/Qrst", "/A exists and contains /A/Box, /A/Ball"),
        ("not a path!", "/ exists and contains /A, /B"),
    ],
)
def test_a_missing_prim_gets_the_nearest_names(read, name, hint):
    with pytest.raises(InputError) as error:
        read(TWO_ROOTS % "", prims=[name])
    assert error.value.message.endswith(f"there is no prim {name}")
    assert hint in error.value.hint


def test_what_is_left_alone_has_a_reason(read):
    asset = read("""
    def Xform "R"
    {
        def Cube "Seen" {}
        def Cube "Drawn"
        {
            uniform token purpose = "render"
        }
        def Cube "Proxy"
        {
            uniform token purpose = "proxy"
        }
        def Xform "Guides"
        {
            uniform token purpose = "guide"
            def Cube "G" {}
        }
        def Xform "Off"
        {
            token visibility = "invisible"
            def Cube "A" {}
            def Cube "B" {}
        }
        def Cube "Inactive" (active = false) {}
        def BasisCurves "Hair" {}
        def Points "Dust" {}
        def Plane "Floor" {}
        def PointInstancer "Grass"
        {
            def Cube "Blade" {}
        }
        def Mesh "Empty" {}
        def Sphere "Dot"
        {
            double radius = 0
        }
        def Cube "Flat"
        {
            double3 xformOp:scale = (1, 0, 1)
            uniform token[] xformOpOrder = ["xformOp:scale"]
        }
    }
    """)
    assert paths(asset) == ["/R/Seen", "/R/Drawn"]
    assert dict(asset.skipped) == {
        "/R/Proxy": "purpose proxy",
        "/R/Guides/G": "purpose guide",
        "/R/Off": "invisible",
        "/R/Hair": "BasisCurves: only meshes, solid shapes, points and splats are made soft",
        "/R/Dust": "Points without widths and without physics are not a body",
        "/R/Floor": "Plane: only meshes, solid shapes, points and splats are made soft",
        "/R/Grass": "PointInstancer: its instances are not made soft",
        "/R/Empty": "has 0 points and 0 faces",
        "/R/Dot": "its radius is 0",
        "/R/Flat": "its transform flattens it (determinant 0)",
    }


def test_visibility_is_that_of_the_pose_time(read):
    body = """
    def Cube "Late"
    {
        token visibility.timeSamples = { 1: "invisible", 10: "inherited" }
    }
    def Cube "Always" {}
    """
    early = read(body, time_code=1)
    assert paths(early) == ["/Always"]
    assert dict(early.skipped) == {"/Late": "invisible at 1, visible from 10"}
    assert paths(read(body, time_code=10)) == ["/Late", "/Always"]


def test_instances_are_read_in_place(read):
    asset = read("""
    class Xform "Proto"
    {
        def Cube "Box" {}
    }
    def Xform "One" (
        instanceable = true
        inherits = </Proto>
    )
    {
        double3 xformOp:translate = (5, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "Two" (
        instanceable = true
        inherits = </Proto>
    )
    {
    }
    """)
    assert paths(asset) == ["/One/Box", "/Two/Box"]
    assert asset.surfaces[0].points[:, 0].mean() == pytest.approx(5.0)
    assert asset.facts.notes == (
        "each of </One> and </Two> is an instance: it becomes an ordinary prim in the bake "
        "because its content moves",
    )


def test_notes_on_motion_and_instances_are_not_on_obstacles(read):
    """They follow their animation and stay instances; what is made soft by name is no obstacle."""
    stage = """
    class Xform "Proto" {
        def Mesh "Box" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {
            int[] faceVertexCounts = [3, 3, 3, 3]
            int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]
            point3f[] points.timeSamples = {
                1: [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
                5: [(0, 0, 0), (2, 0, 0), (0, 1, 0), (0, 0, 1)],
            }
        }
    }
    def Xform "One" (instanceable = true
        inherits = </Proto>) {}
    def Sphere "Ball" {}
    """
    instance = "</One> is an instance: it becomes an ordinary prim in the bake because its"
    animated = "is animated: the simulation starts from its pose at the first frame"
    assert read(stage).facts.notes == ()
    assert read(stage, prims=["/Ball"]).facts.notes == ()
    soft = read(stage, prims=["/One/Box"]).facts.notes
    enabled = "inherits = </Proto>) {\n bool gaussianFlesh:enabled = 1\n }"
    for notes in (soft, read(stage.replace("inherits = </Proto>) {}", enabled)).facts.notes):
        assert any(note.startswith(instance) for note in notes)
        assert any(note.endswith(animated) for note in notes)


def test_what_an_instancer_repeats_is_left_alone_wherever_it_stands(read):
    asset = read("""
    def Xform "Grass"
    {
        def PointInstancer "Many"
        {
            rel prototypes = [</Grass/Many/Blade>, </Library/Stone>, </Library/Nothing>]
            def Cube "Blade" {}
        }
    }
    def Scope "Library"
    {
        def Xform "Stone"
        {
            def Cube "Box" {}
        }
        def Cube "Other" {}
    }
    """)
    assert paths(asset) == ["/Library/Other"]
    assert dict(asset.skipped) == {
        "/Grass/Many": "PointInstancer: its instances are not made soft",
        "/Library/Stone": "prototype of </Grass/Many>: its instances are not made soft",
    }


def test_what_inherits_from_a_baked_prim_follows_it(read):
    asset = read("""
    class Xform "Proto"
    {
        def Cube "Box" {}
    }
    def Xform "One" (inherits = </Proto>)
    {
    }
    def Xform "Two" (inherits = </One>)
    {
    }
    """)
    assert paths(asset) == ["/One/Box"]
    assert dict(asset.skipped) == {
        "/Two/Box": "inherits from </One/Box>, which is baked, and follows it"
    }


@pytest.mark.parametrize(
    ("body", "message", "hint"),
    [
        (
            'def Xform "A" {\ndef Camera "C" {}\n}',
            "no mesh was found under </A>, which contains 1 Xform, 1 Camera",
            "give an asset that contains a mesh",
        ),
        (
            'def Xform "A" (prepend variantSets = "shape") {\nvariantSet "shape" = {\n'
            '"round" {\ndef Sphere "S" {}\n}\n"square" {\n}\n}\n}',
            "no mesh was found under </A>, which contains 1 Xform",
            "</A> has a variant set 'shape' without a selection: select one of round, square",
        ),
        (
            "",
            "no mesh was found under its root, which contains nothing",
            "give an asset that contains a mesh",
        ),
        (
            '#usda 1.0\n(defaultPrim = "A")\ndef Xform "A" {}\ndef Xform "B" {\ndef Mesh "M" {}\n}',
            "no mesh was found under </A>, which contains 1 Xform",
            "there are meshes outside the default prim: --prim /B/M",
        ),
        (
            'def Points "A" {}\ndef Mesh "M" {}',
            "nothing under </A>, </M> can be made soft: "
            "</A> (Points without widths and without physics are not a body) and 1 more",
            "name other prims with --prim",
        ),
        (
            'def Xform "A" {\ndef Material "L" (active = false) {}\n'
            'def Camera "C" (active = false) {}\n'
            'def Mesh "M" (active = false) {}\n}',
            "no mesh was found under </A>, which contains 1 Xform",
            "</A/M> is inactive: activate it in the file if it is meant",
        ),
        (
            'def Xform "A" (references = @gone.usda@) {}',
            "no mesh was found under </A>; does not compose: Could not open asset",
            "supply the missing files",
        ),
    ],
)
def test_nothing_to_make_soft_says_what_was_found(read, body, message, hint, capfd):
    with pytest.raises(InputError) as error:
        read(body)
    assert message in error.value.message
    assert hint in error.value.hint
    assert capfd.readouterr().err == ""


def test_a_missing_reference_next_to_a_mesh_is_a_note(write, capfd):
    asset = read_asset(write('def Cube "A" {}\ndef Xform "B" (payload = @gone.usda@) {}'))
    assert len(asset.surfaces) == 1
    assert "does not compose" in asset.facts.notes[0]
    assert "gone.usda" in asset.facts.notes[0]
    assert capfd.readouterr().err == ""


HIDDEN = 'def Cube "A" {\n token visibility = "invisible"\n }'
LATE = """def Cube "A"
{
    token visibility.timeSamples = { 1: "invisible", 10: "inherited" }
}"""
GUIDE = 'def Cube "A" {\n uniform token purpose = "guide"\n }'
REPEATS = """def PointInstancer "A"
{
    rel prototypes = </A/B>
    def Xform "B" %s
    {
        def Cube "C" {}
    }
}"""


@pytest.mark.parametrize("prims", [(), ("/A",)])
@pytest.mark.parametrize(
    ("body", "hint"),
    [
        (HIDDEN, "make </A> visible in the file"),
        (LATE, "start the bake where </A> is visible: --start 10"),
        (GUIDE, "set the purpose of </A> to default or render"),
        (REPEATS % "", "bake a file with the prototype alone;"),
        (REPEATS % "(references = @ball.usda@</Ball>)", "the prototype's own file, ball.usda;"),
    ],
)
def test_the_hint_says_what_makes_it_soft(read, tmp_path, body, hint, prims):
    (tmp_path / "ball.usda").write_text('#usda 1.0\ndef Sphere "Ball" {}')
    with pytest.raises(InputError) as error:
        read(body, prims=prims)
    assert hint in error.value.hint
    assert "--prim" not in error.value.hint


LOOKS = """def Xform "Ball"
{
    def Material "Red"
    {
        def Shader "Shade" {}
    }
    def Sphere "Skin" {}
    def Cube "Shad"
    {
        token visibility = "invisible"
    }
}"""


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("/Ball/Skim", "did you mean /Ball/Skin or /Ball?"),
        ("/Ball/Red/Shape", "/Ball exists and contains /Ball/Skin"),
        ("/Ball/Red/Shades", "/Ball exists and contains /Ball/Skin"),
        ("/Shad", "/ exists and contains /Ball"),
        ("/Ball/Wxyzwxyzwxyz", "/Ball exists and contains /Ball/Skin"),
    ],
)
def test_only_what_can_be_baked_is_suggested(read, name, hint):
    with pytest.raises(InputError) as error:
        read(LOOKS, prims=[name])
    assert error.value.hint == hint


def test_an_inactive_prim_by_name(read):
    with pytest.raises(InputError, match="the prim /A is inactive"):
        read('def Cube "A" (active = false) {}\ndef Cube "B" {}', prims=["/A"])


ROOM = """
def Xform "World"
{
    def Sphere "Duck" {}
    def Cube "Table" {}
    def Cube "Wall" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {}
    def Xform "Chair" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
    {
        def Cube "Seen" {}
        def Cube "Met" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {}
    }
    def Cube "Hidden"
    {
        token visibility = "invisible"
    }
    def Cube "Guide"
    {
        uniform token purpose = "guide"
    }
    def BasisCurves "Hair" {}
}
def Cube "A" {}
def Cube "B" {}
def Cube "C" {}
"""


@pytest.mark.parametrize(
    ("prims", "note"),
    [
        (["/"], ""),
        (
            ["/World"],
            "3 shapes of the stage, </A>, </B>, </C>, are neither soft nor obstacles: bodies pass"
            " through them; a PhysicsCollisionAPI makes a shape an obstacle, and --prim makes it"
            " soft",
        ),
        (
            ["/World/Duck"],
            "4 shapes of the stage, </World/Table>, </A>, </B> and 1 more, are neither soft",
        ),
        (["/World/Duck", "/A", "/B", "/C"], "1 shape of the stage, </World/Table>, is neither"),
    ],
)
def test_what_bodies_pass_through_is_said(read, prims, note):
    notes = [text for text in read(ROOM, prims=prims).facts.notes if "pass through" in text]
    assert len(notes) == bool(note)
    assert "".join(notes).startswith(note)

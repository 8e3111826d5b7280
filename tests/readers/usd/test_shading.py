"""Shading: constants, subsets, bindings, and shaders that are not read."""

import numpy as np
import pytest
from usd_looks import CONSTANT, QUADS, SURFACE, only, stage, textured


def test_constant(read):
    surface, material = only(read(stage(CONSTANT)))
    assert material.path == "/Looks/M"
    assert material.color == (0.5, 0.25, 0.125)
    assert material.texture is None
    np.testing.assert_array_equal(surface.triangle_materials, [0, 0, 0, 0])
    assert surface.triangle_uvs is None


def test_a_surface_that_says_no_color_has_the_fallback(read):
    assert only(read(stage(SURFACE % "")))[1].color == (0.18, 0.18, 0.18)


def test_connections_through_interface_inputs_and_node_graphs(read, picture):
    material = """
    string inputs:uvset = "map1"
    color3f inputs:tint = (0.1, 0.2, 0.3)
    token outputs:surface.connect = </Looks/M/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </Looks/M/Graph.outputs:color>
        token outputs:surface
    }
    def NodeGraph "Graph"
    {
        asset inputs:picture = @t.png@
        string inputs:name.connect = </Looks/M.inputs:uvset>
        color3f outputs:color.connect = </Looks/M/Graph/Tex.outputs:rgb>
        def Shader "Tex"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file.connect = </Looks/M/Graph.inputs:picture>
            float2 inputs:st.connect = </Looks/M/Graph/Reader.outputs:result>
            float3 outputs:rgb
        }
        def Shader "Reader"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname.connect = </Looks/M/Graph.inputs:name>
            float2 outputs:result
        }
    }
    """
    surface, look = only(read(stage(material, quads=QUADS.replace("primvars:st", "primvars:map1"))))
    np.testing.assert_array_equal(look.texture.pixels, picture)
    assert surface.triangle_uvs.max() == 1.0
    constant = material.replace("</Looks/M/Graph.outputs:color>", "</Looks/M.inputs:tint>")
    assert only(read(stage(constant)))[1].color == pytest.approx((0.1, 0.2, 0.3))


SUBSETS = """
    rel material:binding = </Looks/M>
    def GeomSubset "Right" ( prepend apiSchemas = ["MaterialBindingAPI"] )
    {
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [%s]
        rel material:binding = </Looks/N>
    }
"""
GREEN = """def Scope "Looks"
{
    def Material "M"
    {
        %s
    }
    def Material "N"
    {
        %s
    }
}
"""


def with_subset(indices, first=CONSTANT, second=CONSTANT):
    other = second.replace("/Looks/M", "/Looks/N").replace("0.25", "0.75")
    mesh = stage("", mesh=SUBSETS % indices).split('def Scope "Looks"')[0]
    return mesh + GREEN % (first, other)


def test_subsets_have_their_own_material(read):
    (surface,) = read(with_subset("1")).surfaces
    assert [m.color[1] for m in surface.materials] == [0.25, 0.75]
    np.testing.assert_array_equal(surface.triangle_materials, [0, 0, 1, 1])


def test_subset_indices_outside_the_mesh_are_said(read):
    asset = read(with_subset("1, 2, -1"))
    np.testing.assert_array_equal(asset.surfaces[0].triangle_materials, [0, 0, 1, 1])
    assert asset.facts.notes == (
        "</Q/Right>: 2 of its 3 indices do not refer to any of the 2 faces: ignored",
    )


def test_each_texture_reads_its_own_coordinates(read, picture):
    moved = textured("float2 inputs:st = (0.125, 0.125)")
    (surface,) = read(with_subset("1", textured(), moved)).surfaces
    assert len(surface.materials) == 2
    assert surface.triangle_uvs[:2].max() == 1.0
    np.testing.assert_array_equal(surface.triangle_uvs[2:], np.full((2, 3, 2), 0.125))


def test_bindings_are_inherited_and_come_from_collections(read):
    inherited = (
        stage(CONSTANT, mesh="")
        .replace(
            'def Mesh "Q"',
            """def Xform "P" ( prepend apiSchemas = ["MaterialBindingAPI"] )
        {
            rel material:binding = </Looks/M>
            def Mesh "Q"
        """,
        )
        .replace('def Scope "Looks"', '}\ndef Scope "Looks"')
    )
    assert only(read(inherited))[1].color == (0.5, 0.25, 0.125)
    collection = inherited.replace(
        '["MaterialBindingAPI"] )\n        {\n            rel material:binding = </Looks/M>',
        '["MaterialBindingAPI", "CollectionAPI:all"] )\n        {\n'
        "            rel collection:all:includes = </P/Q>\n"
        "            rel material:binding:collection:mine = [</P.collection:all>, </Looks/M>]",
    )
    assert collection != inherited
    assert only(read(collection))[1].color == (0.5, 0.25, 0.125)


def test_a_binding_without_the_applied_schema_is_read(read, capfd):
    body = stage(CONSTANT).replace('( prepend apiSchemas = ["MaterialBindingAPI"] )', "")
    assert only(read(body))[1].color == (0.5, 0.25, 0.125)
    assert capfd.readouterr().err == ""


MDL = """
    token outputs:mdl:surface.connect = </Looks/M/S.outputs:out>
    def Shader "S"
    {
        uniform token info:implementationSource = "sourceAsset"
        uniform asset info:mdl:sourceAsset = @OmniPBR.mdl@
        token outputs:out
    }
"""
MTLX = """
    token outputs:mtlx:surface.connect = </Looks/M/S.outputs:out>
    def Shader "S"
    {
        uniform token info:id = "ND_standard_surface_surfaceshader"
        token outputs:out
    }
"""


@pytest.mark.parametrize(
    ("material", "kind"),
    [
        (MDL, "a mdl shader"),
        (MTLX, "a mtlx shader"),
        (MTLX.replace("mtlx:", ""), "shader ND_standard_surface_surfaceshader"),
        ("", "a material without a surface shader"),
    ],
)
def test_other_shading_languages_are_gray_in_words(read, material, kind):
    asset = read(stage(material))
    _, look = only(asset)
    assert look.color == (0.18, 0.18, 0.18)
    assert asset.facts.notes == (
        f"</Looks/M>: {kind} is not supported: displayColor or gray is used",
    )
    shown = "rel material:binding = </Looks/M>\ncolor3f[] primvars:displayColor = [(1, 0, 0)]"
    (surface,) = read(stage(material, mesh=shown)).surfaces
    assert surface.triangle_materials is None
    np.testing.assert_array_equal(surface.triangle_colors[0, 0], [1, 0, 0])


def test_diffuse_color_from_a_primvar(read):
    material = (
        SURFACE % "color3f inputs:diffuseColor.connect = </Looks/M/C.outputs:result>"
        + """
    def Shader "C"
    {
        uniform token info:id = "UsdPrimvarReader_float3"
        string inputs:varname = "paint"
        float3 inputs:fallback = (0.5, 0.5, 0)
        float3 outputs:result
    }
    """
    )
    bound = "rel material:binding = </Looks/M>"
    paint = 'color3f[] primvars:paint = [(1, 0, 0), (0, 0, 1)] ( interpolation = "uniform" )'
    (surface,) = read(stage(material, mesh=f"{bound}\n{paint}")).surfaces
    assert surface.triangle_materials is None
    np.testing.assert_array_equal(surface.triangle_colors[:, 0, 2], [0, 0, 1, 1])
    assert only(read(stage(material, mesh=bound)))[1].color == (0.5, 0.5, 0.0)


def test_a_node_that_is_not_read_is_said(read):
    material = (
        SURFACE % "color3f inputs:diffuseColor.connect = </Looks/M/C.outputs:out>"
        + """
    def Shader "C"
    {
        uniform token info:id = "Checker"
        color3f outputs:out
    }
    """
    )
    asset = read(stage(material))
    assert only(asset)[1].color == (0.18, 0.18, 0.18)
    assert "diffuseColor comes from Checker" in asset.facts.notes[0]


def test_the_same_note_at_many_places_is_one(read):
    body = "\n".join(
        stage(MDL).replace("Looks", f"L{i}").replace('"Q"', f'"Q{i}"') for i in range(4)
    )
    assert read(body).facts.notes == (
        "each of </L0/M> and 3 more: a mdl shader is not supported: displayColor or gray is used",
    )

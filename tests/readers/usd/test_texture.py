"""Textures: pictures, their colors and coordinates, and what stands in for unreadable ones."""

from zipfile import ZipFile

import numpy as np
import pytest
from PIL import Image
from pxr import Sdf, UsdUtils
from usd_looks import QUADS, ST, only, stage, textured

from gf_usd.readers import read_asset


def test_texture(read, picture):
    asset = read(stage(textured()))
    surface, material = only(asset)
    np.testing.assert_array_equal(material.texture.pixels, picture)
    assert material.texture.srgb
    assert (material.texture.wrap_s, material.texture.wrap_t) == ("repeat", "repeat")
    np.testing.assert_array_equal(
        surface.triangle_uvs, surface.points[surface.triangles][:, :, :2] * [0.5, 1]
    )
    assert asset.facts.notes == ()


def test_texture_in_a_usdz(write, picture, tmp_path):
    source = write(stage(textured()))
    package = tmp_path / "box" / "asset.usdz"
    package.parent.mkdir()
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(source)), str(package))
    assert "t.png" in " ".join(ZipFile(package).namelist())
    (tmp_path / "t.png").unlink()
    _, material = only(read_asset(package))
    np.testing.assert_array_equal(material.texture.pixels, picture)


@pytest.mark.parametrize(
    ("space", "mode", "srgb"),
    [
        ("", "RGB", True),
        ('token inputs:sourceColorSpace = "auto"', "RGBA", True),
        ('token inputs:sourceColorSpace = "auto"', "L", False),
        ('token inputs:sourceColorSpace = "raw"', "RGB", False),
        ('token inputs:sourceColorSpace = "sRGB"', "L", True),
    ],
)
def test_color_space(read, tmp_path, space, mode, srgb):
    Image.new(mode, (2, 2)).save(tmp_path / "t.png")
    assert only(read(stage(textured(ST + "\n" + space))))[1].texture.srgb is srgb


def test_wrap(read, picture):
    extra = 'token inputs:wrapS = "clamp"\ntoken inputs:wrapT = "useMetadata"'
    texture = only(read(stage(textured(extra))))[1].texture
    assert (texture.wrap_s, texture.wrap_t) == ("clamp", "repeat")


def test_sixteen_bits_keep_their_level(read, tmp_path):
    Image.fromarray(np.full((2, 2), 257 * 100, dtype=np.uint16)).save(tmp_path / "t.png")
    texture = only(read(stage(textured())))[1].texture
    np.testing.assert_array_equal(texture.pixels, np.full((2, 2, 3), 100))
    assert not texture.srgb


def test_single_channel(read, picture):
    texture = only(read(stage(textured(output="r"))))[1].texture
    np.testing.assert_array_equal(texture.pixels, np.repeat(picture[:, :, :1], 3, axis=2))


def test_scale_and_bias_act_on_linear_colors(read, tmp_path):
    Image.new("RGB", (1, 1), (188, 0, 255)).save(tmp_path / "t.png")
    extra = "float4 inputs:scale = (0.5, 1, 2, 1)\nfloat4 inputs:bias = (0, 0.25, 0, 0)"
    pixel = only(read(stage(textured(extra))))[1].texture.pixels[0, 0]
    # sRGB 188 is 0.5029 linear: half of it is sRGB 137.4; 0.25 linear is sRGB 136.96; 2 clips.
    np.testing.assert_array_equal(pixel, [137, 137, 255])


def test_transform_2d_scales_then_rotates_then_translates(read, picture):
    material = (
        textured(ST.replace("Reader.outputs", "Move.outputs"))
        + """
    def Shader "Move"
    {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </Looks/M/Turn.outputs:result>
        float2 inputs:translation = (0.25, 0)
        float2 outputs:result
    }
    def Shader "Turn"
    {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </Looks/M/Reader.outputs:result>
        float inputs:rotation = 90
        float2 inputs:scale = (2, 3)
        float2 outputs:result
    }
    """
    )
    surface, _ = only(read(stage(material)))
    s, t = np.moveaxis(surface.points[surface.triangles][:, :, :2] * [0.5, 1], -1, 0)
    expected = np.stack([-3 * t + 0.25, 2 * s], axis=-1)
    np.testing.assert_allclose(surface.triangle_uvs, expected, atol=1e-12)


def test_unconnected_coordinates_read_one_place(read, picture):
    surface, look = only(read(stage(textured("float2 inputs:st = (0.25, 0.75)"))))
    assert look.texture is not None
    np.testing.assert_array_equal(surface.triangle_uvs, np.full((4, 3, 2), [0.25, 0.75]))


def test_a_missing_uv_primvar_is_said(read, picture):
    asset = read(stage(textured(), quads=QUADS.replace("primvars:st", "primvars:uv")))
    assert asset.facts.notes == (
        "</Q> has no usable primvar st, which the texture of </Looks/M> reads: "
        "a single point of the texture is used",
    )
    assert not np.any(asset.surfaces[0].triangle_uvs)


@pytest.mark.parametrize(
    ("content", "file", "message"),
    [
        (None, "t.png", "texture t.png does not exist: a constant color is used"),
        (
            b"no picture",
            "t.png",
            "texture t.png cannot be read: not an image format that Pillow supports",
        ),
        (b"", "t.png", "texture t.png cannot be read: it is empty"),
        (b"x", "t.<UDIM>.png", "texture t.<UDIM>.png: UDIM tiles are not supported"),
    ],
)
def test_an_unreadable_texture_gives_its_fallback_in_words(read, tmp_path, content, file, message):
    if content is not None:
        (tmp_path / file).write_bytes(content)
    material = textured(ST + "\nfloat4 inputs:fallback = (1, 0.5, 0, 1)", file=file)
    asset = read(stage(material))
    _, look = only(asset)
    assert look.texture is None
    assert look.color == (1.0, 0.5, 0.0)
    assert asset.facts.notes[0].startswith(f"</Looks/M>: {message}")


def test_a_truncated_texture_is_said(read, tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "t.png")
    whole = (tmp_path / "t.png").read_bytes()
    (tmp_path / "t.png").write_bytes(whole[:500])
    asset = read(stage(textured()))
    assert only(asset)[1].texture is None
    assert "texture t.png cannot be read" in asset.facts.notes[0]


def test_two_materials_share_one_picture(read, picture):
    body = stage(textured()) + stage(textured()).replace('"Q"', '"R"').replace("Looks", "Other")
    first, second = read(body).surfaces
    assert first.materials[0].path != second.materials[0].path
    assert first.materials[0].texture is second.materials[0].texture

"""glTF files: nodes, joined primitives, textures and colors; and the broken ones."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from mesh_makers import CORNERS, TRIANGLES, GltfMaker, png, written
from PIL import Image
from pxr import Sdf

from gf_usd.core.errors import InputError
from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.mesh.topology import boundary_edges, weld
from gf_usd.readers import convert, read_asset
from gf_usd.readers.mesh.gltf.container import open_gltf
from gf_usd.readers.mesh.gltf.primitives import decoded
from gf_usd.readers.mesh.gltf.scene import read_gltf

EXACT = 1e-6  # float32 after a transform of size a few


def textured_box() -> trimesh.Trimesh:
    """A box with texture coordinates and a picture of 8 x 4."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    pixels = np.zeros((4, 8, 3), np.uint8)
    pixels[:2] = (250, 0, 0)  # the upper half is red, the lower blue
    pixels[2:] = (0, 0, 250)
    material = trimesh.visual.material.PBRMaterial(
        name="skin", baseColorTexture=Image.fromarray(pixels), metallicFactor=0.0,
        roughnessFactor=0.25,
    )  # fmt: skip
    uv = box.vertices[:, :2] * [1.0, 0.5] + 0.5
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return box


def test_what_trimesh_writes_with_a_picture_and_a_node(tmp_path):
    box = textured_box()
    scene = trimesh.Scene()
    matrix = trimesh.transformations.rotation_matrix(np.pi / 2, (0, 0, 1), (1.0, 0, 0))
    scene.add_geometry(box, node_name="turned box", geom_name="box", transform=matrix)
    path = tmp_path / "thing.glb"
    path.write_bytes(scene.export(file_type="glb"))
    asset = written(path, tmp_path / "out")
    (read,) = asset.surfaces
    assert asset.facts.units.length == 1.0
    assert asset.facts.up_axis == "Y"
    assert not any("assumed" in note for note in convert(path).notes)
    facts = convert(path).asset().facts
    assert (facts.unit_from, facts.axis_from) == ("file", "file")
    assert read.path.endswith("/turned_box")
    np.testing.assert_allclose(
        read.points, trimesh.transform_points(box.vertices, matrix), atol=EXACT
    )
    assert read.face_indices.reshape(-1, 3).tolist() == box.faces.tolist()
    np.testing.assert_allclose(read.triangle_uvs, box.visual.uv[box.faces], atol=EXACT)
    (material,) = read.materials
    assert material.texture.pixels.shape == (4, 8, 3)
    assert material.texture.pixels[0, 0].tolist() == [250, 0, 0]
    (picture,) = (tmp_path / "out" / "thing.textures").iterdir()
    with Image.open(picture) as opened:
        assert opened.size == (8, 4)


def test_text_files_name_their_pictures_where_they_are(tmp_path):
    maker = GltfMaker()
    uvs = CORNERS[:, :2].astype(np.float32)
    maker.mesh(maker.primitive(CORNERS, TRIANGLES, TEXCOORD_0=uvs) | {"material": 0})
    maker.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    maker.tree["textures"] = [{"source": 0, "sampler": 0}]
    maker.tree["samplers"] = [{"wrapS": 33071, "wrapT": 33648}]
    maker.tree["images"] = [{"uri": "my%20skin.png"}]
    (tmp_path / "my skin.png").write_bytes(png())
    asset = written(maker.gltf(tmp_path / "thing.gltf"), tmp_path / "out")
    (cube,) = asset.surfaces
    texture = cube.materials[0].texture
    assert (texture.wrap_s, texture.wrap_t) == ("clamp", "mirror")
    # v is counted from the top in glTF, from the bottom in USD
    np.testing.assert_allclose(cube.triangle_uvs[..., 1], 1.0 - CORNERS[TRIANGLES][..., 1])
    assert not (tmp_path / "out" / "thing.textures").exists()
    layer = Sdf.Layer.FindOrOpen(str(tmp_path / "out" / "thing.source.usdc"))
    file = "/thing/Materials/material/diffuseColor_texture.inputs:file"
    assert layer.GetAttributeAtPath(file).default.path == "../my skin.png"
    (tmp_path / "my skin.png").unlink()
    source = convert(tmp_path / "thing.gltf")
    assert any("my%20skin.png, which cannot be read" in note for note in source.notes)
    assert source.asset().surfaces[0].materials[0].texture is None


def test_primitives_of_one_mesh_stay_one_body(tmp_path):
    maker = GltfMaker()
    lower = maker.primitive(CORNERS, TRIANGLES[:6]) | {"material": 0}
    upper = maker.primitive(CORNERS, TRIANGLES[6:]) | {"material": 1}
    maker.mesh(lower, upper, name="box")
    maker.tree["materials"] = [
        {"name": n, "pbrMetallicRoughness": {"baseColorFactor": [*rgb, 1.0]}}
        for n, rgb in (("box", (1.0, 0.0, 0.0)), ("box", (0.0, 0.5, 0.0)))
    ]
    (cube,) = written(maker.glb(tmp_path / "thing.glb"), tmp_path / "out").surfaces
    welded = weld(cube.points)[0][cube.triangles]
    assert len(boundary_edges(welded)) == 0
    assert cube.triangle_materials.tolist() == [0] * 6 + [1] * 6
    assert [m.color for m in cube.materials] == [(1.0, 0.0, 0.0), (0.0, 0.5, 0.0)]
    assert [m.path for m in cube.materials] == ["/thing/Materials/box", "/thing/Materials/box_2"]


def test_nodes_within_nodes_and_a_mesh_used_twice(tmp_path):
    maker = GltfMaker()
    inner = maker.mesh(maker.primitive(CORNERS, TRIANGLES), name="arm", translation=[0, 0, 5])
    half = np.sqrt(0.5)
    maker.tree["nodes"] += [
        {"name": "body", "mesh": 0, "children": [inner], "scale": [2, 2, 2],
         "rotation": [0, half, 0, half]},
        {"name": "camera", "translation": [9, 9, 9]},
    ]  # fmt: skip
    maker.tree["scenes"] = [{"nodes": [1, 2]}]
    asset = written(maker.glb(tmp_path / "thing.glb"), tmp_path / "out")
    assert [s.path for s in asset.surfaces] == ["/thing/body/body", "/thing/body/arm"]
    body, arm = (s.points for s in asset.surfaces)
    # a quarter turn about y takes z to x and x to -z
    turned = CORNERS[:, [2, 1, 0]] * [2.0, 2.0, -2.0]
    np.testing.assert_allclose(body, turned, atol=EXACT)
    np.testing.assert_allclose(arm, turned + [10.0, 0.0, 0.0], atol=EXACT)


def test_colors_of_points_times_the_base_color(tmp_path):
    maker = GltfMaker()
    colors = np.zeros((8, 4), np.uint8)
    colors[:, 0], colors[:, 3] = 51, 255
    primitive = maker.primitive(CORNERS, TRIANGLES)
    primitive["attributes"]["COLOR_0"] = maker.accessor(colors, normalized=True)
    maker.mesh(primitive | {"material": 0})
    maker.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 1, 1]}}]
    (cube,) = written(maker.glb(tmp_path / "thing.glb"), tmp_path / "out").surfaces
    np.testing.assert_allclose(
        cube.triangle_colors.reshape(-1, 3), [[0.1, 0.0, 0.0]] * 36, atol=EXACT
    )
    assert cube.triangle_materials is None  # the colors are the mesh's own


def test_a_texture_transform_moves_the_coordinates(tmp_path):
    maker = GltfMaker()
    uvs = CORNERS[:, :2].astype(np.float32)
    maker.mesh(maker.primitive(CORNERS, TRIANGLES, TEXCOORD_1=uvs) | {"material": 0})
    placed = {"offset": [0.25, 0.5], "scale": [2.0, 3.0], "rotation": np.pi / 2, "texCoord": 1}
    info = {"index": 0, "extensions": {"KHR_texture_transform": placed}}
    maker.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": info}}]
    maker.tree["textures"] = [{"source": 0}]
    maker.tree["images"] = [{"bufferView": maker.view(png()), "mimeType": "image/png"}]
    (cube,) = written(maker.glb(tmp_path / "thing.glb"), tmp_path / "out").surfaces
    u, v = np.moveaxis(CORNERS[TRIANGLES][..., :2], -1, 0)
    # a quarter turn counter-clockwise with v downward: (u, v) -> (v, -u)
    expected = np.stack([3.0 * v + 0.25, 1.0 - (-2.0 * u + 0.5)], axis=-1)
    np.testing.assert_allclose(cube.triangle_uvs, expected, atol=EXACT)


def test_a_skinned_mesh_stands_as_its_joints_do(tmp_path):
    maker = GltfMaker()
    joints = np.zeros((8, 4), np.uint8)
    joints[:, 0] = (CORNERS[:, 1] > 0.5).astype(np.uint8)
    weights = np.zeros((8, 4), np.float32)
    weights[:, 0] = 1.0
    primitive = maker.primitive(CORNERS, TRIANGLES, JOINTS_0=joints, WEIGHTS_0=weights)
    # the node that holds the mesh does not move it, as the standard says
    maker.mesh(primitive, skin=0, name="doll", translation=[100, 0, 0])
    bind = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    bind[1, 3, 1] = -1.0  # joint 1 was bound at height 1
    maker.tree["skins"] = [{"joints": [1, 2], "inverseBindMatrices": maker.accessor(bind)}]
    maker.tree["nodes"] += [{"children": [2], "translation": [3, 0, 0]}, {"translation": [0, 4, 0]}]
    maker.tree["scenes"] = [{"nodes": [0, 1]}]
    path = maker.glb(tmp_path / "thing.glb")
    (doll,) = written(path, tmp_path / "out").surfaces
    expected = CORNERS + [3.0, 0.0, 0.0] + np.outer(CORNERS[:, 1] > 0.5, [0.0, 3.0, 0.0])
    np.testing.assert_allclose(doll.points, expected, atol=EXACT)
    assert signed_volume(doll.points, doll.triangles) == pytest.approx(4.0, rel=1e-6)
    assert any("is skinned" in note for note in convert(path).notes)


ALL = {np.int8: 5120, np.uint8: 5121, np.int16: 5122, np.uint16: 5123, np.uint32: 5125,
       np.float32: 5126}  # fmt: skip
SHARES = np.clip(CORNERS[:, :2] * 0.5, 0.0, 1.0)


def uvs_of(path):
    """(8, 2) of the first accessor; the whole file can be read as well."""
    (node,) = read_gltf(path).nodes
    assert len(node.mesh.uvs) == 8
    return decoded(open_gltf(path), 0)


def cube_with(maker: GltfMaker, path, **accessor):
    """A cube whose TEXCOORD_0 is the accessor."""
    maker.tree["accessors"].append(accessor)
    primitive = maker.primitive(CORNERS, TRIANGLES)
    primitive["attributes"]["TEXCOORD_0"] = maker.tree["accessors"].index(accessor)
    maker.mesh(primitive)
    return maker.glb(path)


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("normalized", [False, True])
def test_every_component_type_among_others_in_a_row(tmp_path, kind, normalized):
    """Rows of 20 bytes with the values from the third: as interleaved buffers have them."""
    most = 1 if kind is np.float32 else np.iinfo(kind).max
    rows = np.zeros((8, 20), np.uint8)
    stored = (SHARES * most).astype(kind)
    if not np.issubdtype(kind, np.unsignedinteger):
        stored[0] = -stored[-1]
    width = 2 * stored.itemsize
    rows[:, 4 : 4 + width] = np.frombuffer(stored.tobytes(), np.uint8).reshape(8, width)
    maker = GltfMaker()
    view = maker.view(b"\1" * 8 + rows.tobytes())
    maker.tree["bufferViews"][view]["byteStride"] = 20
    path = cube_with(
        maker, tmp_path / "thing.glb", bufferView=view, byteOffset=12, componentType=ALL[kind],
        count=8, type="VEC2", normalized=normalized,
    )  # fmt: skip
    expected = stored / most if normalized else stored.astype(np.float64)
    np.testing.assert_array_equal(uvs_of(path), expected)


def test_the_least_whole_number_stands_for_minus_one(tmp_path):
    """glTF 2.0, 3.6.2.2: max(c / 127, -1), so that 0 has a number of its own."""
    stored = np.full((8, 2), -128, np.int8)
    maker = GltfMaker()
    path = cube_with(
        maker, tmp_path / "thing.glb", bufferView=maker.view(stored.tobytes()), componentType=5120,
        count=8, type="VEC2", normalized=True,
    )  # fmt: skip
    assert uvs_of(path).tolist() == [[-1.0, -1.0]] * 8


@pytest.mark.parametrize("base", [True, False], ids=["on rows", "on zeros"])
def test_a_sparse_accessor_has_some_rows_otherwise(tmp_path, base):
    maker = GltfMaker()
    uvs = SHARES.astype(np.float32)
    indices = maker.view(b"\0\0" + np.array([1, 6], np.uint16).tobytes())
    values = maker.view(np.array([[0.25, 0.75], [0.125, 0.5]], np.float32).tobytes())
    sparse = {
        "count": 2,
        "indices": {"bufferView": indices, "byteOffset": 2, "componentType": 5123},
        "values": {"bufferView": values},
    }
    data = {"bufferView": maker.view(uvs.tobytes())} if base else {}
    path = cube_with(
        maker, tmp_path / "thing.glb", **data, componentType=5126, count=8, type="VEC2",
        sparse=sparse,
    )  # fmt: skip
    expected = uvs.astype(float) if base else np.zeros((8, 2))
    expected[[1, 6]] = [[0.25, 0.75], [0.125, 0.5]]
    np.testing.assert_array_equal(uvs_of(path), expected)


def test_a_strip_and_corners_without_indices(tmp_path):
    maker = GltfMaker()
    zigzag = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], float)
    maker.mesh(maker.primitive(zigzag, range(5)) | {"mode": 5})
    (strip,) = read_gltf(maker.glb(tmp_path / "strip.glb")).nodes
    # every triangle is counter-clockwise as seen from +z
    assert strip.mesh.indices.reshape(-1, 3).tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    maker = GltfMaker()
    primitive = maker.primitive(CORNERS[TRIANGLES].reshape(-1, 3), [0])
    del primitive["indices"]
    maker.mesh(primitive)
    (loose,) = read_gltf(maker.glb(tmp_path / "loose.glb")).nodes
    assert loose.mesh.indices.tolist() == list(range(36))


def test_matrices_of_bytes_have_columns_of_four(tmp_path):
    """glTF 2.0, 3.6.2.4: a column begins at a multiple of four bytes."""
    columns = np.arange(8 * 9, dtype=np.uint8).reshape(8, 3, 3)
    stored = np.zeros((8, 3, 4), np.uint8)
    stored[..., :3] = columns
    maker = GltfMaker()
    maker.tree["accessors"].append(
        {"bufferView": maker.view(stored.tobytes()), "componentType": 5121, "count": 8,
         "type": "MAT3"}
    )  # fmt: skip
    maker.mesh(maker.primitive(CORNERS, TRIANGLES))
    gltf = open_gltf(maker.glb(tmp_path / "thing.glb"))
    np.testing.assert_array_equal(decoded(gltf, 0), columns.reshape(8, 9))


def test_what_draco_compressed(tmp_path):
    DracoPy = pytest.importorskip("DracoPy")
    maker = GltfMaker()
    draco(maker)
    blob = DracoPy.encode(CORNERS.astype(np.float32), TRIANGLES, quantization_bits=14)
    view = maker.view(blob)
    extension = maker.tree["meshes"][0]["primitives"][0]["extensions"]
    extension["KHR_draco_mesh_compression"]["bufferView"] = view
    path = maker.glb(tmp_path / "thing.glb")
    (node,) = read_gltf(path).nodes
    faces = node.mesh.points[node.mesh.indices.reshape(-1, 3)]
    np.testing.assert_allclose(
        np.sort(faces.mean(axis=1), axis=0), np.sort(CORNERS[TRIANGLES].mean(axis=1), axis=0),
        atol=3.0 / 2**14,
    )  # fmt: skip


def draco(maker: GltfMaker) -> None:
    """A primitive as a compressor leaves it: accessors without data, and an opaque blob."""
    maker.tree["accessors"] = [
        {"componentType": 5126, "count": 8, "type": "VEC3"},
        {"componentType": 5125, "count": 36, "type": "SCALAR"},
    ]
    maker.tree["extensionsUsed"] = maker.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    blob = {"bufferView": maker.view(b"DRACO" * 20), "attributes": {"POSITION": 0}}
    maker.mesh(
        {"attributes": {"POSITION": 0}, "indices": 1,
         "extensions": {"KHR_draco_mesh_compression": blob}}
    )  # fmt: skip


def sparse(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, TRIANGLES))
    maker.tree["accessors"][0]["sparse"] = {}


def far_index(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, [*TRIANGLES[:-1], [0, 1, 99]]))


def not_finite(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive([*CORNERS[:-1], [np.nan, 0, 0]], TRIANGLES))


def strange_extension(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, TRIANGLES))
    maker.tree["extensionsRequired"] = ["EXT_meshopt_compression"]


def below_itself(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, TRIANGLES), children=[1])
    maker.tree["nodes"].append({"children": [0]})
    maker.tree["scenes"] = [{"nodes": [0]}]


def no_mesh(maker: GltfMaker) -> None:
    maker.tree["nodes"].append({"name": "empty"})


def gaussians(maker: GltfMaker) -> None:
    points = maker.primitive(CORNERS, TRIANGLES)
    maker.mesh({"attributes": points["attributes"], "mode": 0})
    maker.tree["extensionsUsed"] = ["KHR_gaussian_splatting"]


def wrong_type(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, TRIANGLES), translation=[0, None, 0])


def few_normals(maker: GltfMaker) -> None:
    normals = np.zeros((5, 3), np.float32)
    maker.mesh(maker.primitive(CORNERS, TRIANGLES, NORMAL=normals))


def long_view(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, TRIANGLES))
    maker.tree["bufferViews"][0]["byteLength"] = 10**6


def changed(place: str, **values) -> object:
    """A sound cube, of which one row of the file says otherwise."""

    def make(maker: GltfMaker) -> None:
        maker.mesh(maker.primitive(CORNERS, TRIANGLES, TEXCOORD_0=CORNERS[:, :2].astype("f4")))
        key, number = place.split()
        maker.tree[key][int(number)] |= values

    return make


def without_data(maker: GltfMaker, *, of: int, count: int) -> None:
    maker.mesh(maker.primitive(CORNERS, TRIANGLES))
    del maker.tree["accessors"][of]["bufferView"]
    maker.tree["accessors"][of]["count"] = count


def far_row(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, TRIANGLES))
    indices, values = maker.view(b"\x63\0\0\0"), maker.view(bytes(12))
    maker.tree["accessors"][0]["sparse"] = {
        "count": 1, "indices": {"bufferView": indices, "componentType": 5125},
        "values": {"bufferView": values},
    }  # fmt: skip


def odd_corners(maker: GltfMaker) -> None:
    maker.mesh(maker.primitive(CORNERS, [[0, 1], [2, 3]]))


BROKEN_ACCESSORS = [
    (changed("accessors 0", componentType=5124), "accessor 0 holds VEC3 of component type 5124"),
    (changed("accessors 0", type="VEC5"), "accessor 0 holds VEC5 of component type 5126"),
    (changed("accessors 0", type="VEC2"), "POSITION does not hold three numbers per point"),
    (
        changed("accessors 0", byteOffset=4),
        "accessor 0 refers to 8 rows of 12 bytes with a stride of 12, from",
    ),
    (changed("accessors 0", count=2**52), "accessor 0 refers to 4503599627370496 rows of 12 bytes"),
    (changed("accessors 1", count=7), "TEXCOORD_0 has 7 rows of 2 values for 8 points"),
    (changed("accessors 2", componentType=5126), "its indices are SCALAR of component type 5126"),
    (changed("accessors 2", count=2**52), "accessor 2 refers to 4503599627370496 rows of 4 bytes"),
    (changed("bufferViews 0", byteStride=8), "refers to 8 rows of 12 bytes with a stride of 8"),
    (
        changed("bufferViews 0", byteStride=2**52),
        "rows of 12 bytes with a stride of 4503599627370496",
    ),
    (
        changed("accessors 0", sparse={"count": -1}),
        "accessors[0].sparse.count is not an integer of 0",
    ),
    (lambda maker: without_data(maker, of=0, count=8), "its 8 points are all in one place"),
    (lambda maker: without_data(maker, of=0, count=2**52), "4503599627370496 rows but has no data"),
    (lambda maker: without_data(maker, of=1, count=36), "its indices have no data"),
    (far_row, "accessor 0, sparse, replaces row 99, but there are only 8"),
    (odd_corners, "its 4 corners do not make complete triangles"),
]


@pytest.mark.parametrize(
    ("make", "message"), BROKEN_ACCESSORS, ids=[w for _, w in BROKEN_ACCESSORS]
)
def test_accessors_that_do_not_fit_are_refused(tmp_path, make, message):
    maker = GltfMaker()
    make(maker)
    path = maker.glb(tmp_path / "thing.glb")
    with pytest.raises(InputError) as error:
        read_asset(path)
    assert str(path) in error.value.message
    assert message in error.value.message
    assert error.value.hint


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (draco, "mesh 0, primitive 0 is compressed with KHR_draco_mesh_compression"),
        (sparse, "accessor 0 is sparse"),
        (far_index, "1 of 36 indices do not refer to any of its 8 points; the first is 99"),
        (not_finite, "1 of 8 points are not finite"),
        (
            strange_extension,
            "requires the extension EXT_meshopt_compression, which is not supported",
        ),
        (below_itself, "node 0 is its own descendant"),
        (no_mesh, "the file contains no mesh"),
        (gaussians, "it holds Gaussians (KHR_gaussian_splatting), which are not supported in glTF"),
        (wrong_type, "nodes[0].translation is not a list of 3 numbers"),
        (few_normals, "NORMAL has 5 rows of 3 values for 8 points"),
        (long_view, "buffer view 0 refers to bytes 0 to 1000000"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path, caplog, make, message):
    maker = GltfMaker()
    make(maker)
    path = maker.glb(tmp_path / "thing.glb")
    with pytest.raises(InputError) as error:
        read_asset(path)
    assert str(path) in error.value.message
    assert message in error.value.message
    assert error.value.hint
    assert caplog.records == []  # trimesh keeps its remarks to itself


def test_damaged_containers_are_refused(tmp_path):
    maker = GltfMaker()
    maker.mesh(maker.primitive(CORNERS, TRIANGLES))
    whole = maker.glb(tmp_path / "whole.glb").read_bytes()
    for data, message in (
        (whole[:-20], f"is truncated: it has {len(whole) - 20} of {len(whole)} bytes"),
        (whole[:15], "is truncated: 15 bytes"),
        (b"glTF\1" + whole[5:], "is binary glTF 1"),
        (b"\x89PNG and so on", "is not a valid glTF file: its JSON"),
        (b"[1, 2]", "is not a glTF file: it has no 'asset'"),
        (json.dumps({"asset": {"version": "1.0"}}).encode(), "is glTF 1.0"),
        (
            json.dumps({"asset": {"version": "1.0"}, "scene": "main", "meshes": {}}).encode(),
            "is glTF 1.0; only glTF 2 can be read",
        ),
        (json.dumps({"asset": {"version": 1}}).encode(), "is glTF 1;"),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a git-lfs pointer"),
    ):
        path = tmp_path / "thing.glb"
        path.write_bytes(data)
        with pytest.raises(InputError) as error:
            read_asset(path)
        assert message in error.value.message
    path = maker.gltf(tmp_path / "thing.gltf")
    path.with_suffix(".bin").unlink()
    with pytest.raises(InputError, match=r"needs thing\.bin, which cannot be read"):
        read_asset(path)

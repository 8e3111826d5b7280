"""Morph targets of glTF files: at the weights of the node, else of the mesh, else left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mesh_makers import CORNERS, TRIANGLES, GltfMaker

from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.gltf.scene import read_gltf, read_rigged_gltf

WIDER = np.array([1.0, 0.0, 0.0], np.float32) * CORNERS.astype(np.float32)
HIGHER = np.array([0.0, 2.0, 0.0], np.float32) * CORNERS.astype(np.float32)
OUT = np.tile(np.array([0, 0, 1], np.float32), (8, 1))


def box(maker: GltfMaker, mesh: dict[str, Any], **node: Any) -> dict[str, Any]:
    """A box with the targets `wide` and `high`; returns its primitive."""
    primitive = maker.primitive(CORNERS, TRIANGLES, NORMAL=OUT)
    primitive["targets"] = [
        {"POSITION": maker.accessor(WIDER), "NORMAL": maker.accessor(-2 * OUT)},
        {"POSITION": maker.accessor(HIGHER)},
    ]
    maker.mesh(primitive, **node)
    maker.tree["meshes"][-1] |= {"name": "Box", **mesh}
    return primitive


NAMED = {"extras": {"targetNames": ["wide", "high"]}}


@pytest.mark.parametrize(
    ("mesh", "node", "weights", "note"),
    [
        ({"weights": [0.5, 0.0]}, {}, (0.5, 0.0), "default weights: target 0 with 0.5"),
        ({"weights": [0.5, 0.0]} | NAMED, {}, (0.5, 0.0), "default weights: wide with 0.5"),
        (
            {"weights": [0.5, 0.0], "extras": [3]},
            {},
            (0.5, 0.0),
            "default weights: target 0 with 0.5",
        ),
        (
            {"weights": [0.5, 0.0]} | NAMED,
            {"weights": [0.25, 1.0]},
            (0.25, 1.0),
            "wide with 0.25, high with 1",
        ),
        ({}, {}, (0.0, 0.0), "Box: 2 morph targets of weight 0: left out"),
    ],
    ids=["mesh", "names", "other extras", "node", "none"],
)
@pytest.mark.parametrize("read", [read_gltf, read_rigged_gltf])
def test_the_shape_is_that_of_the_default_weights(tmp_path: Path, read, mesh, node, weights, note):
    maker = GltfMaker()
    box(maker, mesh, **node)
    file = read(maker.glb(tmp_path / "thing.glb"))
    (found,) = file.nodes
    expected = CORNERS + weights[0] * WIDER + weights[1] * HIGHER
    np.testing.assert_allclose(found.mesh.points, expected, rtol=1e-12)
    np.testing.assert_allclose(found.mesh.normals, OUT - 2 * weights[0] * OUT)
    assert any(note in line for line in file.notes), file.notes


def test_a_mesh_of_two_nodes_has_the_weights_of_each(tmp_path: Path) -> None:
    maker = GltfMaker()
    box(maker, {}, name="still")
    maker.tree["nodes"].append({"mesh": 0, "weights": [1.0, 0.0], "name": "wide"})
    file = read_gltf(maker.glb(tmp_path / "thing.glb"))
    widths = [float(np.ptp(node.mesh.points[:, 0])) for node in file.nodes if node.mesh]
    assert widths == [np.ptp(CORNERS[:, 0]), 2 * np.ptp(CORNERS[:, 0])]
    # both notes were on Box alone
    assert "Box of node still: 2 morph targets of weight 0: left out" in file.notes
    (wide,) = [note for note in file.notes if note.startswith("Box of node wide is read ")]
    assert wide.endswith("target 0 with 1")


def test_a_mesh_of_two_nodes_with_the_same_weights_has_one_note(tmp_path: Path) -> None:
    maker = GltfMaker()
    box(maker, {"weights": [1.0, 0.0]}, name="one")
    maker.tree["nodes"].append({"mesh": 0, "name": "two"})
    notes = read_gltf(maker.glb(tmp_path / "thing.glb")).notes
    assert [note for note in notes if "morph" in note and "node" not in note] != []
    assert [note for note in notes if "morph" in note and "node" in note] == []


def test_a_primitive_without_targets_is_the_same_at_all_weights(tmp_path: Path) -> None:
    maker = GltfMaker()
    first = box(maker, {"weights": [1.0, 0.0]})
    plain = {key: value for key, value in first.items() if key != "targets"}
    maker.tree["meshes"][0]["primitives"].append(plain)
    (node,) = read_gltf(maker.glb(tmp_path / "thing.glb")).nodes
    assert node.mesh
    points = node.mesh.points
    assert np.allclose(points[: len(CORNERS)], CORNERS + WIDER)
    assert np.allclose(points[len(CORNERS) :], CORNERS)


def few_weights(maker: GltfMaker) -> None:
    box(maker, {"weights": [1.0]})


def other_targets(maker: GltfMaker) -> None:
    first = box(maker, {"weights": [1.0, 0.0]})
    maker.tree["meshes"][0]["primitives"].append(first | {"targets": first["targets"][:1]})


def few_points(maker: GltfMaker) -> None:
    primitive = box(maker, {"weights": [1.0, 0.0]})
    primitive["targets"][0]["POSITION"] = maker.accessor(WIDER[:5])


def weight_of_text(maker: GltfMaker) -> None:
    box(maker, {"weights": ["1", 0.0]})


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (few_weights, r"mesh 'Box' has 1 weight for the 2 morph targets of its primitive 0"),
        (other_targets, r"mesh 'Box' has 2 weights for the 1 morph target of its primitive 1"),
        (
            few_points,
            r"mesh 'Box', primitive 0: POSITION of morph target 0 has 5 rows of 3 values for 8",
        ),
        (weight_of_text, r"meshes\[0\].weights\[0\] is not a finite number"),
    ],
)
def test_targets_that_do_not_fit_are_refused(tmp_path: Path, make, fault) -> None:
    maker = GltfMaker()
    make(maker)
    with pytest.raises(InputError, match=fault):
        read_gltf(maker.glb(tmp_path / "thing.glb"))

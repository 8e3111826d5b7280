"""Values come out of `exchange` as they went in, to the bit and to the type."""

from __future__ import annotations

import json
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from gf_usd.core.asset import Surface, SurfaceMaterial, Texture
from gf_usd.system import exchange


def passed(value):
    out = BytesIO()
    exchange.write(value, out)
    return exchange.read(out.getvalue())


def test_plain_values_keep_their_types() -> None:
    value = {
        "none": None, "nan": float("inf"), "text": "\udc80 \n \u00e9", "path": Path("/a/\udcff"),
        "list": [1, 2.5, True], "tuple": ((), (1,)), "set": frozenset({(0, 1)}), 7: "a",
    }  # fmt: skip
    assert passed(value) == value
    assert np.isnan(passed(float("nan")))


@pytest.mark.parametrize(
    "array",
    [
        np.arange(12.0).reshape(4, 3),
        np.asfortranarray(np.arange(12.0).reshape(4, 3)),
        np.arange(24).reshape(4, 6)[:, ::2],
        np.broadcast_to(np.eye(4), (3, 4, 4)),
        np.zeros((0, 3), np.float32),
        np.array(3.5),
        np.array([True, False]),
        np.arange(9, dtype=">i2"),
        np.array(["a", "bc"]),
    ],
)
def test_arrays_keep_type_shape_and_order(array: np.ndarray) -> None:
    got = passed(array)
    assert (got.dtype, got.shape) == (array.dtype, array.shape)
    np.testing.assert_array_equal(got, array)
    assert got.flags.f_contiguous >= array.flags.f_contiguous
    assert got.flags.writeable


def test_a_number_of_numpy_stays_one() -> None:
    number = passed(np.float32(0.1))
    assert type(number) is np.float32
    assert number == np.float32(0.1)


def test_what_is_shared_stays_shared() -> None:
    texture = Texture(pixels=np.zeros((2, 2, 3), np.uint8), srgb=True)
    looks = tuple(
        SurfaceMaterial(path=path, color=(1.0, 0.5, 0.0), texture=texture) for path in ("/a", "/b")
    )
    points = np.zeros((3, 3))
    surface = Surface(
        path="/m", type_name="Mesh", points=points, face_counts=np.array([3]),
        face_indices=np.arange(3), triangles=np.array([[0, 1, 2]]),
        triangle_corners=np.array([[0, 1, 2]]), materials=looks,
    )  # fmt: skip
    one, other = passed((surface, surface))
    assert one is other
    assert one.materials[0].texture is one.materials[1].texture
    assert one.materials[0].color == (1.0, 0.5, 0.0)
    assert one.normals is None


@dataclass
class Foreign:
    value: int = 0


def test_only_dataclasses_of_the_package_are_made() -> None:
    out = BytesIO()
    exchange.write(Foreign(), out)
    with pytest.raises(ValueError, match="is not a dataclass of this package"):
        exchange.read(out.getvalue())
    for module, name in (("gf_usd.system.exchange", "read"), ("os", "system")):
        row = json.dumps([{"object": 0}, [[module, name, {}]], 0]).encode() + b"\n"
        with pytest.raises(ValueError, match="is not a dataclass of this package"):
            exchange.read(row)


def test_objects_are_refused_on_both_sides() -> None:
    with pytest.raises(TypeError, match="cannot be passed between processes"):
        exchange.write(object(), BytesIO())
    with pytest.raises(ValueError, match="Object arrays cannot be saved"):
        exchange.write(np.array([object()]), BytesIO())

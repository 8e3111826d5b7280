"""Copies of device arrays without a launch."""

from __future__ import annotations

import numpy as np
import pytest

from gf_usd.physics import taichi_arrays
from gf_usd.system.taichi_runtime import import_taichi, init_taichi

ti = import_taichi()


@pytest.fixture(params=["scalars", "lanes"])
def array(request: pytest.FixtureRequest):
    init_taichi()
    kind = ti.f32 if request.param == "scalars" else ti.types.vector(8, ti.f32)
    made = ti.ndarray(kind, 5)
    shape = (*made.shape, *made.element_shape)
    made.from_numpy(np.arange(np.prod(shape), dtype=np.float32).reshape(shape))
    return made


def test_values_are_those_of_taichis_own_copy(array) -> None:
    seen = taichi_arrays.values(array)
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen, array.to_numpy())


def test_values_are_a_copy(array) -> None:
    taichi_arrays.values(array)[:] = -1.0
    assert taichi_arrays.values(array).min() == 0.0


def test_what_is_put_is_what_kernels_see(array) -> None:
    new = 3.0 - taichi_arrays.values(array)
    taichi_arrays.put(array, new)
    np.testing.assert_array_equal(array.to_numpy(), new)


def test_put_of_another_shape_is_refused(array) -> None:
    with pytest.raises(ValueError, match=r"\(4,\) values for an array of shape \(5,"):
        taichi_arrays.put(array, np.zeros(4, np.float32))


def test_integers_keep_their_type() -> None:
    init_taichi()
    made = ti.ndarray(ti.i32, 3)
    taichi_arrays.put(made, np.array([1, 2**31 - 1, -5], np.int32))
    assert taichi_arrays.values(made).dtype == np.int32
    np.testing.assert_array_equal(made.to_numpy(), [1, 2**31 - 1, -5])

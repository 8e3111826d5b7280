"""Copies of device arrays without a launch."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from gf_usd.core.errors import GfUsdError
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


class Driver:
    """A CUDA driver whose GPU is the CPU's memory."""

    def __init__(self) -> None:
        self.failed = 0
        self.copied: list[int] = []
        self.current = 7

    def cuCtxGetCurrent(self, out: Any) -> int:
        out._obj.value = self.current
        return 0

    def cuCtxSetCurrent(self, context: ctypes.c_void_p) -> int:
        self.current = context.value or 0
        return 0

    def _copy(self, to: ctypes.c_uint64, of: ctypes.c_uint64, size: ctypes.c_size_t) -> int:
        ctypes.memmove(to.value or 0, of.value or 0, size.value)
        self.copied.append(size.value)
        return self.failed

    cuMemcpyDtoH_v2 = cuMemcpyHtoD_v2 = _copy


@pytest.fixture
def on_gpu(monkeypatch: pytest.MonkeyPatch):
    """An array of three rows of two numbers that stands on a GPU, and the driver."""
    init_taichi()
    driver = Driver()
    monkeypatch.setattr(taichi_arrays, "cuda_driver", lambda: driver)
    array = ti.ndarray(ti.types.vector(2, ti.f32), 3)
    there = np.arange(6.0, dtype=np.float32).reshape(3, 2)
    memory = taichi_arrays._OnGpu(there.ctypes.data, there.shape, there.dtype)
    setattr(array, taichi_arrays.SEEN, memory)
    return array, there, driver


def test_the_driver_copies_what_is_on_a_gpu(on_gpu) -> None:
    array, there, driver = on_gpu
    driver.current = 0  # as in another thread
    np.testing.assert_array_equal(taichi_arrays.host_view(array), there)
    assert driver.current == 7
    seen = taichi_arrays.values(array)
    np.testing.assert_array_equal(seen, there)
    seen[:] = -1.0
    assert there[0, 0] == 0.0
    taichi_arrays.put(array, there + 10.0)
    np.testing.assert_array_equal(there[2], [14.0, 15.0])
    driver.copied.clear()
    np.testing.assert_array_equal(taichi_arrays.first(array, 2), there[:2])
    taichi_arrays.put_first(array, np.array([[7.0, 8.0]]))
    assert driver.copied == [16, 8]
    np.testing.assert_array_equal(there, [[7.0, 8.0], [12.0, 13.0], [14.0, 15.0]])
    np.testing.assert_array_equal(taichi_arrays.part(array, 2, 1, 2), there[:, 1:])
    with taichi_arrays.written(array, 2) as rows:
        rows[:, 1] = -3.0
    np.testing.assert_array_equal(there, [[7.0, -3.0], [12.0, -3.0], [14.0, -3.0]])
    taichi_arrays.clear(array)
    assert not there.any()


def test_a_copy_that_the_driver_refuses_is_an_error(on_gpu) -> None:
    array, _, driver = on_gpu
    driver.failed = 700
    with pytest.raises(GfUsdError, match=r"24 bytes could not be copied .* error 700") as caught:
        taichi_arrays.values(array)
    assert "--device cpu" in str(caught.value.hint)


@pytest.mark.parametrize("reached", [True, False])
def test_parts_of_rows_are_read_and_written(monkeypatch, reached) -> None:
    init_taichi()
    state = taichi_arrays.DeviceState({"rows": np.arange(12.0)}, np.float32, (), np.zeros(3))
    if not reached:  # as on a device that nothing reaches
        monkeypatch.setattr(taichi_arrays, "_memory", lambda array: None)
    seen = state.part("rows", 4, 1, 3)
    np.testing.assert_array_equal(seen, [[1.0, 2.0], [5.0, 6.0], [9.0, 10.0]])
    seen[:] = -1.0
    with state.written("rows", 4) as rows:
        rows[:, 1] = 0.0
    state.put_first("rows", np.array([7.0]))
    whole = state.arrays["rows"].to_numpy()
    np.testing.assert_array_equal(whole, [7, 0, 2, 3, 4, 0, 6, 7, 8, 0, 10, 11])

"""Arrays of a device, copied to NumPy and back without a launch where the CPU can reach them.

Taichi's own copies launch a kernel, some 100 microseconds each: with 30 of them a frame that is
more than a small body's substeps.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from gf_usd.model import Floats

SEEN = "_gf_usd_memory"  # where an array keeps what was found of it


def values(array: Any) -> Floats:
    """A copy of a ti.ndarray: its shape, then its element's."""
    seen = _memory(array)
    return array.to_numpy() if seen is None else seen.copy()


def put(array: Any, new: Floats) -> None:
    """Fill a ti.ndarray.  Raises ValueError where the shapes differ."""
    shape = _shape(array)
    if np.shape(new) != shape:
        raise ValueError(f"{np.shape(new)} values for an array of shape {shape}")
    seen = _memory(array)
    if seen is None:
        array.from_numpy(np.ascontiguousarray(new))
    else:
        seen[...] = new


def _shape(array: Any) -> tuple[int, ...]:
    return (*array.shape, *array.element_shape)


def clear(array: Any) -> None:
    """Fill a ti.ndarray with zeros."""
    seen = _memory(array)
    if seen is None:
        array.fill(0)
    else:
        seen[...] = 0


def _memory(array: Any) -> Floats | None:
    """The array's own memory; None where the CPU cannot reach it."""
    seen = getattr(array, SEEN, None)
    if seen is None:
        seen = _look(array)
        if seen is None:
            return None
        # It stays where it is as long as the array lives.
        setattr(array, SEEN, seen)
    _wait()
    return seen


def _look(array: Any) -> Floats | None:
    import taichi as ti
    from taichi.lang import impl
    from taichi.lang.util import to_numpy_type

    runtime = impl.get_runtime()
    if impl.current_cfg().arch not in (ti.x64, ti.arm64):
        return None
    kind = np.dtype(to_numpy_type(array.dtype))
    shape = _shape(array)
    assert runtime.prog is not None
    address = runtime.prog.get_ndarray_data_ptr_as_int(array.arr)
    raw: Any = (ctypes.c_byte * (math.prod(shape) * kind.itemsize)).from_address(address)
    return np.ndarray(shape, kind, raw)


def _wait() -> None:
    """Until the kernels that were launched are done."""
    from taichi.lang import impl

    program = impl.get_runtime().prog
    assert program is not None
    program.synchronize()

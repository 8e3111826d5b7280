"""Arrays of a device, copied to NumPy and back without a launch where the CPU can reach them.

Taichi's own copies launch a kernel, some 100 microseconds each: with 30 of them a frame that is
more than a small body's substeps.

A kernel launched again and again with the same pack of arrays.

Taichi goes through every array of a pack twice at each launch, to see that their types are those it
compiled for and to hand over their addresses: half a millisecond, several times the substeps of a
small body.  Types and addresses stay, so here they are looked at once.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats

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


class Launcher:
    """`kernel(pack, *values)` as `launcher(*values)`.

    kernel : whose first argument is a pack of arrays, the others numbers and vectors.
    pack : its arrays must outlive the launcher.
    """

    def __init__(self, kernel: Any, pack: Any) -> None:
        self._kernel, self._pack = kernel, pack
        self._ready: Any = None

    def __call__(self, *values: Any) -> None:
        """Launch it.  Raises what Taichi raises where values do not fit at the first launch."""
        from taichi.lang import impl

        if self._ready is None:
            self._kernel(self._pack, *values)
            self._ready = self._prepare(values)
            return
        made, compiled, argpack, arrays, setters = self._ready
        context = made.make_launch_context()  # a launch uses it up
        context.set_arg_argpack((0,), argpack)
        for index, (put, value) in enumerate(zip(setters, values), 1):
            put(context, index, value)
        # Arrays of a pack come after all other arguments.
        for place, array in arrays:
            context.set_arg_ndarray(place, array)
        program: Any = impl.get_runtime().prog
        program.launch_kernel(compiled, context)

    def _prepare(self, values: tuple[Any, ...]) -> tuple[Any, ...]:
        from taichi.lang import impl

        primal, pack = self._kernel._primal, self._pack
        made = primal.compiled_kernels[primal.ensure_compiled(pack, *values)]
        arrays = [((k,), array.arr) for k, array in enumerate(pack._members, 1 + len(values))]
        program: Any = impl.get_runtime().prog
        compiled = program.compile_kernel(program.config(), program.get_device_caps(), made)
        setters = [_setter(argument.annotation) for argument in primal.arguments[1:]]
        return made, compiled, pack._ArgPack__argpack, arrays, setters


def _setter(kind: Any) -> Any:
    """How a number or a vector of a type gets into a launch."""
    from taichi.lang.matrix import MatrixType
    from taichi.types import primitive_types

    if isinstance(kind, MatrixType):
        return lambda context, index, value: kind.set_kernel_struct_args(value, context, (index,))
    if id(kind) in primitive_types.real_type_ids:
        return lambda context, index, value: context.set_arg_float((index,), float(value))
    return lambda context, index, value: context.set_arg_int((index,), int(value))

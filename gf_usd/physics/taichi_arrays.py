"""Fast access to Taichi arrays from NumPy, the state of a body on a device, and repeated launches.

Arrays are copied without a kernel launch: directly in the CPU's memory, or by the CUDA driver.
Taichi's own copies launch a kernel, some 100 us each; 30 of them in a frame take longer than the
substeps of a small body.

`Launcher` launches a kernel repeatedly with the same pack of arrays. Taichi iterates twice over all
arrays of a pack at each launch, to check their types and to pass their addresses: half a
millisecond, several times the duration of the substeps of a small body. Types and addresses are
constant, so that `Launcher` determines them once. `on_arrays` does the same for the types of a
kernel of NumPy arrays, of which Taichi's own launch takes some 20 us each.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import wraps
from typing import Any, Protocol

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import GfUsdError
from gf_usd.system.taichi_runtime import compiling, cuda_driver, epoch

SEEN = "_gf_usd_memory"  # attribute of an array that caches its memory view


def values(array: Any) -> Floats:
    """A copy of a ti.ndarray: its shape, then its element's."""
    seen = _memory(array)
    return array.to_numpy() if seen is None else seen.copy()


def host_view(array: Any) -> Floats:
    """The values of a ti.ndarray, to be read before the next launch: its memory on the CPU,
    a copy on a GPU.
    """
    seen = _memory(array)
    return array.to_numpy() if seen is None else seen[...]


def put(array: Any, new: Floats) -> None:
    """Fill a ti.ndarray. Raises ValueError where the shapes differ."""
    shape = _shape(array)
    if np.shape(new) != shape:
        raise ValueError(f"{np.shape(new)} values for an array of shape {shape}")
    seen = _memory(array)
    if seen is None:
        array.from_numpy(np.ascontiguousarray(new))
    else:
        seen[...] = new


def put_first(array: Any, new: Floats) -> None:
    """Fill the beginning of a flat ti.ndarray; the rest is unchanged."""
    seen = _memory(array)
    if seen is None:
        whole = array.to_numpy()
        whole[: len(new)] = new
        array.from_numpy(whole)
    else:
        seen[: len(new)] = new


def first(array: Any, count: int) -> Floats:
    """A copy of the first numbers of a flat ti.ndarray."""
    seen = _memory(array)
    return (array.to_numpy() if seen is None else seen)[:count].copy()


def part(array: Any, width: int, first: int, behind: int) -> Floats:
    """A copy of columns `first` to `behind` (exclusive) of a ti.ndarray with rows of `width`."""
    seen = _memory(array)
    whole = array.to_numpy() if seen is None else seen[...]
    return whole.reshape(-1, width)[:, first:behind].copy()


@contextmanager
def written(array: Any, width: int) -> Generator[Floats, None, None]:
    """A ti.ndarray as a writable (n, width) array: its own memory where the CPU can access it."""
    seen = _memory(array)
    whole = array.to_numpy() if seen is None else seen[...]
    yield whole.reshape(-1, width)
    if seen is None:
        array.from_numpy(whole)
    elif isinstance(seen, _OnGpu):
        seen[...] = whole


def _shape(array: Any) -> tuple[int, ...]:
    return (*array.shape, *array.element_shape)


def clear(array: Any) -> None:
    """Fill a ti.ndarray with zeros."""
    seen = _memory(array)
    if seen is None:
        array.fill(0)
    else:
        seen[...] = 0


class _OnGpu:
    """The memory of an array on a GPU: copied by slices that begin at the first row."""

    def __init__(self, address: int, shape: tuple[int, ...], kind: np.dtype[Any]) -> None:
        self._address, self._shape, self._kind = address, shape, kind
        self._context = ctypes.c_void_p()
        cuda_driver().cuCtxGetCurrent(ctypes.byref(self._context))

    def _rows(self, where: Any) -> tuple[int, ...]:
        """The shape of a copy; where : a slice from the first row on, or `...`."""
        if where is Ellipsis:
            return self._shape
        first, behind, step = where.indices(self._shape[0])
        assert (first, step) == (0, 1)
        return (behind, *self._shape[1:])

    def __getitem__(self, where: Any) -> Floats:
        out = np.empty(self._rows(where), self._kind)
        self._ask("cuMemcpyDtoH_v2", out.ctypes.data, self._address, out.nbytes)
        return out

    def __setitem__(self, where: Any, new: Any) -> None:
        shape = self._rows(where)
        given = np.ascontiguousarray(np.broadcast_to(new, shape), self._kind)
        self._ask("cuMemcpyHtoD_v2", self._address, given.ctypes.data, given.nbytes)

    def copy(self) -> Floats:
        """A copy of the whole array."""
        return self[...]

    def _ask(self, name: str, to: int, of: int, size: int) -> None:
        driver = cuda_driver()
        if self._context:  # a new thread has no current context
            driver.cuCtxSetCurrent(self._context)
        failed = getattr(driver, name)(
            ctypes.c_uint64(to), ctypes.c_uint64(of), ctypes.c_size_t(size)
        )
        if failed:
            raise GfUsdError(
                f"{size} bytes could not be copied from or to the GPU: error {failed} of the CUDA"
                " driver",
                "check with nvidia-smi that the driver sees the card, or use --device cpu",
            )


def _memory(array: Any) -> Any:
    """The array's memory; None where neither the CPU nor the CUDA driver can access it."""
    seen = getattr(array, SEEN, None)
    if seen is None:
        seen = _mapped(array)
        if seen is None:
            return None
        # The address is constant during the lifetime of the array.
        setattr(array, SEEN, seen)
    _wait()
    return seen


def _mapped(array: Any) -> Any:
    """The memory of an array as a NumPy array or an `_OnGpu`; None for other devices."""
    import taichi as ti
    from taichi.lang import impl
    from taichi.lang.util import to_numpy_type

    runtime = impl.get_runtime()
    arch = impl.current_cfg().arch
    if arch not in (ti.x64, ti.arm64, ti.cuda):
        return None
    kind = np.dtype(to_numpy_type(array.dtype))
    shape = _shape(array)
    assert runtime.prog is not None
    address = runtime.prog.get_ndarray_data_ptr_as_int(array.arr)
    if arch == ti.cuda:
        return _OnGpu(address, shape, kind)
    raw: Any = (ctypes.c_byte * (math.prod(shape) * kind.itemsize)).from_address(address)
    return np.ndarray(shape, kind, raw)


def _wait() -> None:
    """Wait for the launched kernels."""
    from taichi.lang import impl

    program = impl.get_runtime().prog
    assert program is not None
    program.synchronize()


def aligned(rows: int, lanes: int) -> Floats:
    """(rows, lanes) uninitialized values, aligned for kernels that load rows as vectors.

    A vector is loaded from an address that is a multiple of its size; NumPy aligns to 16 bytes
    only.
    """
    size = 8 * lanes
    raw = np.empty((rows + 1) * lanes)
    first = -raw.__array_interface__["data"][0] % size // 8
    return raw[first : first + rows * lanes].reshape(rows, lanes)


def widened(rows: Floats, lanes: int) -> Floats:
    """`aligned` rows from (n, k), padded with zeros."""
    wide = aligned(len(rows), lanes)
    wide[:, : rows.shape[1]], wide[:, rows.shape[1] :] = rows, 0.0
    return wide


def to_device(values: Mapping[str, Floats], real: type) -> dict[str, Any]:
    """Taichi ndarrays: int32 for integers, otherwise `real` (numpy float32 or float64).

    Rows of lanes become vectors.
    """
    import taichi as ti

    kind = ti.f64 if real is np.float64 else ti.f32
    out = {}
    for name, value in values.items():
        whole = np.issubdtype(value.dtype, np.integer)
        value = np.ascontiguousarray(value, dtype=np.int32 if whole else real)
        made = ti.i32 if whole else kind
        if value.ndim > 1:
            made = ti.types.vector(value.shape[1], made)
        out[name] = ti.ndarray(made, value.shape[:1])
        put(out[name], value)
    return out


class Saved(Protocol):
    """A component with a state in addition to the arrays."""

    def save(self) -> dict[str, Any]:
        """The state as arrays and numbers."""
        ...

    def load(self, saved: Mapping[str, Any]) -> None:
        """Restore what `save` returned."""
        ...


class DeviceState:
    """The state of a body: arrays on a device, the offset of the moving frame, and the time.

    Between launches, only the methods of this class write to the arrays.

    values : every array by its name, flat; real : numpy dtype of those that are not integers.
    saved : names of the arrays that `save` includes; the others are derived or temporary.
    offset : (3,) [m] rigid translation that the arrays leave out.
    """

    def __init__(
        self, values: Mapping[str, Floats], real: type, saved: Sequence[str], offset: Any
    ) -> None:
        self.arrays = to_device(values, real)
        self.real, self.saved = real, tuple(saved)
        self.offset = np.asarray(offset, float)
        self.time = 0.0  # [s]
        self.done = 0  # number of substeps since the start
        self.parts: list[Saved] = []  # saved and loaded with the arrays

    def get(self, name: str) -> Floats:
        """A copy of an array, as on the device."""
        return values(self.arrays[name])

    def rows(self, name: str, width: int = 3) -> Floats:
        """A copy of an array in float64, (n, width)."""
        return self.get(name).astype(float).reshape(-1, width)

    def part(self, name: str, width: int, first: int, behind: int) -> Floats:
        """A copy of columns `first` to `behind` of rows of `width`, in float64."""
        return part(self.arrays[name], width, first, behind).astype(float)

    def written(self, name: str, width: int) -> AbstractContextManager[Floats]:
        """An array as a writable (n, width) array."""
        return written(self.arrays[name], width)

    def put(self, name: str, new: Any) -> None:
        """Fill an array from `new` of any shape. Raises ValueError for another size."""
        array, new = self.arrays[name], np.asarray(new)
        kind = np.int32 if np.issubdtype(new.dtype, np.integer) else self.real
        put(array, new.astype(kind).reshape(_shape(array)))

    def put_padded(self, name: str, new: Any) -> None:
        """Fill the beginning of a flat array, and the rest with zeros."""
        whole = np.zeros(self.arrays[name].shape, np.asarray(new).dtype)
        whole[: len(new)] = new
        self.put(name, whole)

    def put_first(self, name: str, new: Any) -> None:
        """Fill the beginning of a flat array; the rest, which is not read, is unchanged."""
        put_first(self.arrays[name], new)

    def clear(self, *names: str) -> None:
        """Fill arrays with zeros."""
        for name in names:
            clear(self.arrays[name])

    def save(self) -> dict[str, Any]:
        """The state from which `load` continues bit-identically."""
        out: dict[str, Any] = {name: self.get(name) for name in self.saved}
        for part in self.parts:
            out |= part.save()
        return {**out, "offset": self.offset.copy(), "time": self.time, "done": self.done}

    def load(self, saved: Mapping[str, Any]) -> None:
        """Restore what `save` returned."""
        for name in self.saved:
            self.put(name, saved[name])
        for part in self.parts:
            part.load(saved)
        self.offset = np.asarray(saved["offset"], float).copy()
        self.time, self.done = float(saved["time"]), int(saved["done"])


class Launcher:
    """Makes `launcher(*values)` equivalent to `kernel(pack, *values)`.

    kernel : its first argument is a pack of arrays, the others are numbers and vectors.
    pack : its arrays must outlive the launcher.
    """

    def __init__(self, kernel: Any, pack: Any) -> None:
        self._kernel, self._pack = kernel, pack
        self._ready: Any = None

    def __call__(self, *values: Any) -> None:
        """Launch the kernel. Raises Taichi's exceptions where values do not fit at the first
        launch.
        """
        from taichi.lang import impl

        if self._ready is None:
            with compiling():
                self._kernel(self._pack, *values)
                self._ready = self._prepare(values)
            return
        made, compiled, argpack, arrays, setters = self._ready
        context = made.make_launch_context()  # valid for one launch
        context.set_arg_argpack((0,), argpack)
        for index, (put, value) in enumerate(zip(setters, values), 1):
            put(context, index, value)
        # Arrays of a pack come after all other arguments.
        for place, array in arrays:
            context.set_arg_ndarray(place, array)
        program: Any = impl.get_runtime().prog
        program.launch_kernel(compiled, context)

    def _prepare(self, values: tuple[Any, ...]) -> tuple[Any, ...]:
        pack = self._pack
        made, compiled, setters = _prepared(self._kernel, (pack, *values), 1)
        arrays = [((k,), array.arr) for k, array in enumerate(pack._members, 1 + len(values))]
        return made, compiled, pack._ArgPack__argpack, arrays, setters


def on_arrays(kernel: Any) -> Callable[..., None]:
    """The kernel, whose arguments are NumPy arrays and numbers, with faster launches.

    Raises TypeError for an array of another type, number of dimensions or order in memory.
    """
    ready: tuple[Any, ...] = ()
    started = -1  # the start of Taichi for which it is ready

    @wraps(kernel)
    def launch(*values: Any) -> None:
        nonlocal ready, started
        from taichi.lang import impl

        if started != epoch():
            kernel(*values)
            ready, started = _prepared(kernel, values, 0), epoch()
            return
        made, compiled, setters = ready
        context = made.make_launch_context()  # valid for one launch
        for index, (put, value) in enumerate(zip(setters, values, strict=True)):
            put(context, index, value)
        program: Any = impl.get_runtime().prog
        program.launch_kernel(compiled, context)

    return launch


def _prepared(kernel: Any, values: tuple[Any, ...], first: int) -> tuple[Any, ...]:
    """A kernel that was launched with these values: as Taichi's object, compiled, and the functions
    that pass the values from `first` on.
    """
    from taichi.lang import impl

    primal = kernel._primal
    made = primal.compiled_kernels[primal.ensure_compiled(*values)]
    program: Any = impl.get_runtime().prog
    compiled = program.compile_kernel(program.config(), program.get_device_caps(), made)
    return made, compiled, [_setter(one.annotation) for one in primal.arguments[first:]]


def _setter(kind: Any) -> Any:
    """The function that passes a number, a vector or a NumPy array of a type to a launch."""
    from taichi.lang.matrix import MatrixType
    from taichi.types import ndarray_type, primitive_types

    if isinstance(kind, ndarray_type.NdarrayType):
        return _array_setter(kind)
    if isinstance(kind, MatrixType):
        return lambda context, index, value: kind.set_kernel_struct_args(value, context, (index,))
    if id(kind) in primitive_types.real_type_ids:
        return lambda context, index, value: context.set_arg_float((index,), float(value))
    return lambda context, index, value: context.set_arg_int((index,), int(value))


def _array_setter(kind: Any) -> Any:
    from taichi.lang.matrix import MatrixType
    from taichi.lang.util import to_numpy_type

    inner = kind.dtype.get_shape() if isinstance(kind.dtype, MatrixType) else ()
    of = np.dtype(to_numpy_type(kind.dtype.dtype if inner else kind.dtype))
    outer = kind.ndim

    def put(context: Any, index: int, value: Any) -> None:
        shape = value.shape
        if (
            value.dtype != of
            or len(shape) != outer + len(inner)
            or shape[outer:] != inner
            or not value.flags.c_contiguous
        ):
            raise TypeError(
                f"argument {index}: {value.dtype} array {shape}, strides {value.strides}; it must"
                f" be contiguous {of} with {outer} dimensions of elements {inner}"
            )
        address = value.__array_interface__["data"][0]
        context.set_arg_external_array_with_shape((index,), address, value.nbytes, shape[:outer], 0)

    return put

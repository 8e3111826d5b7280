"""A kernel launched again and again with the same pack of arrays.

Taichi goes through every array of a pack twice at each launch, to see that their types are those it
compiled for and to hand over their addresses: half a millisecond, several times the substeps of a
small body.  Types and addresses stay, so here they are looked at once.
"""

from __future__ import annotations

from typing import Any


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

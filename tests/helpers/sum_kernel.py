"""A kernel that sums over a loop into one number of an array."""

from typing import Any

import taichi as ti


def sum_kernel() -> Any:
    """out[0] += 2 sum_i values[i], i < count."""
    numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)

    @ti.kernel
    def add(values: numbers, out: numbers, count: ti.i32):  # type: ignore[valid-type]
        ti.loop_config(serialize=True)
        for _ in range(2):
            for i in range(count):
                out[0] = out[0] + values[i]

    return add

"""Straight pieces of kernels, written by Python while a kernel is built.

Taichi walks through the syntax tree of a `ti.func` for every call of it and for every turn of a
loop that is unrolled, at every start, 7 us a node, although the cache holds the kernel.  A function
marked `unrolled` is not read but called, with Taichi's expressions as arguments, and its operators
write down the same statements in a fifth of the time.

What differs from a ti.func, where Taichi sees to it:

- an expression stands for itself and is written again wherever it is used; `let` makes a variable
  of it, worked out there and once;
- `put` changes such a variable, as `+=` and the like do; a bare `=` names another expression;
- loops and branches are Python's, over what is known while the kernel is built;
- memory is read by `at`, and written by `put` into what `at` gives.
"""

from collections.abc import Callable
from types import SimpleNamespace

from taichi.lang import impl


def unrolled(function: Callable) -> Callable:
    """Let kernels call a plain function: by Taichi's own mark of what it need not warn of."""
    function._is_taichi_function = True
    function.func = SimpleNamespace(has_print=False)
    return function


def let(x):
    """A variable that holds the expression x, or a list of them."""
    return impl.expr_init(x)


def put(variable, x):
    """variable = x."""
    variable._assign(x)


def at(array, n):
    """array[n]."""
    return impl.subscript(impl.get_runtime().compiling_callable.ast_builder(), array, n)

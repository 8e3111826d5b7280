"""Taichi's way from a kernel's source to its key in the cache on disk, without the detours.

That way is gone at every start, also where the cache holds all kernels.  What is replaced here
builds the same, to the bit of the key, and says the same where Taichi complains of a kernel:

- it words the position of every expression it meets, some 50,000 where loops are unrolled, with a
  copy of the source: here with file and line, and with the source only where something is wrong;
- it asks for the source of the frame in which a function is announced, which at the level of a
  module is the import system, and looking for it goes through all modules loaded: here it is one
  line of one file, or of none;
- it reads and parses a function's source anew for every call of it in a kernel, and splits it into
  tokens to see where it ends: here it is parsed once, up to the last line of its code;
- it gives every name a place of its own, and asks NumPy for the range of every number;
- it puts the name of what builds a node together at every node, and makes a dozen functions for
  every sum to choose one of: here that is looked up.

All of this replaces private parts of Taichi 1.7.4.  With any other version, or with the environment
variable `GF_USD_FAST_START=0`, nothing is replaced and only the start takes longer.  `quicken` and
`restore` are called by `taichi_runtime`.
"""

from __future__ import annotations

import ast
import gc
import importlib
import linecache
import operator
import os
import re
import sys
import textwrap
from collections.abc import Callable
from functools import cache, lru_cache, partial
from types import CodeType, ModuleType, SimpleNamespace
from typing import Any

VERSION = (1, 7, 4)  # of Taichi, whose private parts these are
SWITCH = "GF_USD_FAST_START"  # environment variable; "0" leaves Taichi as it is


Part = tuple[Any, str, Any, Any]  # owner, name, what Taichi has there, what replaces it

_replaced: list[Part] = []  # now


def quicken(taichi: ModuleType) -> None:
    """Replace the detours of an imported Taichi of this version, unless switched off."""
    if _replaced or taichi.__version__ != VERSION or os.environ.get(SWITCH) == "0":
        return
    for owner, name, _, new in _parts():
        setattr(owner, name, new)
    _replaced.extend(_parts())


def restore() -> None:
    """Give Taichi back what `quicken` replaced."""
    for owner, name, old, _ in _replaced:
        setattr(owner, name, old)
    _replaced.clear()


@cache
def _parts() -> tuple[Part, ...]:
    """All that is replaced, made once of Taichi as it was imported."""
    numbers: Any = importlib.import_module("taichi.lang.expr")
    words: Any = importlib.import_module("taichi.lang.ast.ast_transformer_utils")
    context = words.ASTTransformerContext
    transformer: Any = importlib.import_module("taichi.lang.ast.ast_transformer").ASTTransformer
    kernels: Any = importlib.import_module("taichi.lang.kernel_impl")
    trees = Trees(kernels.transform_tree)
    statements = tuple(kernels._KERNEL_CLASS_STACKFRAME_STMT_RES)
    ranges = ("_check_in_range", "_clamp_unsigned_to_range")
    new: tuple[tuple[Any, str, Any], ...] = (
        *((numbers, name, lru_cache(4096, typed=True)(getattr(numbers, name))) for name in ranges),
        (words.Builder, "__call__", _looked_up(words.Builder.__call__, context.get_pos_info)),
        (context, "get_pos_info", _briefly),
        (transformer, "build_Name", staticmethod(_named)),
        (transformer, "build_BinOp", staticmethod(_chosen(transformer.build_BinOp))),
        (kernels, "ast", SimpleNamespace(**{**vars(ast), "parse": trees.parse})),
        (kernels, "textwrap", SimpleNamespace(**{**vars(textwrap), "fill": _filled})),
        (kernels, "transform_tree", trees.transform),
        (kernels, "getsourcelines", cache(_up_to_its_end(kernels.getsourcelines))),
        (kernels, "getsourcefile", cache(kernels.getsourcefile)),
        (kernels, "_inside_class", asked_of_files(kernels._inside_class, statements)),
    )
    # as they stand in their owners: a static method is not what it looks up to
    return tuple((owner, name, vars(owner)[name], value) for owner, name, value in new)


def _briefly(self: Any, node: Any) -> str:
    """Where a node is, for an ASTTransformerContext: without its source, which few ask for."""
    function = self.func.func
    try:
        said_of, said = node.said
        if said_of is function:
            return said
    except AttributeError:
        pass
    line = node.lineno + self.lineno_offset
    said = f'File "{self.file}", line {line}, in {function.__name__}:\n'
    node.said = function, said
    return said


def asked_of_files(
    inside: Callable[[int], bool], words: tuple[re.Pattern[str], ...]
) -> Callable[[int], bool]:
    """`inside(level)`, whether the line that a frame is at begins with one of these words.

    False at once where the frame is of no file; else the line is looked up by the file's name,
    where `inside` looks for the module, and the files of all other modules on the way.
    """

    def inside_class(level_of_class_stackframe: int) -> bool:
        try:
            frame = sys._getframe(level_of_class_stackframe)
        except ValueError:  # a script's own level has nothing above it
            return False
        if frame.f_code.co_filename.startswith("<"):
            return False
        line = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
        if line and words:
            return any(word.match(line) for word in words)
        return inside(level_of_class_stackframe + 1)

    return inside_class


def _up_to_its_end(complete: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """`complete(function)`: its lines of source, and the number of the first."""

    def lines_of(function: Any) -> tuple[list[str], int]:
        code = getattr(function, "__code__", None)
        lines = linecache.getlines(code.co_filename) if isinstance(code, CodeType) else []
        if code is None or not lines or hasattr(function, "__wrapped__"):
            return complete(function)
        return lines[code.co_firstlineno - 1 : _last_line(code)], code.co_firstlineno

    return lines_of


def _last_line(code: CodeType) -> int:
    inner = [_last_line(one) for one in code.co_consts if isinstance(one, CodeType)]
    return max([code.co_firstlineno, *inner, *(place[1] or 0 for place in code.co_positions())])


def _looked_up(
    complete: Callable[[Any, Any, Any], Any], word: Callable[[Any, Any], str]
) -> Callable[[Any, Any, Any], Any]:
    """`complete(builder, context, node)`, which visits a node, and is left to say what went wrong.

    word : (context, node), where that is, with the source.
    """
    runtime = importlib.import_module("taichi.lang.impl").get_runtime
    known: dict[tuple[type, type], tuple[Any, bool]] = {}

    def build(self: Any, ctx: Any, node: Any) -> Any:
        kind = type(node)
        if (type(self), kind) not in known:
            method = getattr(self, f"build_{kind.__name__}", None)
            if method is None:
                return complete(self, ctx, node)
            known[type(self), kind] = method, issubclass(kind, ast.stmt | ast.expr)
        method, placed = known[type(self), kind]
        if kind is ast.Attribute:
            node.__dict__.pop("caller", None)  # of another visit of the tree
        stack = runtime().src_info_stack
        stack.append(ctx.get_pos_info(node) if placed else "")
        done = False
        try:
            made = method(ctx, node)
            done = True
        finally:
            stack.pop()
            error = None if done else sys.exception()
            if isinstance(error, Exception):  # goes on, with the place and in Taichi's words
                ctx.get_pos_info = partial(word, ctx)
                complete(_Failed(error), ctx, node)
        return made

    return build


class _Failed:
    """A builder whose every method raises this error."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def __getattr__(self, name: str) -> Any:
        def build(ctx: Any, node: Any) -> Any:
            raise self._error

        return build


def _named(ctx: Any, node: Any) -> Any:
    """What a name stands for; what is built of it says where it was built."""
    node.ptr = ctx.get_var_by_name(node.id)
    return node.ptr


SUMS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def _chosen(complete: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """`complete(context, node)` of a binary operation; sums and products without it."""
    build = importlib.import_module("taichi.lang.ast.ast_transformer").build_stmt
    wrong = importlib.import_module("taichi.lang.exception").TaichiTypeError

    def build_binary(ctx: Any, node: Any) -> Any:
        take = SUMS.get(type(node.op))
        if take is None:
            return complete(ctx, node)
        build(ctx, node.left)
        build(ctx, node.right)
        try:
            node.ptr = take(node.left.ptr, node.right.ptr)
        except TypeError as error:
            raise wrong(str(error)) from None
        return node.ptr

    return build_binary


class Trees:
    """Syntax trees of functions that one kernel calls, each parsed once.

    Taichi hangs what it makes of a node on the node.  So a tree serves one call at a time, and none
    stays when the kernel is done.

    transform : (tree, context), what Taichi does with a tree.
    """

    def __init__(self, transform: Callable[[Any, Any], Any]) -> None:
        self._transform, self._depth = transform, 0
        self._free: dict[str, list[ast.Module]] = {}

    def parse(self, source: str) -> ast.Module:
        """The tree of a function's source."""
        free = self._free.get(source)
        tree = free.pop() if free else ast.parse(source)
        tree.source = source  # pyright: ignore[reportAttributeAccessIssue]
        return tree

    def transform(self, tree: Any, ctx: Any) -> Any:
        """Do what Taichi does; then the tree is free for another call within the same kernel.

        No search for cycles meanwhile: it goes through all that a kernel is made of, which stays.
        """
        searches = self._depth == 0 and gc.isenabled()
        if searches:
            gc.disable()
        self._depth += 1
        try:
            result = self._transform(tree, ctx)
            # The arguments of these are cut off the tree.
            if not (ctx.is_kernel or ctx.is_real_function):
                self._free.setdefault(tree.source, []).append(tree)
        finally:
            self._depth -= 1
            if not self._depth:
                self._free.clear()
            if searches:
                gc.enable()
        return result


def _filled(text: str, **how: Any) -> str:
    """`textwrap.fill`, for whose widths a line of source is short."""
    line = text.rstrip()
    if len(line) < how["width"] and line.isprintable():
        return line
    return textwrap.fill(text, **how)

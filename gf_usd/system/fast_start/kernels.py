"""Faster lookup of Taichi's compiled kernels: from a kernel's source to its key in the disk cache.

Taichi computes the key at every start, even if the cache has all kernels.  The replacements here
compute the same key, bit by bit, and give the same error messages.  Taichi 1.7.4

- formats the position of every expression with a copy of the source, some 50,000 with unrolled
loops; here with file and line, and with the source only for an error;
- looks up the source of the frame that registers a function, which at module level is the import
system, and searches all loaded modules for it; here it reads one line of the file, if there is one;
- reads and parses a function's source for every call of it in a kernel, and tokenizes it to find
its end; here it is parsed once, up to the last line of its code;
- attaches debug information to every name, and queries NumPy for the range of every number;
- composes the name of the method that builds each node, and creates a dozen functions per sum to
choose one; here they are looked up in a table;
- formats the stack with its source at each array, for a warning about arrays of more than 2^31
numbers; here with file and line.

The replacements are of private parts of Taichi 1.7.4.  With any other version, or with the
environment variable `GF_USD_FAST_START=0`, nothing is replaced and only the start takes longer.
`install_replacements` and `remove_replacements` are called by `taichi_runtime`.
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

from gf_usd.core import FAST_START

VERSION = (1, 7, 4)  # of Taichi, for which the replacements are valid


Replacement = tuple[Any, str, Any, Any]  # owner, attribute, Taichi's value, its replacement

_replaced: list[Replacement] = []  # installed now


def install_replacements(taichi: ModuleType) -> None:
    """Replace parts of an imported Taichi of this version, unless switched off."""
    if _replaced or taichi.__version__ != VERSION or os.environ.get(FAST_START) == "0":
        return
    for owner, name, _, new in _replacements():
        setattr(owner, name, new)
    _replaced.extend(_replacements())


def remove_replacements() -> None:
    """Restore Taichi's own functions."""
    for owner, name, old, _ in _replaced:
        setattr(owner, name, old)
    _replaced.clear()


@cache
def _replacements() -> tuple[Replacement, ...]:
    """All replacements, made once from Taichi as it was imported."""
    numbers: Any = importlib.import_module("taichi.lang.expr")
    utils: Any = importlib.import_module("taichi.lang.ast.ast_transformer_utils")
    context = utils.ASTTransformerContext
    transformer: Any = importlib.import_module("taichi.lang.ast.ast_transformer").ASTTransformer
    kernels: Any = importlib.import_module("taichi.lang.kernel_impl")
    trees = SyntaxTrees(kernels.transform_tree)
    statements = tuple(kernels._KERNEL_CLASS_STACKFRAME_STMT_RES)
    ranges = ("_check_in_range", "_clamp_unsigned_to_range")
    arrays = [importlib.import_module(f"taichi.lang.{name}") for name in ("_ndarray", "matrix")]
    new: tuple[tuple[Any, str, Any], ...] = (
        *((numbers, name, lru_cache(4096, typed=True)(getattr(numbers, name))) for name in ranges),
        *((module, "get_traceback", _short_traceback) for module in arrays),
        (
            utils.Builder,
            "__call__",
            _fast_builder_call(utils.Builder.__call__, context.get_pos_info),
        ),
        (context, "get_pos_info", _short_position),
        (transformer, "build_Name", staticmethod(_fast_build_name)),
        (transformer, "build_BinOp", staticmethod(_fast_build_binary(transformer.build_BinOp))),
        (kernels, "ast", SimpleNamespace(**{**vars(ast), "parse": trees.parse})),
        (kernels, "textwrap", SimpleNamespace(**{**vars(textwrap), "fill": _fast_fill})),
        (kernels, "transform_tree", trees.transform),
        (kernels, "getsourcelines", cache(_fast_source_lines(kernels.getsourcelines))),
        (kernels, "getsourcefile", cache(kernels.getsourcefile)),
        (kernels, "_inside_class", faster_inside_class(kernels._inside_class, statements)),
    )
    # Taichi's values from the owner's dict, because attribute access unwraps static methods
    return tuple((owner, name, vars(owner)[name], value) for owner, name, value in new)


def _short_position(self: Any, node: Any) -> str:
    """Position of a node for an ASTTransformerContext, without its source, which is rarely
    needed.
    """
    function = self.func.func
    try:
        location_of, location = node.location
        if location_of is function:
            return location
    except AttributeError:
        pass
    line = node.lineno + self.lineno_offset
    location = f'File "{self.file}", line {line}, in {function.__name__}:\n'
    node.location = function, location
    return location


def _short_traceback(stacklevel: int = 1) -> str:
    """Files and lines of the calls above the caller, the latest last, without their source."""
    lines, frame = [], sys._getframe(stacklevel + 1)
    while frame is not None:
        code = frame.f_code
        lines.append(f'  File "{code.co_filename}", line {frame.f_lineno}, in {code.co_name}\n')
        frame = frame.f_back
    return "".join(reversed(lines))


def faster_inside_class(
    inside: Callable[[int], bool], patterns: tuple[re.Pattern[str], ...]
) -> Callable[[int], bool]:
    """A faster `inside(level)`: whether the line at a frame matches one of the patterns `words`.

    False at once where the frame has no file.  Otherwise the line is looked up by file name;
    `inside` searches for the module, and on the way through the files of all other modules.
    """

    def inside_class(level_of_class_stackframe: int) -> bool:
        try:
            frame = sys._getframe(level_of_class_stackframe)
        except ValueError:  # the top level of a script has no frame above it
            return False
        if frame.f_code.co_filename.startswith("<"):
            return False
        line = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
        if line and patterns:
            return any(word.match(line) for word in patterns)
        return inside(level_of_class_stackframe + 1)

    return inside_class


def _fast_source_lines(complete: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A faster `complete(function)`: its lines of source, and the number of the first."""

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


def _fast_builder_call(
    complete: Callable[[Any, Any, Any], Any], word: Callable[[Any, Any], str]
) -> Callable[[Any, Any, Any], Any]:
    """A faster `complete(builder, context, node)`, which visits a node and reports errors by
    `complete`.

    word : (context, node), the position with the source.
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
            node.__dict__.pop("caller", None)  # of an earlier visit of the tree
        stack = runtime().src_info_stack
        stack.append(ctx.get_pos_info(node) if placed else "")
        done = False
        try:
            made = method(ctx, node)
            done = True
        finally:
            stack.pop()
            error = None if done else sys.exception()
            if isinstance(error, Exception):  # re-raised with the position, by Taichi's own code
                ctx.get_pos_info = partial(word, ctx)
                complete(_RaisingBuilder(error), ctx, node)
        return made

    return build


class _RaisingBuilder:
    """A builder of which every method raises the given error."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def __getattr__(self, name: str) -> Any:
        def build(ctx: Any, node: Any) -> Any:
            raise self._error

        return build


def _fast_build_name(ctx: Any, node: Any) -> Any:
    """The value of a name, without debug information, which expressions built from it have."""
    node.ptr = ctx.get_var_by_name(node.id)
    return node.ptr


SUMS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def _fast_build_binary(complete: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """A faster `complete(context, node)` of a binary operation, for SUMS."""
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


class SyntaxTrees:
    """Syntax trees of functions that a kernel calls, each parsed once.

    Taichi stores results in the nodes of a tree.  A tree is therefore used by one call at a time,
    and discarded at the end of the kernel.

    transform : (tree, context), Taichi's transformation of a tree.
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
        """Transform a tree as Taichi does; it is then free for another call within the same kernel.

        Garbage collection is disabled meanwhile, since it would traverse all objects of the kernel,
        none of which are garbage.
        """
        searches = self._depth == 0 and gc.isenabled()
        if searches:
            gc.disable()
        self._depth += 1
        try:
            result = self._transform(tree, ctx)
            # Taichi removes the arguments of these from the tree.
            if not (ctx.is_kernel or ctx.is_real_function):
                self._free.setdefault(tree.source, []).append(tree)
        finally:
            self._depth -= 1
            if not self._depth:
                self._free.clear()
            if searches:
                gc.enable()
        return result


def _fast_fill(text: str, **how: Any) -> str:
    """`textwrap.fill`, with a shortcut for lines that are shorter than the width."""
    line = text.rstrip()
    if len(line) < how["width"] and line.isprintable():
        return line
    return textwrap.fill(text, **how)

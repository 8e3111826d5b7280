"""Taichi's way from a kernel's source to its key in the cache on disk, without the detours.

That way is gone at every start, also where the cache holds all kernels.  What is replaced here
builds the same, to the bit of the key, and says the same where Taichi complains:

- it words the position of every expression it meets, some 50,000 where loops are unrolled, and
  breaks the lines at 80 columns: here a position is worded once, and a line stays whole;
- it asks for the source of the frame in which a function is announced, which at the level of a
  module is the import system, and looking for it goes through all modules loaded: here it is one
  line of one file, or of none;
- it reads a function's source anew for every call of it in a kernel.

Where a version of Taichi has no such part, that part is left alone.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import linecache
import os
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from types import ModuleType
from typing import Any

VERSION_CHECK = "taichi._version_check"


class _Whole:
    """In place of textwrap.TextWrapper: a line stays one line."""

    def __init__(self, width: int) -> None:
        pass

    def wrap(self, text: str) -> list[str]:
        return [text.rstrip()] if text.strip() else []


@contextlib.contextmanager
def frames_without_source() -> Iterator[None]:
    """While Taichi is imported: no search for the source of frames that have none.

    Nor is its version check imported where it is switched off: that loads what talks to a network.
    """
    complete = inspect.getframeinfo

    def quick(frame: Any, context: int = 1) -> Any:
        if inspect.isframe(frame) and frame.f_code.co_filename.startswith("<"):
            code = frame.f_code
            return inspect.Traceback(code.co_filename, frame.f_lineno, code.co_name, None, None)
        return complete(frame, context)

    inspect.getframeinfo = quick
    unchecked = os.environ.get("TI_SKIP_VERSION_CHECK") == "ON" and VERSION_CHECK not in sys.modules
    if unchecked:
        nothing = ModuleType(VERSION_CHECK)
        nothing.start_version_check_thread = lambda: None
        sys.modules[VERSION_CHECK] = nothing
    try:
        yield
    finally:
        inspect.getframeinfo = complete
        if unchecked:
            del sys.modules[VERSION_CHECK]


def quicken() -> None:
    """Replace the detours of an imported Taichi."""
    words = importlib.import_module("taichi.lang.ast.ast_transformer_utils")
    if hasattr(words, "TextWrapper"):
        words.TextWrapper = _Whole  # pyright: ignore[reportAttributeAccessIssue]
    context: Any = getattr(words, "ASTTransformerContext", None)
    if hasattr(context, "get_pos_info"):
        context.get_pos_info = _once_worded(context.get_pos_info)
    kernels = importlib.import_module("taichi.lang.kernel_impl")
    for name in ("getsourcelines", "getsourcefile"):
        if hasattr(kernels, name):
            setattr(kernels, name, cache(getattr(kernels, name)))
    if hasattr(kernels, "_inside_class"):
        words = tuple(getattr(kernels, "_KERNEL_CLASS_STACKFRAME_STMT_RES", ()))
        kernels._inside_class = _asked_of_files(kernels._inside_class, words)


def _once_worded(word: Callable[[Any, Any], str]) -> Callable[[Any, Any], str]:
    """`word(context, node)`, remembered by function and place."""
    known: dict[tuple[Any, ...], str] = {}

    def position(self: Any, node: Any) -> str:
        place = (
            *(self.func.func, type(node), node.lineno, node.col_offset),
            *(node.end_lineno, node.end_col_offset),
        )
        if place not in known:
            known[place] = word(self, node)
        return known[place]

    return position


def _asked_of_files(
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

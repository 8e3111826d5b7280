"""Taichi imported without what it loads for others: prompts, networks, searches for source."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

VERSION_CHECK = "taichi._version_check"  # loads what talks to a network
PROMPT = "dill"  # finds the source of what was typed at a prompt


@contextlib.contextmanager
def leanly() -> Iterator[None]:
    """While Taichi is imported.

    No search for the source of frames that have none, which goes through all modules; no version
    check where it is switched off; and `dill` is loaded when something of it is asked for.
    """
    complete = inspect.getframeinfo

    def quick(frame: Any, context: int = 1) -> Any:
        if inspect.isframe(frame) and frame.f_code.co_filename.startswith("<"):
            code = frame.f_code
            return inspect.Traceback(code.co_filename, frame.f_lineno, code.co_name, None, None)
        return complete(frame, context)

    instead = {PROMPT: _loaded_when_asked(PROMPT)}
    if os.environ.get("TI_SKIP_VERSION_CHECK") == "ON":
        instead[VERSION_CHECK] = nothing = ModuleType(VERSION_CHECK)
        nothing.start_version_check_thread = lambda: None
    instead = {name: module for name, module in instead.items() if name not in sys.modules}
    inspect.getframeinfo = quick
    sys.modules.update(instead)
    try:
        yield
    finally:
        inspect.getframeinfo = complete
        for name in instead:
            del sys.modules[name]


def _loaded_when_asked(name: str) -> ModuleType:
    """A module that passes on what is asked of it, but for what a search of modules asks."""
    module = ModuleType(name)

    def ask(attribute: str) -> Any:
        if attribute.startswith("__"):
            raise AttributeError(attribute)
        return getattr(importlib.import_module(name), attribute)

    module.__getattr__ = ask
    return module

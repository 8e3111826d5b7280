"""Faster imports of Taichi and SciPy, without parts that no command uses.

- Taichi registers 93 functions of its own, and searches all loaded modules for the frame of each.
With a thousand modules this takes a third of a CPU second, more than the rest of the import.
- It imports dill, for functions defined at an interactive prompt, and its check for a new version.
- SciPy's view of NumPy, which `scipy.sparse` imports, reads all attributes of NumPy, which imports
its lazy modules: f2py, its tests, masked arrays; 0.08 CPU seconds.

Skipped modules are imported on first use.  The environment variable `GF_USD_FAST_START=0` disables
all of this; only the start then takes longer.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from importlib.abc import Loader
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any

from gf_usd.core import FAST_START
from gf_usd.system.fast_start.kernels import VERSION, faster_inside_class

KERNELS = "taichi.lang.kernel_impl"
LAZY = ("dill", "taichi._version_check")  # modules
SKIP = "TI_SKIP_VERSION_CHECK"  # environment variable of Taichi
VIEW = "scipy._lib.array_api_compat.numpy"

Loads = Callable[[Any, Callable[[], None]], None]  # with a module, and what executes it


@contextlib.contextmanager
def quick_import() -> Iterator[None]:
    """Within the block, Taichi is imported faster, if its version is that of `kernels`."""
    if os.environ.get(FAST_START) == "0" or "taichi" in sys.modules or not _is_supported_version():
        yield
        return
    restore: list[Callable[[], None]] = []

    def announce(module: Any, execute: Callable[[], None]) -> None:
        execute()
        old = module._inside_class
        patterns = tuple(module._KERNEL_CLASS_STACKFRAME_STMT_RES)
        module._inside_class = faster_inside_class(old, patterns)
        restore.append(lambda: setattr(module, "_inside_class", old))

    lazy = [name for name in LAZY if name not in sys.modules]
    finder = _Finder({KERNELS: announce}, lazy)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in lazy:
            if isinstance(sys.modules.get(name), _LazyModule):
                package, _, own = name.rpartition(".")
                vars(sys.modules.get(package)).pop(own, None) if package else None
                del sys.modules[name]
        for put_back in restore:
            put_back()


def install() -> None:
    """Make a later import of SciPy's view of NumPy faster in this process."""
    if VIEW not in sys.modules and os.environ.get(FAST_START) != "0":
        sys.meta_path.insert(0, _Finder({VIEW: _view}, ()))


def _is_supported_version() -> bool:
    """Whether the installed version of Taichi is VERSION, from its package metadata."""
    found = PathFinder.find_spec("taichi")
    known = f"taichi-{'.'.join(map(str, VERSION))}.dist-info"
    folders = (found.submodule_search_locations or ()) if found else ()
    return any(os.path.isdir(os.path.join(os.path.dirname(one), known)) for one in folders)


def _view(module: Any, execute: Callable[[], None]) -> None:
    """Execute SciPy's view of NumPy with the attributes that NumPy has loaded; others are lazy."""
    maker: Any = importlib.import_module("scipy._lib.array_api_compat._internal")
    complete = getattr(maker, "clone_module", None)

    def clone(name: str, names: dict[str, Any]) -> list[str]:
        seen = importlib.import_module(name)
        public = {key: value for key, value in vars(seen).items() if not key.startswith("_")}
        names.update(public, __getattr__=lambda key: getattr(seen, key))
        return list(public)

    if complete is not None:
        maker.clone_module = clone
    try:
        execute()
    finally:
        if complete is not None:
            maker.clone_module = complete


class _Finder:
    """Finds the modules of `loads`, with their loaders, and the lazy modules."""

    def __init__(self, loads: dict[str, Loads], lazy: Any) -> None:
        self._loads, self._lazy = loads, lazy
        self._thread = threading.get_ident()  # other threads import the lazy modules as usual

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder`; None for all other modules."""
        if name in self._lazy and threading.get_ident() == self._thread:
            return ModuleSpec(name, _LazyLoader())
        found = PathFinder.find_spec(name, path, target) if name in self._loads else None
        if found is None or not isinstance(found.loader, SourceFileLoader):
            return None
        found.loader = _Loader(found.loader.name, found.loader.path, self._loads[name])
        return found


class _Loader(SourceFileLoader):
    """Loads a module with a given function."""

    def __init__(self, name: str, path: str, load: Loads) -> None:
        super().__init__(name, path)
        self._load = load

    def exec_module(self, module: Any) -> None:
        """See `importlib.abc.Loader`."""
        self._load(module, lambda: super(_Loader, self).exec_module(module))


class _LazyModule(ModuleType):
    """A placeholder for a module, which is imported on first access to an attribute."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # read of every module
            raise AttributeError(name)
        return getattr(importlib.import_module(self.__name__), name)


def _check_version() -> None:
    if os.environ.get(SKIP) != "ON":
        importlib.import_module("taichi._version_check").start_version_check_thread()


class _LazyLoader(Loader):
    """Creates a `_LazyModule`."""

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """See `importlib.abc.Loader`."""
        made = _LazyModule(spec.name)
        if spec.name == "taichi._version_check":
            made.start_version_check_thread = _check_version  # called at each start of Taichi
        return made

    def exec_module(self, module: ModuleType) -> None:
        """See `importlib.abc.Loader`."""

"""Imports of Taichi and SciPy, without what no command has a use for.

- Taichi announces 93 functions of its own, and searches through all modules for the frame of each:
  a third of a CPU second where a thousand are loaded, more than the rest of its import.
- It imports dill for functions that are typed at a prompt, and what asks the network for a newer
  version of it.
- SciPy's view of NumPy, which `scipy.sparse` imports, asks NumPy for all of its names, and thereby
  imports what NumPy leaves until it is asked for: f2py, its tests, masked arrays; 0.08 CPU seconds.

Nothing that is left out is missing: it is imported when it is asked for.  The environment variable
`GF_USD_FAST_START=0` switches all of this off, and only the start takes longer.
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

from gf_usd.system.fast_start.kernels import SWITCH, VERSION, asked_of_files

KERNELS = "taichi.lang.kernel_impl"
LATER = ("dill", "taichi._version_check")  # modules
SKIP = "TI_SKIP_VERSION_CHECK"  # environment variable of Taichi
VIEW = "scipy._lib.array_api_compat.numpy"

Loads = Callable[[Any, Callable[[], None]], None]  # with a module, and what executes it


@contextlib.contextmanager
def quick_import() -> Iterator[None]:
    """Within the block Taichi, of the version that `kernels` knows, is imported quickly."""
    if os.environ.get(SWITCH) == "0" or "taichi" in sys.modules or not _is_known():
        yield
        return
    restore: list[Callable[[], None]] = []

    def announce(module: Any, execute: Callable[[], None]) -> None:
        execute()
        old = module._inside_class
        words = tuple(module._KERNEL_CLASS_STACKFRAME_STMT_RES)
        module._inside_class = asked_of_files(old, words)
        restore.append(lambda: setattr(module, "_inside_class", old))

    later = [name for name in LATER if name not in sys.modules]
    finder = _Finder({KERNELS: announce}, later)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in later:
            if isinstance(sys.modules.get(name), _Later):
                package, _, own = name.rpartition(".")
                vars(sys.modules.get(package)).pop(own, None) if package else None
                del sys.modules[name]
        for put_back in restore:
            put_back()


def install() -> None:
    """Have SciPy's view of NumPy imported quickly in this process, whenever it is."""
    if VIEW not in sys.modules and os.environ.get(SWITCH) != "0":
        sys.meta_path.insert(0, _Finder({VIEW: _view}, ()))


def _is_known() -> bool:
    """Whether the version of Taichi that would be imported is VERSION, by what pip wrote of it."""
    found = PathFinder.find_spec("taichi")
    known = f"taichi-{'.'.join(map(str, VERSION))}.dist-info"
    folders = (found.submodule_search_locations or ()) if found else ()
    return any(os.path.isdir(os.path.join(os.path.dirname(one), known)) for one in folders)


def _view(module: Any, execute: Callable[[], None]) -> None:
    """Execute SciPy's view of NumPy, which has what NumPy has loaded, and asks it for the rest."""
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
    """Finds the modules of `loads`, each loaded by what stands there, and those of `later`."""

    def __init__(self, loads: dict[str, Loads], later: Any) -> None:
        self._loads, self._later = loads, later
        self._thread = threading.get_ident()  # others import what `later` names as ever

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder`; None for all other modules."""
        if name in self._later and threading.get_ident() == self._thread:
            return ModuleSpec(name, _Postponed())
        found = PathFinder.find_spec(name, path, target) if name in self._loads else None
        if found is None or not isinstance(found.loader, SourceFileLoader):
            return None
        found.loader = _Loader(found.loader.name, found.loader.path, self._loads[name])
        return found


class _Loader(SourceFileLoader):
    """Loads a module by `load`."""

    def __init__(self, name: str, path: str, load: Loads) -> None:
        super().__init__(name, path)
        self._load = load

    def exec_module(self, module: Any) -> None:
        """See `importlib.abc.Loader`."""
        self._load(module, lambda: super(_Loader, self).exec_module(module))


class _Later(ModuleType):
    """Stands for a module of its name, which is imported when something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # asked of every module
            raise AttributeError(name)
        return getattr(importlib.import_module(self.__name__), name)


def _check_version() -> None:
    if os.environ.get(SKIP) != "ON":
        importlib.import_module("taichi._version_check").start_version_check_thread()


class _Postponed(Loader):
    """Makes a `_Later`."""

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """See `importlib.abc.Loader`."""
        made = _Later(spec.name)
        if spec.name == "taichi._version_check":
            made.start_version_check_thread = _check_version  # whenever Taichi is started
        return made

    def exec_module(self, module: ModuleType) -> None:
        """See `importlib.abc.Loader`."""

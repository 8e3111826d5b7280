"""Calls from another program, the host: a notebook, a DCC, a daemon.

The program may have opened stages before, which makes it too late to register the schema, or may
use Taichi itself, which can run only once in a process, or have forked this process from one that
used it.  Code that writes or checks layers, or computes with Taichi, then runs in a separate
process.  This process is left as it was: no signal handlers, log settings or environment variables
are changed, and nothing in Taichi is replaced.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from gf_usd.core.errors import UsageError
from gf_usd.system.atomic_files import require_working_folder
from gf_usd.system.taichi_runtime import FORKED, SPAWN, as_guest, is_forked, is_started_by_host

# Taichi, and USD's registry of schemas, are the process's: calls of several threads take turns.
_TURN = threading.RLock()
TAKEN = "another part of this program already runs Taichi"


@contextmanager
def guest() -> Iterator[None]:
    """Have its turn, and leave Taichi as it was."""
    require_working_folder()
    with _TURN, as_guest():
        yield


def why_separate(*, schema: bool = True) -> str:
    """Text on why a call cannot run in this process; "" if it can.

    schema : it applies or checks the APIs of gaussianFlesh.
    """
    if is_forked():
        return FORKED
    if is_started_by_host():
        return TAKEN
    if schema:
        from gf_usd.system import usd_schema

        if usd_schema.LATE is not None:
            return "USD read its schema definitions before gf-usd was loaded"
    return ""


def run_here_or_separately(
    task: str,
    options: Mapping[str, Any],
    progress: Callable[[int, int], None] | None = None,
    *,
    schema: bool = True,
) -> tuple[Any, str]:
    """The result of a function, and why it ran in a separate process; "" if it ran in this one.

    task : the function, as "module:name"; it takes `progress` where that is given.
    """
    with guest():
        why = why_separate(schema=schema)
        if not why:
            module, name = task.split(":")
            more = {} if progress is None else {"progress": progress}
            return getattr(import_module(module), name)(**options, **more), ""
    from gf_usd.api.host.own_process import call

    return call(task, options, progress), why


def require_this_process(what: str) -> None:
    """Raise UsageError where a function that returns its solver cannot run in this process."""
    if is_forked():
        raise UsageError(f"{FORKED}: {what} needs it", SPAWN)
    if is_started_by_host():
        raise UsageError(
            f"{TAKEN}, and a process can run it only once: {what} would end that computation",
            "call it in a separate process (multiprocessing with the spawn method), or before "
            "the other part starts Taichi; gf_usd.bake starts a process itself",
        )

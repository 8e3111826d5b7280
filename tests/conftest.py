"""Set-up of every test process."""

from __future__ import annotations

import gc
import os
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

# USD reads its schemas once: whichever test comes first, ours must be known before a stage opens.
import gf_usd.system.usd_schema  # noqa: F401
from gf_usd.system.fast_start.imports import quick_import
from gf_usd.system.fast_start.kernels import install_replacements, remove_replacements
from gf_usd.system.taichi_runtime import MERGE_OPTIONS, import_taichi

TESTS = Path(__file__).parent
LONG = {  # few tests that take half a minute and more of CPU time together
    "analytic/test_solvers_agree.py",
    "analytic/test_verify.py",
    "analytic/test_verify_mutations.py",
    "api/test_host.py",
    "cli/test_batch_openjd.py",
    "cli/test_fit_cli.py",
    "cli/test_mixed_cli.py",
    "documents/test_tutorials.py",
    "physics/total_lagrangian/kernels/test_cell.py",
    "pipeline/test_conversion.py",
    "pipeline/test_law_with_a_history.py",
    "pipeline/test_mixed.py",
}
# Two hundred programs are started: each would compile the package again, a quarter of its time.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_configure(config: pytest.Config) -> None:
    """Unless the acceptance is selected: compile kernels quickly, and give each process its cores.

    With `without_common_subexpressions`, a kernel of the Total Lagrangian solver takes 2 CPU
    seconds to compile, not 7, and results are the same to the bit.  Programs that tests start have
    the kernels of users, and so have all tests where `-m` does not leave out the acceptance.
    `tests/physics/total_lagrangian/test_merging.py` compares the two.

    The threads of a kernel wait for each other: where two processes share two cores, one with two
    threads took seventy times as long as it does alone.  The default number of threads is that of
    the process's share of the cores then, one of two: tests of more state the number.
    """
    if "not acceptance" not in config.option.markexpr:
        return
    MERGE_OPTIONS[True] = MERGE_OPTIONS[False]
    worker = getattr(config, "workerinput", None)
    if worker is None or not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) >= worker["workercount"]:
        mine = int(worker["workerid"][2:]) % worker["workercount"]
        os.sched_setaffinity(0, set(cores[mine :: worker["workercount"]]))


@pytest.hookimpl(hookwrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Import the tests, where this process does, without what takes a third of that time.

    Taichi searches through all modules for each of its functions and ours, and Python for garbage.
    """
    hands_over = session.config.getoption("numprocesses", None)
    if hands_over and not hasattr(session.config, "workerinput"):
        yield
        return
    gc.disable()
    with quick_import():
        import taichi
    install_replacements(taichi)
    yield
    remove_replacements()
    gc.enable()


@pytest.hookimpl(trylast=True)  # when those that do not run are left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run together, in each module, what needs Taichi started alike; the longest modules first.

    Another precision or number of threads starts it anew, and all kernels are built again.  The
    last module runs in one process, and the other one waits.
    """
    tests = Counter(item.path for item in items)
    place = {path: at for at, path in enumerate(tests)}

    def order(path: Path) -> tuple[bool, int, int]:
        """The modules of LONG first, the others by the number of their tests."""
        name = Path(os.path.relpath(path, TESTS)).as_posix()  # may be outside of them
        return name not in LONG, -tests[path], place[path]

    def started(item: pytest.Item) -> tuple[int, int]:
        """Single precision, what the module has by default, double precision; and the threads."""
        callspec = getattr(item, "callspec", None)
        if callspec is None:
            return 0, 0
        bits = re.search(r"f(?:loat)?(32|64)", callspec.id)
        return {"32": -1, "64": 1}[bits[1]] if bits else 0, callspec.params.get("threads", 0)

    items.sort(key=lambda item: (*order(item.path), *started(item)))


def pytest_collection_finish() -> None:
    """Leave what is loaded by now out of the searches for garbage: each start of Taichi has two."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup() -> None:
    """Compile the kernels of a test as those of a bake are: faster by a third.

    A function of the package removes the replacements in Taichi as it ends, and a test after it
    that launches kernels itself, with Taichi running already, would do without.
    """
    import_taichi()


@pytest.fixture
def monkeypatch(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """pytest's, which also checks that no module keeps a function of a test for those that follow.

    A module that is first imported while a function is replaced, and that imports it by name, has
    the replacement for the rest of the process.
    """
    before = set(sys.modules)
    yield monkeypatch
    monkeypatch.undo()
    loaded = [name for name in set(sys.modules) - before if name.startswith("gf_usd")]
    kept = [
        f"{module}.{name}"
        for module in loaded
        for name, value in vars(sys.modules[module]).items()
        if str(TESTS) in getattr(getattr(value, "__code__", None), "co_filename", "")
    ]
    assert not kept, f"imported with replacements of this test: {kept}; import it before"


@pytest.fixture(scope="module")
def small_pictures() -> Iterator[None]:
    """Coarse shadows and small pictures of reports, where tests look at neither.

    They are most of the time of a small picture.  The tests of `view/render` have the maps of
    users.
    """
    from gf_usd.view.render import surfaces
    from gf_usd.view.report import moments

    with pytest.MonkeyPatch.context() as patch:
        for name in ("KEY_TEXELS", "DOME_TEXELS", "FLOOR_TEXELS"):
            patch.setattr(surfaces, name, getattr(surfaces, name) // 8)
        patch.setattr(moments, "SIZE", tuple(edge // 4 for edge in moments.SIZE))
        yield


@pytest.fixture(scope="module")
def coarse_volumes() -> Iterator[None]:
    """A tenth of the sample points for volumes of meshes that overlap, 20,000 of them.

    They are a third of the time of tests that fill such meshes.  Volumes differ by less than 0.5 %;
    `geometry/test_solid.py` has the sample points of users.
    """
    from gf_usd.geometry import solid

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solid, "PROBES", solid.PROBES // 10)
        yield


def pytest_unconfigure() -> None:
    """Let the end of the process find them again, in the order that Taichi's arrays need."""
    gc.unfreeze()

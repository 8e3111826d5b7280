"""The end of the program leaves out nothing but the freeing of memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gf_usd.cli import exit

SCRIPT = """
import atexit, sys, threading, time
from gf_usd.cli.exit import leave, prepare_to_leave
prepare_to_leave()
atexit.register(print, "last words")
{more}
sys.stdout.write("no newline yet ")
leave({status})
"""

# A thread that has to be waited for, as the workers of a pool are.
WORKER = 'threading.Thread(target=lambda: (time.sleep(0.2), print("worked "))).start()'


def end(status: int, more: str = "") -> subprocess.CompletedProcess[str]:
    code = SCRIPT.format(status=status, more=more)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("status", [0, 3, 143])
def test_what_was_said_is_heard_and_the_status_is_kept(status: int) -> None:
    done = end(status)
    assert done.stdout == "no newline yet last words\n"
    assert done.stderr == ""
    assert done.returncode == status


def test_a_thread_that_is_no_daemon_is_waited_for() -> None:
    done = end(4, WORKER)
    assert done.stdout.replace("\n", "") == "no newline yet worked last words"
    assert done.returncode == 4


def test_a_full_disk_is_not_passed_over() -> None:
    """Python ends with 120 where it cannot write what is left of its output."""
    if not Path("/dev/full").exists():
        pytest.skip("this system has no device that is always full")
    code = "from gf_usd.cli.exit import leave, prepare_to_leave\nprepare_to_leave()\n"
    code += "import sys\nsys.stdout = open(1, 'w')\nprint('no room for this')\nleave(0)"
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", code], stdout=full, check=False)
    assert done.returncode == 120


@pytest.mark.slow
def test_kernels_that_were_compiled_are_kept(tmp_path: Path) -> None:
    code = """
import taichi as ti
ti.init(arch=ti.cpu, log_level=ti.ERROR)
@ti.kernel
def twice(x: ti.f32) -> ti.f32:
    return 2.0 * x
twice(2.0)
from gf_usd.cli.exit import leave, prepare_to_leave
prepare_to_leave()
leave(0)
"""
    (tmp_path / "program.py").write_text(code)
    cache = tmp_path / "cache"
    ended = subprocess.run(
        [sys.executable, str(tmp_path / "program.py")],
        env={**os.environ, "TI_OFFLINE_CACHE": "1", "TI_OFFLINE_CACHE_FILE_PATH": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert list(cache.rglob("*.tic"))


def test_an_interrupt_tells_of_partial_files_where_there_are_some(tmp_path: Path) -> None:
    root = tmp_path / "duck[1].usda"
    exit.watch((), root)
    try:
        assert exit.message() == ""
        (tmp_path / "duck1.cache.partial.usdc").touch()
        root.touch()
        assert exit.message() == ""
        (tmp_path / "duck[1].cache").mkdir()
        (tmp_path / "duck[1].cache" / "0001.partial.usdc").touch()
        assert exit.message() == "only *.partial.* files remain"
        checkpoint = tmp_path / "duck[1].checkpoint.npz"
        checkpoint.touch()
        exit.watch((checkpoint,), root)
        assert "with --resume continues" in exit.message()
    finally:
        exit.watch(())
    assert exit.message() == ""


# A signal as USD is imported, which continues after an exception in the middle of it.
EARLY = """
import signal, sys, time
from gf_usd.cli import main

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "pxr.Gf":
            signal.raise_signal({number})

def hold():
    import pxr.Usd
    time.sleep(20.0)

sys.meta_path.insert(0, Finder())
main.COMMANDS["hold"] = (hold, {{}})
sys.argv = ["gf-usd", "hold"]
main.run()
"""


@pytest.mark.parametrize(("number", "message"), [(2, "interrupted"), (15, "terminated")])
def test_an_interrupt_of_the_import_of_usd_is_not_lost(
    tmp_path: Path, number: int, message: str
) -> None:
    code = EARLY.format(number=number)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.stderr == f"{message}\n"
    assert done.returncode == 128 + number


def test_memory_is_left_to_the_system() -> None:
    freed = "class Held:\n    def __del__(self): print('freed')\nheld = Held()"
    assert "freed" not in end(0, freed).stdout


def test_an_error_that_was_not_foreseen_ends_as_ever() -> None:
    done = end(0, "raise RuntimeError('what is this')")
    assert done.returncode == 1
    assert "RuntimeError: what is this" in done.stderr
    assert done.stdout == "last words\n"

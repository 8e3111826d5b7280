"""A child that crashes, hangs, exhausts memory or fails is reported; its files are removed."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
import trimesh

from gf_usd.core.errors import InputError, UsageError
from gf_usd.pipeline.inspect import inspect
from gf_usd.pipeline.prepared import prepare
from gf_usd.readers.isolated import Reading, read_untrusted
from gf_usd.system import exchange
from gf_usd.system.sandbox import Isolated, Limits, parse_limits, run_isolated

pytestmark = pytest.mark.skipif(os.name != "posix", reason="nothing is isolated here")


TETRAHEDRON = """#usda 1.0
def Mesh "Body" {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    int[] faceVertexCounts = [3, 3, 3, 3]
    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2]
}
"""


@pytest.mark.parametrize(
    ("work", "message"),
    [
        ("crash", "caused its reader to crash (signal 11, SIGSEGV)"),
        ("hang", "took longer than 0.2 s"),
        ("eat", "needed more than 16 GB"),
        ("fail", "caused its reader to fail: KeyError: 'points'"),
        ("vanish", "caused its reader to crash (without output)"),
    ],
)
def test_what_goes_wrong_is_said(tmp_path: Path, work: str, message: str) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    seconds = 0.2 if work == "hang" else 60.0
    with pytest.raises(InputError) as caught:
        run_isolated(file, f"isolated_tasks:{work}", Limits(time=seconds))
    assert message in caught.value.message
    assert str(file) in caught.value.message
    assert caught.value.hint


def test_a_refusal_is_raised_here_and_temporary_files_go(tmp_path: Path) -> None:
    file, seen = tmp_path / "a.usda", tmp_path / "seen"
    file.write_text("#usda 1.0\n")
    with pytest.raises(InputError) as caught:
        run_isolated(file, "isolated_tasks:refuse_beside", Limits(), seen)
    assert (caught.value.message, caught.value.hint) == ("no", "none")
    assert type(caught.value) is InputError
    assert seen.read_text()
    assert not Path(seen.read_text()).exists()


def test_a_refusal_for_want_of_memory_names_the_limit(tmp_path: Path) -> None:
    file = tmp_path / "a.usdc"
    file.write_bytes(b"PXR-USDC")
    with pytest.raises(InputError, match="needed more than 16 GB"):
        run_isolated(file, "isolated_tasks:refuse_for_memory", Limits())


def test_output_is_limited(tmp_path: Path) -> None:
    file, large = tmp_path / "a.usda", tmp_path / "large"
    file.write_text("#usda 1.0\n")
    with pytest.raises(InputError, match="OSError"):
        run_isolated(file, "isolated_tasks:write", Limits(output=1000), large, 5000)
    assert large.stat().st_size <= 1000


def test_limits_are_parsed() -> None:
    assert parse_limits(None) == Limits()
    assert parse_limits("none") is None
    limits = parse_limits("time=2.5, memory=8G,output=10M")
    assert limits == Limits(time=2.5, memory=8e9, output=1e7)


@pytest.mark.parametrize(
    "text", ["", "time", "time=0", "time=-1", "size=3", "memory=8X", "time=nan"]
)
def test_wrong_limits_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is not a limit"):
        parse_limits(text)


def test_less_memory_than_the_reader_itself_needs_is_refused() -> None:
    """With 1.2 GB its libraries crashed, which was blamed on the file."""
    for given in ("memory=1k", "time=9,memory=1.2G"):
        with pytest.raises(UsageError, match="less than the 2 GB that the reader needs") as error:
            parse_limits(given)
        assert parse_limits(error.value.hint.split()[-1]) == Limits(memory=4e9)
    with pytest.raises(UsageError, match=r"1\.5 GB of memory"):
        Limits(memory=1.5e9)


@pytest.mark.parametrize(
    ("work", "message"),
    [
        ("words_that_fail", "UnicodeDecodeError: "),
        ("quoting", "Quoting: its messages are not UTF-8"),
    ],
)
def test_errors_of_others_are_named(tmp_path: Path, work: str, message: str) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    with pytest.raises(InputError, match=message) as caught:
        run_isolated(file, f"isolated_tasks:{work}", Limits())
    assert "please report it" in caught.value.hint


@pytest.mark.parametrize("look", [prepare, inspect])
def test_options_are_judged_before_a_file_is_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, look: Callable[..., object]
) -> None:
    monkeypatch.setattr("gf_usd.readers.isolated.TASK", "isolated_tasks:crash")
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    with pytest.raises(UsageError, match="--fps is 0"):
        look(file, fps=0.0, limits=Limits())
    with pytest.raises(UsageError, match="there is no material"):
        look(file, material="ruber", limits=Limits())
    with pytest.raises(InputError, match="caused its reader to crash"):
        look(file, limits=Limits())


@pytest.mark.slow
def test_a_child_loads_what_reading_takes_and_no_more(tmp_path: Path) -> None:
    """It is started for each file: what it imports is the price of it."""
    file = tmp_path / "a.usda"
    file.write_text('#usda 1.0\ndef Sphere "Ball" {}\n')
    names = set(run_isolated(file, "isolated_tasks:loaded", Limits(), file))
    assert "gf_usd.readers.usd.asset" in names
    assert names.isdisjoint({"scipy", "taichi", "trimesh", "PIL", "igl", "typer", "rich"})


@pytest.mark.slow
def test_this_process_reads_nothing_itself(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from gf_usd.readers.isolated import Reading;"
        "from gf_usd.system.sandbox import Limits;"
        "reading = Reading(Path(sys.argv[1]), Limits()); read = reading.result();"
        "print(len(read.asset.surfaces[0].points), 'pxr' in sys.modules)"
    )
    file = tmp_path / "a.usda"
    file.write_text(TETRAHEDRON)
    done = subprocess.run(
        [sys.executable, "-c", code, str(file)], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["4", "False"]


@pytest.mark.parametrize("task", ["count_and_hang", pytest.param("count", marks=pytest.mark.slow)])
def test_a_child_that_takes_too_long_is_not_tried_again(tmp_path: Path, task: str) -> None:
    file, count = tmp_path / "a.usda", tmp_path / "starts"
    file.write_text("#usda 1.0\n")
    began = time.monotonic()
    with pytest.raises(InputError, match="took longer than 2 s"):
        run_isolated(file, f"isolated_tasks:{task}", Limits(time=2.0), count, 60.0)
    assert count.read_text() == "x"
    assert time.monotonic() - began < 30.0


def alive(pid: int) -> bool:
    """Whether a process runs; one that nobody has reaped yet does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def gone(pids: list[int]) -> bool:
    """Whether processes end within some seconds."""
    until = time.monotonic() + 20.0
    while any(map(alive, pids)) and time.monotonic() < until:
        time.sleep(0.05)
    return not any(map(alive, pids))


def numbers(file: Path) -> list[int]:
    """The process numbers that `isolated_tasks.stay` leaves."""
    until = time.monotonic() + 60.0
    while not file.exists():
        assert time.monotonic() < until
        time.sleep(0.05)
    return [int(word) for word in file.read_text().split()]


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="reads /proc for running processes"
)
def test_a_child_and_what_it_started_end_when_nobody_wants_the_result(tmp_path: Path) -> None:
    file, note = tmp_path / "a.usda", tmp_path / "numbers"
    file.write_text("#usda 1.0\n")
    with Isolated(file, "isolated_tasks:stay", Limits(), note):
        pids = numbers(note)
        assert all(map(alive, pids))
    assert gone(pids)


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="reads /proc for running processes"
)
def test_a_child_ends_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    file, note = tmp_path / "a.usda", tmp_path / "numbers"
    file.write_text("#usda 1.0\n")
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; from pathlib import Path;"
        "from gf_usd.system.sandbox import Limits, run_isolated;"
        f"run_isolated(Path({str(file)!r}), 'isolated_tasks:stay', Limits(), Path({str(note)!r}))"
    )
    # a parent that is killed leaves its folder of requests
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    parent = subprocess.Popen([sys.executable, "-c", code], env=environment)
    reader, program = numbers(note)
    parent.kill()
    parent.wait()
    assert gone([reader])
    with contextlib.suppress(ProcessLookupError):
        os.kill(program, signal.SIGKILL)


@pytest.mark.slow
def test_many_at_once_while_threads_run(tmp_path: Path) -> None:
    """Nothing of this process's threads and locks reaches a child."""
    file = tmp_path / "a.usda"
    file.write_text(TETRAHEDRON)
    stop = threading.Event()

    def noise() -> None:
        while not stop.is_set():
            with tempfile.NamedTemporaryFile(dir=tmp_path):
                pass
            logging.getLogger("noise").debug("x")

    threads = [threading.Thread(target=noise) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        readings = [Reading(file, Limits(time=60.0)) for _ in range(4)]
        found = [reading.result() for reading in readings]
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    assert [len(read.asset.surfaces[0].points) for read in found] == [4] * 4


def test_what_a_task_prints_is_not_its_result(tmp_path: Path, capfd) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    assert run_isolated(file, "isolated_tasks:talk", Limits()) == "done"
    assert capfd.readouterr() == ("", "")


def test_what_does_not_pass_between_processes_is_said(tmp_path: Path) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    with pytest.raises(
        InputError, match="TypeError: <class 'object'> cannot be passed between processes"
    ):
        run_isolated(file, "isolated_tasks:unknown", Limits())


def test_a_module_of_the_folder_it_runs_in_is_not_imported(tmp_path: Path, monkeypatch) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    (tmp_path / "json.py").write_text("raise SystemExit(9)\n")
    monkeypatch.chdir(tmp_path)
    assert run_isolated(file, "isolated_tasks:same", Limits(), 1) == (1,)


def test_arguments_may_be_longer_than_a_command_line(tmp_path: Path) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    many = tuple(f"/Root/prim_{number}" for number in range(100_000))
    assert run_isolated(file, "isolated_tasks:same", Limits(), many) == (many,)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".usda", ".obj"])
def test_what_a_child_returns_is_what_is_read_here(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"box{suffix}"
    box = trimesh.creation.box()
    if suffix == ".obj":
        file.write_text(trimesh.exchange.obj.export_obj(box))
    else:
        file.write_text(TETRAHEDRON)
    with Reading(file, Limits()) as reading:
        theirs = reading.result()
    ours = read_untrusted(file)
    first, second = BytesIO(), BytesIO()
    exchange.write(theirs.asset, first)
    exchange.write(ours.asset, second)
    assert first.getvalue() == second.getvalue()
    assert (theirs.spec is None) == (suffix == ".obj")
    if theirs.converted is not None and ours.converted is not None:
        assert theirs.converted.record == ours.converted.record
        assert theirs.converted.notes == ours.converted.notes
        layer = theirs.converted.layer
        assert layer.is_file()
        written = theirs.converted.write(tmp_path / "out" / "box.source.usdc")
        assert ours.converted.is_at(written)
        del theirs, reading
        gc.collect()
        assert not layer.parent.parent.exists()

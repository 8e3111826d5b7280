"""Starting Taichi, and the words where it cannot be started."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from small_bakes import BLOCK
from solids import CUBE_POINTS, CUBE_TRIANGLES

import gf_usd
from gf_usd.core.errors import GfUsdError, UsageError
from gf_usd.pipeline.prepared import prepare
from gf_usd.system import taichi_runtime


def test_an_unknown_device_is_refused():
    with pytest.raises(UsageError, match="unknown device 'tpu'") as caught:
        taichi_runtime.init_taichi("tpu")
    assert "cpu, cuda" in caught.value.hint


def test_no_threads_are_refused():
    with pytest.raises(UsageError, match="0 CPU threads"):
        taichi_runtime.init_taichi(threads=0)


def test_cuda_where_there_is_none_is_refused(monkeypatch):
    monkeypatch.setattr(taichi_runtime, "_has_cuda", lambda ti: False)
    with pytest.raises(UsageError, match="no CUDA device") as caught:
        taichi_runtime.init_taichi("cuda")
    assert "--device cpu" in caught.value.hint


@pytest.mark.parametrize(
    ("cause", "hint"),
    [
        ("libX11.so.6: cannot open shared object file", "apt-get install libx11-6"),
        ("No module named 'taichi'", "pip install"),
    ],
)
def test_a_missing_library_is_named(monkeypatch, cause, hint):
    def fail(name):
        raise ImportError(cause)

    monkeypatch.setattr(importlib, "import_module", fail)
    taichi_runtime._imported.cache_clear()
    try:
        with pytest.raises(GfUsdError, match="Taichi cannot be loaded") as caught:
            taichi_runtime.import_taichi()
    finally:
        taichi_runtime._imported.cache_clear()
    assert cause in caught.value.message
    assert hint in caught.value.hint


@pytest.mark.slow
def test_the_same_arguments_start_it_once_and_others_anew(monkeypatch):
    ti = taichi_runtime.import_taichi()
    taichi_runtime.init_taichi(threads=1)
    starts = []
    monkeypatch.setattr(ti, "init", lambda **arguments: starts.append(arguments))
    monkeypatch.setattr(taichi_runtime, "_started", dict(taichi_runtime._started))
    taichi_runtime.init_taichi(threads=1)
    taichi_runtime.ensure_taichi()
    assert starts == []
    taichi_runtime.init_taichi(threads=2)
    assert [start["cpu_max_num_threads"] for start in starts] == [2]
    taichi_runtime.init_taichi(threads=2, f64=True)
    assert starts[-1]["default_fp"] == ti.f64
    # kernels of pictures do not compile with 64-bit literals
    taichi_runtime.ensure_taichi()
    assert starts[-1]["default_fp"] == ti.f32
    assert starts[-1]["cpu_max_num_threads"] == 2


@pytest.mark.slow
@pytest.mark.parametrize("stdout", ["sys.__stdout__", "io.StringIO()"], ids=["own", "notebook"])
def test_starting_says_nothing_on_the_way(stdout):
    code = "from gf_usd.system.taichi_runtime import init_taichi; init_taichi()"
    code = f"import io, sys; sys.stdout = {stdout}; {code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert done.stderr == ""


KERNEL = (
    "from gf_usd.system import taichi_runtime as own; own.init_taichi();"
    "from gf_usd.physics.grid import row_kernels;"
    "import taichi as ti; x = ti.field(ti.f32, 3); x.fill(1.0);"  # compiles a kernel
    "print(*own.kernel_cache_notes())"
)


def start_in(environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """A process that compiles a kernel, with nothing but these variables."""
    paths = {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return subprocess.run(
        [sys.executable, "-c", KERNEL],
        env={**environment, **paths},
        check=False,
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
def test_it_starts_without_a_home():
    done = start_in({})
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("variable", ["HOME", "TI_OFFLINE_CACHE_FILE_PATH"])
def test_without_a_folder_for_kernels_it_says_so_and_continues(variable, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    # even root can make no folder there
    done = start_in({"HOME": str(tmp_path), variable: str(file)})
    assert (done.returncode, done.stderr) == (0, "")
    assert f"the folder of compiled kernels {file}" in done.stdout
    assert "kernels are compiled in every run; set TI_OFFLINE_CACHE_FILE_PATH" in done.stdout


def test_plans_say_where_kernels_cannot_be_kept(monkeypatch, tmp_path):
    monkeypatch.setattr(taichi_runtime, "_kernel_cache", lambda: (True, "no kernels are kept"))
    scene = gf_usd.Scene()
    scene.add_body(CUBE_POINTS, CUBE_TRIANGLES)
    assert "no kernels are kept" in gf_usd.simulate(scene, particles=50).notes
    (tmp_path / "block.usda").write_text(BLOCK, encoding="utf-8")
    plan = prepare(tmp_path / "block.usda", particles=50).plan
    assert plan.notes.count("no kernels are kept") == 1


def test_its_import_is_no_warning():
    code = "from gf_usd.system.taichi_runtime import import_taichi; import_taichi()"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_kernels_of_hundreds_of_bakes_stay_in_the_cache():
    taichi_runtime.init_taichi()
    config = importlib.import_module("taichi").lang.impl.get_runtime().prog.config()
    # 0.6 MB a kernel: Taichi's own limit holds 175 of them
    assert config.offline_cache_max_size_of_files >= 1000 * 600e3


def test_only_the_kernel_asked_for_is_compiled_without_merging() -> None:
    taichi_runtime.init_taichi()
    config = importlib.import_module("taichi").lang.impl.get_runtime().prog.config()
    before = config.opt_level
    seen = []

    def kernel(number: int) -> None:
        seen.append((number, config.opt_level))
        if number == 2:
            raise ValueError

    kernel._primal = kernel  # type: ignore[attr-defined]  (as Taichi has it)
    launch = taichi_runtime.without_common_subexpressions(kernel)
    config.opt_level = 1  # as without `tests/conftest.py`
    try:
        launch(1)
        with pytest.raises(ValueError):
            launch(2)
        assert seen == [(1, 0), (2, 0)]
        assert config.opt_level == 1
    finally:
        config.opt_level = before
    assert launch._primal is kernel  # type: ignore[attr-defined]


@pytest.mark.parametrize("f64", [False, True])
def test_a_sum_over_a_loop_into_one_number_is_right_without_merging(f64: bool) -> None:
    from sum_kernel import sum_kernel

    taichi_runtime.init_taichi(f64=f64)
    values, out = np.arange(1.0, 11.0, dtype=np.float32), np.zeros(1, np.float32)
    taichi_runtime.without_common_subexpressions(sum_kernel())(values, out, len(values))
    assert out[0] == 2 * values.sum()


@pytest.mark.slow
def test_what_outlives_a_restart_is_not_freed_by_its_address(monkeypatch) -> None:
    import taichi as ti
    from taichi.lang import _ndarray

    freed: list[object] = []
    taichi_runtime.init_taichi("cpu", 1)
    old = ti.ndarray(ti.f32, 7)
    taichi_runtime.init_taichi("cpu", 2)
    new = ti.ndarray(ti.f32, 7)
    program = SimpleNamespace(delete_ndarray=freed.append)
    stand_in = SimpleNamespace(get_runtime=lambda: SimpleNamespace(prog=program))
    with monkeypatch.context() as patch:
        patch.setattr(_ndarray, "impl", stand_in)
        for array in (old, new):
            array.__del__()
    assert freed == [new.arr]

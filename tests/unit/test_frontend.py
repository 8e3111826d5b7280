"""What Taichi is made to do at a start: as quickly, and with the same keys and words."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gf_usd import frontend
from gf_usd.runtime import import_taichi, init_taichi

KERNEL = """
from gf_usd.runtime import import_taichi, init_taichi

ti = import_taichi()
init_taichi(threads={threads})
x = ti.ndarray(ti.f32, 4000)

@ti.kernel
def double(x: ti.types.ndarray(dtype=ti.f32, ndim=1)):
    for i in range(x.shape[0]):
        x[i] = 2.0 * x[i] + 1.0

double(x)
assert x.to_numpy().min() == x.to_numpy().max() == 1.0
"""


def test_the_number_of_threads_compiles_nothing_anew(tmp_path: Path) -> None:
    script = tmp_path / "kernel.py"
    environment = {**os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(tmp_path / "cache")}

    def compiled_after(threads: int) -> set[str]:
        script.write_text(KERNEL.format(threads=threads))
        subprocess.run([sys.executable, str(script)], env=environment, check=True)
        return {file.name for file in (tmp_path / "cache").rglob("*.tic")}

    first = compiled_after(1)
    assert first
    assert compiled_after(3) == first


def test_a_fault_in_a_kernel_is_still_placed() -> None:
    ti: Any = import_taichi()
    init_taichi()
    numbers: Any = ti.types.ndarray(dtype=ti.f32, ndim=1)

    @ti.kernel
    def faulty(x: numbers):  # pyright: ignore[reportInvalidTypeForm]
        for i in range(4):
            x[i] = nowhere  # noqa: F821  # pyright: ignore[reportUndefinedVariable]

    with pytest.raises(ti.TaichiNameError, match="nowhere") as error:
        faulty(ti.ndarray(ti.f32, 4))
    said = str(error.value)
    assert f'File "{__file__}"' in said
    assert "x[i] = nowhere" in said
    line = next(k for k, text in enumerate(Path(__file__).read_text().splitlines(), 1)
                if "= nowhere  #" in text)  # fmt: skip
    assert f"line {line}" in said


def test_a_function_in_a_class_is_still_told_from_one_in_a_module() -> None:
    kernels = sys.modules["taichi.lang.kernel_impl"]
    asked: list[int] = []
    words = tuple(kernels._KERNEL_CLASS_STACKFRAME_STMT_RES)
    inside = frontend._asked_of_files(lambda level: bool(asked.append(level)), words)

    class Here:
        found = inside(2)  # from the body of a class to what is at its first line

    assert Here.found
    assert not inside(0)
    assert asked == []
    unknown = frontend._asked_of_files(lambda level: bool(asked.append(level)), ())
    assert not unknown(0)
    assert asked == [1], "this frame is of a file, one level further up for the one who looks"
    code = compile("found = inside(1)", "<nowhere>", "exec")
    exec(code, space := {"inside": inside})
    assert space["found"] is False
    assert asked == [1]
    assert kernels._inside_class.__name__ == "inside_class"


def test_the_version_check_that_is_off_loads_nothing_that_talks_to_a_network() -> None:
    code = "import sys; from gf_usd.runtime import import_taichi; import_taichi(); "
    code += "print([m for m in ('ssl', 'taichi._version_check') if m in sys.modules])"

    def loaded(switch: str) -> str:
        environment = {**os.environ, "TI_SKIP_VERSION_CHECK": switch}
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.strip()

    assert loaded("ON") == "[]"
    # One who wants the check has it, as Taichi made it.
    assert loaded("OFF") == "['ssl', 'taichi._version_check']"

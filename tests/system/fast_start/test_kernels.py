"""What Taichi is made to do at a start: as quickly, and with the same keys and words."""

import ast
import gc
import inspect
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from gf_usd.core import FAST_START
from gf_usd.system.fast_start import kernels
from gf_usd.system.taichi_runtime import import_taichi, init_taichi

ROOT = Path(__file__).parents[3]
KERNEL = """
from gf_usd.system.taichi_runtime import import_taichi, init_taichi

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


@pytest.mark.slow
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


MANY_WAYS = """
import sys
from gf_usd.system import taichi_runtime

ti = taichi_runtime.import_taichi()
taichi_runtime.init_taichi()
x = ti.ndarray(ti.f32, 4)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)

@ti.func
def twice(a):
    return 2.0 * a - a / 3.0 + a // 1.0 + a % 7.0

@ti.func
def power(a, n: ti.template()):
    out = a
    if ti.static(n > 1):
        out = a * power(a, n - 1)
    return out

@ti.func
def second(v: ti.template()):
    return v.y + v.normalized().x

@ti.kernel
def fill(x: numbers, n: ti.i32):
    for i in range(n):
        v = ti.Vector([float(i), 3.0])
        for k in ti.static(range(3)):
            x[i] += twice(twice(v.x)) - power(v.y, 3) + second(v) * k
    for i in range(n):
        x[i] = -x[i] if x[i] > 1.0 else twice(x[i])

fill(x, 4)
print(x.to_numpy().tolist(), type(sys.modules["taichi.lang.kernel_impl"].ast).__name__)
"""


@pytest.mark.slow
def test_the_same_kernel_comes_of_a_source_and_under_the_same_key(tmp_path: Path) -> None:
    script = tmp_path / "kernel.py"
    script.write_text(MANY_WAYS)

    def run(way: str) -> tuple[str, str, set[str]]:
        cache = tmp_path / way
        environment = {
            **os.environ, "TI_OFFLINE_CACHE_FILE_PATH": str(cache),
            FAST_START: "0" if way == "plain" else "1",
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, str(script)],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        values, _, kind = done.stdout.strip().rpartition(" ")
        return values, kind, {file.name for file in cache.rglob("*.tic")}

    plain, quick = run("plain"), run("quick")
    assert (plain[1], quick[1]) == ("module", "SimpleNamespace"), "else nothing is compared"
    assert quick[0] == plain[0]
    assert plain[2]
    assert quick[2] == plain[2]


def test_a_tree_serves_one_call_at_a_time_and_none_outlives_its_kernel() -> None:
    seen: list[Any] = []
    source = "def f(x):\n    return x"
    context = SimpleNamespace(is_kernel=False, is_real_function=False)

    def transform(tree: Any, ctx: Any) -> None:
        if ctx.is_kernel:
            for _ in range(2):
                outer = trees.parse(source)
                seen.append(outer)
                trees.transform(outer, context)
        elif len(seen) % 2:
            seen.append(inner := trees.parse(source))
            trees.transform(inner, context)

    trees = kernels.SyntaxTrees(transform)
    assert gc.isenabled()
    kernel = SimpleNamespace(is_kernel=True, is_real_function=False)
    trees.transform(trees.parse("def k(): pass"), kernel)
    assert gc.isenabled()
    assert seen[0] is not seen[1], "called while it is in use"
    assert {id(tree) for tree in seen[2:]} <= {id(tree) for tree in seen[:2]}
    assert trees.parse(source) not in seen


def test_lines_of_source_are_filled_as_textwrap_does() -> None:
    for line in (
        "",
        "  \n",
        "    x = 1  \n",
        "\ty = 2\n",
        "a\x0cb",
        "z" * 99,
        "p q " * 9,
        "ä = 'é'",
    ):
        filled = textwrap.fill(line, tabsize=4, width=30)
        assert kernels._fast_fill(line, tabsize=4, width=30) == filled, repr(line)


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
    message = str(error.value)
    assert f'File "{__file__}"' in message
    assert "x[i] = nowhere" in message
    assert "^^^^^^^" in message
    line = next(k for k, text in enumerate(Path(__file__).read_text().splitlines(), 1)
                if "= nowhere  #" in text)  # fmt: skip
    assert f"line {line}" in message


def test_an_array_has_the_files_and_lines_of_the_calls_that_made_it() -> None:
    import_taichi()
    own = sys.modules["taichi.lang.util"].get_traceback

    def array(trace: Any, *levels: int) -> str:
        return trace(*levels)

    for levels in ((), (2,)):
        short, full = (array(trace, *levels) for trace in (kernels._short_traceback, own))
        named = [line for line in full.splitlines() if line.startswith('  File "')]
        assert len(named) > 10
        assert short.splitlines() == named
    for module in ("_ndarray", "matrix"):
        assert sys.modules[f"taichi.lang.{module}"].get_traceback is kernels._short_traceback


def test_a_function_in_a_class_is_still_distinguished_from_one_in_a_module() -> None:
    taichis = sys.modules["taichi.lang.kernel_impl"]
    levels: list[int] = []
    patterns = tuple(taichis._KERNEL_CLASS_STACKFRAME_STMT_RES)
    inside = kernels.faster_inside_class(lambda level: bool(levels.append(level)), patterns)

    class Here:
        found = inside(2)  # from the body of a class to what is at its first line

    assert Here.found
    assert not inside(0)
    assert levels == []
    unknown = kernels.faster_inside_class(lambda level: bool(levels.append(level)), ())
    assert not unknown(0)
    assert levels == [1], "this frame is of a file, one level further up for the one who looks"
    code = compile("found = inside(1)", "<nowhere>", "exec")
    exec(code, space := {"inside": inside})
    assert space["found"] is False
    assert levels == [1]
    assert taichis._inside_class.__name__ == "inside_class"


def long_signature(
    a: int,
    b: int,
) -> list[int]:
    """Ends with a bracket of its own."""

    def inner() -> int:
        return a

    if a > b:
        return [inner()]
    return [
        b,
        a,
    ]  # printed behind it


def text_at_the_end() -> str:
    return """
one
"""


def branch_at_the_end(a: int) -> None:
    for _ in range(a):
        a += 1
        if a > 3:
            pass  # nothing more


@pytest.mark.parametrize("function", [long_signature, text_at_the_end, branch_at_the_end])
def test_a_function_is_read_up_to_its_end(function: Any) -> None:
    lines, first = kernels._fast_source_lines(inspect.getsourcelines)(function)
    complete, known = inspect.getsourcelines(function)
    assert first == known
    assert ast.dump(ast.parse("".join(lines))) == ast.dump(ast.parse("".join(complete)))


def test_a_function_without_a_file_is_left_to_inspect() -> None:
    space: dict[str, Any] = {}
    exec("def nowhere(): return 1", space)
    with pytest.raises(OSError, match="source"):
        kernels._fast_source_lines(inspect.getsourcelines)(space["nowhere"])


@pytest.mark.parametrize("version", [(1, 7, 3), (1, 7, 5), (1, 8, 0), (2, 0, 0)])
def test_another_version_of_taichi_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, version: tuple[int, int, int]
) -> None:
    import_taichi()
    taichi = ModuleType("taichi")
    taichi.__version__ = version
    taichis = sys.modules["taichi.lang.kernel_impl"]
    before = dict(vars(taichis))
    monkeypatch.setattr(kernels.importlib, "import_module", None)  # would be called
    kernels.install_replacements(taichi)
    assert dict(vars(taichis)) == before


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_bake_is_the_same_to_the_byte_with_the_fast_start_switched_off(tmp_path: Path) -> None:
    """All that is written, and under the same keys of kernels."""
    script = (
        "import sys, gf_usd\n"
        "from gf_usd.system.taichi_runtime import MERGE_OPTIONS\n"
        "MERGE_OPTIONS[True] = MERGE_OPTIONS[False]\n"  # compiled quickly, as in tests/conftest.py
        "def on_progress(done, total):\n"  # while it runs: afterwards all is as it was
        "    if done == total:\n"
        "        print(type(sys.modules['taichi.lang.kernel_impl'].ast).__name__)\n"
        "gf_usd.bake(sys.argv[1], output='out/', material='rubber', particles=300, frames=3,"
        " drop='0.1', stress=True, progress=on_progress)\n"
    )

    def bake(switch: str) -> tuple[str, dict[str, bytes], set[str]]:
        here, cached = tmp_path / switch, tmp_path / f"kernels-{switch}"
        (here / "out").mkdir(parents=True)
        environment = {
            **os.environ, FAST_START: switch,
            "TI_OFFLINE_CACHE_FILE_PATH": str(cached),
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-c", script, str(ROOT / "samples" / "sphere.usda")],
            cwd=here, env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        files = {
            file.name: re.sub(rb'("seconds": )[0-9.e-]+', rb"\1", file.read_bytes())
            for file in sorted((here / "out").iterdir())
        }
        return done.stdout.strip(), files, {file.name for file in cached.rglob("*.tic")}

    on, off = bake("1"), bake("0")
    assert (on[0], off[0]) == ("SimpleNamespace", "module"), "else nothing is compared"
    assert len(on[1]) >= 3
    assert on[1] == off[1]
    assert off[2]
    assert on[2] == off[2]


@pytest.mark.slow
def test_taichi_asks_no_network_whether_it_is_the_newest() -> None:
    code = (
        "from gf_usd.system.taichi_runtime import import_taichi, init_taichi\n"
        "import_taichi()\n"
        "from taichi import _version_check\n"
        "checks = []\n"
        "_version_check.try_check_version = lambda: checks.append(1)\n"
        "init_taichi()\n"
        "print(checks)\n"
    )

    def requests(switch: dict[str, str]) -> str:
        environment = {k: v for k, v in os.environ.items() if k != "TI_SKIP_VERSION_CHECK"}
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**environment, **switch},
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.strip()

    assert requests({}) == "[]"
    # The check can be enabled, as Taichi made it.
    assert requests({"TI_SKIP_VERSION_CHECK": "OFF"}) == "[1]"


ANNOUNCED = """
import sys
from gf_usd.system import taichi_runtime

ti = taichi_runtime.import_taichi()
from taichi.lang.kernel_impl import Func
seen = [type(finder).__name__ for finder in sys.meta_path]
assert "_Finder" not in seen, seen
for name, module in sorted(sys.modules.items()):
    if not name.startswith("taichi"):
        continue
    for owner in (module, *(one for one in vars(module).values() if isinstance(one, type))):
        for key, value in vars(owner).items():
            made = getattr(value, "__dict__", {}).get("func")
            if isinstance(made, Func):
                print(name, key, made.classfunc)
"""


@pytest.mark.slow
def test_taichi_announces_its_own_functions_alike_however_it_is_imported() -> None:
    def announced(switch: str) -> set[str]:
        done = subprocess.run(
            [sys.executable, "-c", ANNOUNCED], capture_output=True, text=True, check=True,
            env={**os.environ, FAST_START: switch}, cwd=ROOT,
        )  # fmt: skip
        return set(done.stdout.splitlines())

    quick = announced("1")
    assert len(quick) > 50
    assert quick == announced("0")

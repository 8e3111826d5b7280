"""The house rules, held by reading the source: who imports whom, who prints, who catches what."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "gf_usd"
ROOMS = ("assets", "geometry", "physics", "usd", "view")
# The street: the files that may know several rooms, and that no room may know.
STREET = (
    *("advising.py", "baking.py", "carrying.py", "moving.py", "pinning.py"),
    *("plan.py", "estimate.py", "preflight.py"),
)
# Rooms above rooms: the accuracy cases fill bodies and move them, a batch starts bakes; no other
# room knows them.
ABOVE = ("verify", "batch")
LONGEST = 300
DYNAMIC = re.compile(r"gf_usd(\.\w+)+(:\w+)?")  # a module named in a string, to be imported later
CATCH_ALL = {"Exception", "BaseException"}

Rule = Callable[[Path, ast.Module], Iterator[str]]


def imports(file: Path, tree: ast.Module) -> Iterator[str]:
    """Full names of all that a file of the package imports, at its top or anywhere inside."""
    package = (PACKAGE / file).relative_to(PACKAGE.parent).parent.parts
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            home = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{home}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and DYNAMIC.fullmatch(str(node.value)):
            yield str(node.value).split(":")[0]


def room(file: Path) -> str | None:
    """The room that a file lies in."""
    return file.parts[0] if file.parts[0] in ROOMS else None


def rooms_of(file: Path, tree: ast.Module) -> set[str]:
    """The rooms that a file imports from."""
    found = {name.split(".")[1] for name in imports(file, tree) if name.startswith("gf_usd.")}
    return found & set(ROOMS)


def stages_stay_apart(file: Path, tree: ast.Module) -> Iterator[str]:
    """A room imports no other."""
    mine = room(file)
    if mine is not None:
        yield from (f"imports {other}" for other in rooms_of(file, tree) - {mine})


def rooms_do_not_know_the_street(file: Path, tree: ast.Module) -> Iterator[str]:
    """What is above a room (the street and the command line) is none of its business."""
    above = {*(Path(name).stem for name in STREET), *ABOVE, "cli"}
    if room(file) is not None:
        for name in imports(file, tree):
            if name.startswith("gf_usd.") and name.split(".")[1] in above:
                yield f"imports {name}"


def only_the_street_knows_several_rooms(file: Path, tree: ast.Module) -> Iterator[str]:
    """Every other file outside the rooms serves one of them at most."""
    if room(file) is None and str(file) not in STREET and file.parts[0] not in ("verify", "cli"):
        several = rooms_of(file, tree)
        if len(several) > 1:
            yield f"imports {', '.join(sorted(several))}"


def libraries_stay_in_their_rooms(file: Path, tree: ast.Module) -> Iterator[str]:
    """pxr, taichi and what talks to a terminal each have a home."""
    homes = {
        "pxr": file.parts[0] == "usd" or file.match("assets/usd*.py"),
        "taichi": file.parts[0] in ("physics", "view") or str(file) == "runtime.py",
        "typer": file.parts[0] == "cli",
        "rich": file.parts[0] == "cli",
        "distributed": file.match("batch/cluster.py"),
        "plotly": file.match("view/report*.py"),
        "open3d": file.match("view/window*.py") or str(file) == "geometry/drift.py",
    }
    for name in imports(file, tree):
        if not homes.get(name.split(".")[0], True):
            yield f"imports {name}"


def only_the_command_line_prints(file: Path, tree: ast.Module) -> Iterator[str]:
    """Library code reports by values and errors."""
    if file.parts[0] == "cli":
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "print", "sys.stdout.write", "sys.stderr.write",
        ):  # fmt: skip
            yield f"line {node.lineno} prints"


def nothing_catches_everything(file: Path, tree: ast.Module) -> Iterator[str]:
    """An except clause, or a suppress(), names what it expects."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler):
            caught = node.type
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
            caught = ast.Tuple(elts=node.args)
        else:
            continue
        named = caught.elts if isinstance(caught, ast.Tuple) else [caught]
        if caught is None or any(ast.unparse(n).split(".")[-1] in CATCH_ALL for n in named if n):
            yield f"line {node.lineno} catches everything"


RULES: tuple[Rule, ...] = (
    stages_stay_apart,
    rooms_do_not_know_the_street,
    only_the_street_knows_several_rooms,
    libraries_stay_in_their_rooms,
    only_the_command_line_prints,
    nothing_catches_everything,
)


def python_files(folder: Path) -> list[Path]:
    """Every Python file under a folder."""
    found = sorted(folder.rglob("*.py"))
    assert found, f"{folder} holds no Python: the rules would judge nothing"
    return found


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file, read once for all rules."""
    return ast.parse(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_package_keeps_the_rule(rule: Rule) -> None:
    broken = []
    for path in python_files(PACKAGE):
        file = path.relative_to(PACKAGE)
        broken += [f"gf_usd/{file} {fault}" for fault in rule(file, parsed(path))]
    assert broken == [], rule.__doc__


@pytest.mark.parametrize(
    ("rule", "file", "source", "faults"),
    [
        (stages_stay_apart, "view/a.py", "from gf_usd.usd.stage import x", ["imports usd"]),
        (stages_stay_apart, "view/a.py", "def f():\n  import gf_usd.usd", ["imports usd"]),
        (stages_stay_apart, "view/a.py", "from ..physics import laws", ["imports physics"]),
        (stages_stay_apart, "usd/rules/a.py", "from ...view import mesh", ["imports view"]),
        (stages_stay_apart, "usd/rules/a.py", "from ..stage import x", []),
        (stages_stay_apart, "view/a.py", "x = 'gf_usd.assets.usd:read'", ["imports assets"]),
        (stages_stay_apart, "view/a.py", "from gf_usd import usd", ["imports usd"]),
        (stages_stay_apart, "view/a.py", "from gf_usd.view import mesh; import gf_usd.model", []),
        (
            rooms_do_not_know_the_street,
            "usd/a.py",
            "from gf_usd.baking import run\nfrom gf_usd.cli import talk\nimport gf_usd.materials\n"
            "from gf_usd.verify import case\nfrom gf_usd.batch import run",
            [
                "imports gf_usd.baking.run",
                "imports gf_usd.cli.talk",
                "imports gf_usd.verify.case",
                "imports gf_usd.batch.run",
            ],
        ),
        (
            only_the_street_knows_several_rooms,
            "summary.py",
            "import gf_usd.usd.stage\nfrom gf_usd.assets import read_asset",
            ["imports assets, usd"],
        ),
        (only_the_street_knows_several_rooms, "inspection.py", "import gf_usd.usd.stage", []),
        (
            only_the_street_knows_several_rooms,
            "baking.py",
            "import gf_usd.usd.stage\nimport gf_usd.assets.usd",
            [],
        ),
        (libraries_stay_in_their_rooms, "assets/usd_mesh.py", "from pxr import Usd", []),
        (
            libraries_stay_in_their_rooms,
            "assets/obj.py",
            "from pxr import Usd",
            ["imports pxr.Usd"],
        ),
        (libraries_stay_in_their_rooms, "plan.py", "import pxr", ["imports pxr"]),
        (libraries_stay_in_their_rooms, "geometry/a.py", "import taichi", ["imports taichi"]),
        (libraries_stay_in_their_rooms, "view/a.py", "import taichi.math as tm", []),
        (libraries_stay_in_their_rooms, "usd/a.py", "import typer", ["imports typer"]),
        (only_the_command_line_prints, "baking.py", "print(1)", ["line 1 prints"]),
        (only_the_command_line_prints, "usd/a.py", "sys.stdout.write('')", ["line 1 prints"]),
        (only_the_command_line_prints, "cli/talk.py", "print(1)", []),
        *(
            (nothing_catches_everything, "a.py", source, [f"line {line} catches everything"])
            for source, line in (
                ("try: pass\nexcept: pass", 2),
                ("try: pass\nexcept Exception as e: pass", 2),
                ("try: pass\nexcept (OSError, BaseException): pass", 2),
                ("try: pass\nexcept builtins.Exception: pass", 2),
                ("with contextlib.suppress(Exception): pass", 1),
            )
        ),
        (nothing_catches_everything, "a.py", "try: pass\nexcept (OSError, KeyError): pass", []),
        (nothing_catches_everything, "a.py", "with suppress(OSError): pass", []),
    ],
)
def test_the_rule_sees_what_breaks_it(
    rule: Rule, file: str, source: str, faults: list[str]
) -> None:
    assert list(rule(Path(file), ast.parse(source))) == faults


def test_files_stay_short() -> None:
    files = [path for part in ("gf_usd", "tests", "tools") for path in python_files(ROOT / part)]
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in files
    }
    assert {name: n for name, n in lengths.items() if n > LONGEST} == {}


@pytest.mark.parametrize("module", ["gf_usd", "gf_usd.cli.main"])
def test_importing_costs_nothing(module: str) -> None:
    heavy = ("taichi", "pxr", "numpy", "scipy", "trimesh", "igl", "PIL", "rich.table")
    code = f"import sys, {module}; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_taichi_is_started_by_the_runtime_alone() -> None:
    # Imported elsewhere first, it prints its banner into the JSON on stdout.
    modules = "gf_usd.preflight, gf_usd.baking, gf_usd.verify.run, gf_usd.physics.solvers"
    code = f"import sys, {modules}; print('taichi' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_small_bake_loads_no_more_than_it_needs(tmp_path: Path) -> None:
    # What takes a tenth of a CPU second to import, in a bake that has few points and no pictures.
    heavy = ("scipy.spatial", "scipy.linalg", "scipy.special", "scipy.sparse.csgraph", "trimesh",
             "PIL", "plotly", "rich", "ssl", "imageio", "open3d", "distributed")  # fmt: skip
    code = (
        "import sys, gf_usd\n"
        f"gf_usd.bake({str(ROOT / 'samples' / 'sphere.usda')!r}, output={str(tmp_path) + '/'!r},"
        " preset='paper', frames=2)\n"
        f"print([m for m in {heavy!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "[]"

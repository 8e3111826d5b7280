"""The structure of the package, held by reading its source: who imports whom, who prints, what is
caught, how large a file and a package may be."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "gf_usd"
BASE = {"core", "system"}
# Who takes these apart; all others are given what they need of them.
WHOLE = {
    "gf_usd.prepare.plan.Plan": {"prepare/fill/fill.py", "prepare/prepare.py",
                                 "pipeline/prepared.py", "pipeline/run/run.py",
                                 "pipeline/run/variant.py", "pipeline/run/coarse.py",
                                 "pipeline/run/parts.py", "pipeline/inspect.py",
                                 "pipeline/scene.py", "cli/console.py"},
    "gf_usd.prepare.options.request.Request": {"prepare/settings.py", "prepare/fill/inputs.py",
                                               "prepare/fill/fill.py",
                                               "prepare/options/choices.py",
                                               "prepare/options/implied.py",
                                               "prepare/options/parse.py",
                                               "prepare/prepare.py", "pipeline/scene.py",
                                               "batch/manifest.py"},
}  # fmt: skip
# What each package may import besides itself; lazy and type-only imports count.
MAY_IMPORT = {
    "core": set(),
    "system": {"core"},
    "readers": BASE,
    "geometry": BASE,
    "physics": BASE,
    "layers": BASE,
    "view": BASE,
    "prepare": BASE | {"readers", "geometry"},
    # view: the picture that an advisor is shown
    "pipeline": BASE | {"readers", "geometry", "physics", "layers", "prepare", "view"},
    "delivery": BASE | {"readers", "layers", "view"},  # view: normals of meshes without any
    "verify": BASE | {"geometry", "physics"},
    "batch": BASE | {"readers", "prepare", "pipeline", "view"},
    "fitting": BASE | {"readers", "geometry", "layers", "view", "prepare", "pipeline"},
}
MAY_IMPORT["api"] = set(MAY_IMPORT) - {"verify", "batch"}
MAY_IMPORT["cli"] = set(MAY_IMPORT)
MOST_LINES = 600  # and 400 as a rule
MOST_ENTRIES = 12  # files and sub-packages of a package
DYNAMIC = re.compile(r"gf_usd(\.\w+)+(:\w+)?")  # a module named in a string, to be imported later
CATCH_ALL = {"Exception", "BaseException"}
ERRORS = ("Error", "Unfinished", "OutOfResources")

Rule = Callable[[Path, ast.Module], Iterator[str]]


@cache
def nodes(tree: ast.Module) -> tuple[ast.AST, ...]:
    """All nodes of a file, found once for all rules."""
    return tuple(ast.walk(tree))


@cache
def imports(file: Path, tree: ast.Module) -> tuple[str, ...]:
    """Full names of all that a file of the package imports, at its top or anywhere inside."""
    package = (PACKAGE / file).relative_to(PACKAGE.parent).parent.parts
    found: list[str] = []
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            home = ".".join([*above, *([node.module] if node.module else [])])
            found += [f"{home}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Constant) and DYNAMIC.fullmatch(str(node.value)):
            found.append(str(node.value).split(":")[0])
    return tuple(found)


def packages_import_in_one_direction(file: Path, tree: ast.Module) -> Iterator[str]:
    """A package imports only what MAY_IMPORT lists for it."""
    mine = file.parts[0]
    if mine not in MAY_IMPORT:  # the facade
        return
    forbidden = set(MAY_IMPORT) - MAY_IMPORT[mine] - {mine}
    for name in imports(file, tree):
        parts = name.split(".")
        if name == "gf_usd" or (parts[0] == "gf_usd" and parts[1] in forbidden):
            yield f"imports {name}"


def libraries_stay_in_their_packages(file: Path, tree: ast.Module) -> Iterator[str]:
    """pxr, taichi and what talks to a terminal are imported in few packages."""
    package = file.parts[0]
    homes = {
        "pxr": package in ("readers", "layers", "delivery") or str(file) == "system/usd_schema.py",
        "taichi": package in ("physics", "view") or file.match("system/taichi_*.py"),
        "typer": package == "cli",
        "rich": package == "cli",
        "distributed": file.match("batch/cluster.py"),
        "plotly": file.match("view/report/*.py"),
        "open3d": file.match("view/window/*.py"),
    }
    for name in imports(file, tree):
        if not homes.get(name.split(".")[0], True):
            yield f"imports {name}"


def plans_and_requests_are_taken_apart_in_few_places(file: Path, tree: ast.Module) -> Iterator[str]:
    """What stands below is given the values that it needs, not the plan or the request."""
    for name in imports(file, tree):
        if str(file) not in WHOLE.get(name, {str(file)}):
            yield f"imports {name}"


def only_the_command_line_prints(file: Path, tree: ast.Module) -> Iterator[str]:
    """Library code reports by values and errors."""
    if file.parts[0] == "cli":
        return
    for node in nodes(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "print", "sys.stdout.write", "sys.stderr.write",
        ):  # fmt: skip
            yield f"line {node.lineno} prints"


def nothing_catches_everything(file: Path, tree: ast.Module) -> Iterator[str]:
    """An except clause, or a suppress(), names what it expects."""
    for node in nodes(tree):
        if isinstance(node, ast.ExceptHandler):
            caught = node.type
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
            caught = ast.Tuple(elts=node.args)
        else:
            continue
        named = caught.elts if isinstance(caught, ast.Tuple) else [caught]
        if caught is None or any(ast.unparse(n).split(".")[-1] in CATCH_ALL for n in named if n):
            yield f"line {node.lineno} catches everything"


def no_string_is_a_statement(file: Path, tree: ast.Module) -> Iterator[str]:
    """A string on a line of its own is a docstring, not the lost end of the message before it."""
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {id(n.body[0]) for n in nodes(tree) if isinstance(n, owners) and n.body}
    for node in nodes(tree):
        if not isinstance(node, ast.Expr) or id(node) in docstrings:
            continue
        value = node.value.value if isinstance(node.value, ast.Constant) else node.value
        if isinstance(value, str | ast.JoinedStr):
            yield f"line {node.lineno} is a string that nothing uses"


def errors_are_in_one_style(file: Path, tree: ast.Module) -> Iterator[str]:
    """A message follows `error: ` and precedes its hint: lower case first, and no period."""
    for node in nodes(tree):
        if not isinstance(node, ast.Call) or not ast.unparse(node.func).endswith(ERRORS):
            continue
        message = node.args[0] if node.args else ast.Constant("")
        parts = message.values if isinstance(message, ast.JoinedStr) else [message]
        first, last = (
            part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else ""
            for part in (parts[0], parts[-1])
        )
        if re.search(r"[^.]\.$", last):
            yield f"line {node.lineno} ends a message with a period"
        if re.match(r"(?!Taichi)[A-Z][a-z]* ", first):
            yield f"line {node.lineno} starts a message in upper case"


RULES: tuple[Rule, ...] = (
    packages_import_in_one_direction,
    libraries_stay_in_their_packages,
    plans_and_requests_are_taken_apart_in_few_places,
    only_the_command_line_prints,
    nothing_catches_everything,
    no_string_is_a_statement,
    errors_are_in_one_style,
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
    assert sorted(set(broken)) == [], rule.__doc__


@pytest.mark.parametrize(
    ("rule", "file", "source", "faults"),
    [
        *(
            (packages_import_in_one_direction, file, source, faults)
            for file, source, faults in (
                ("view/a.py", "from gf_usd.layers.stage import x", ["gf_usd.layers.stage.x"]),
                ("view/a.py", "def f():\n  import gf_usd.layers", ["gf_usd.layers"]),
                ("view/a.py", "from ..physics import laws", ["gf_usd.physics.laws"]),
                ("layers/check/a.py", "from ...view import film", ["gf_usd.view.film"]),
                ("layers/check/a.py", "from ..stage import x", []),
                ("view/a.py", "x = 'gf_usd.readers.usd:read'", ["gf_usd.readers.usd"]),
                ("view/a.py", "from gf_usd import layers", ["gf_usd.layers"]),
                ("view/a.py", "from gf_usd.view import film; import gf_usd.core.frames", []),
                ("prepare/a.py", "if X:\n  import gf_usd.pipeline.run", ["gf_usd.pipeline.run"]),
                ("core/a.py", "import gf_usd.system.usd_schema", ["gf_usd.system.usd_schema"]),
                ("cli/a.py", "import gf_usd.batch.run, gf_usd.verify.case", []),
            )
        ),
        (libraries_stay_in_their_packages, "readers/usd/mesh.py", "from pxr import Usd", []),
        (
            libraries_stay_in_their_packages,
            "prepare/plan.py",
            "from pxr import Usd",
            ["pxr.Usd"],
        ),
        (libraries_stay_in_their_packages, "geometry/a.py", "import taichi", ["taichi"]),
        (libraries_stay_in_their_packages, "view/a.py", "import taichi.math as tm", []),
        (libraries_stay_in_their_packages, "layers/a.py", "import typer", ["typer"]),
        *(
            (plans_and_requests_are_taken_apart_in_few_places, file, source, faults)
            for file, source, faults in (
                ("pipeline/run/run.py", "from gf_usd.prepare.plan import Plan, Variant", []),
                ("pipeline/cost/budget.py", "from gf_usd.prepare.plan import Variant", []),
                (
                    "pipeline/cost/budget.py",
                    "if X:\n  from gf_usd.prepare.plan import Plan",
                    ["gf_usd.prepare.plan.Plan"],
                ),
                (
                    "prepare/paper.py",
                    "from gf_usd.prepare.options.request import Request",
                    ["gf_usd.prepare.options.request.Request"],
                ),
            )
        ),
        (only_the_command_line_prints, "pipeline/run/run.py", "print(1)", ["line 1 prints"]),
        (only_the_command_line_prints, "layers/a.py", "sys.stdout.write('')", ["line 1 prints"]),
        (only_the_command_line_prints, "cli/console.py", "print(1)", []),
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
        *(
            (errors_are_in_one_style, "a.py", f"raise {source}", faults)
            for source, faults in (
                ("UsageError('it is wrong.', 'mend it')", ["line 1 ends a message with a period"]),
                ("InputError(f'{a} is wrong.')", ["line 1 ends a message with a period"]),
                ("E('It is wrong.')", []),
                ("BakeError(f'The {a}')", ["line 1 starts a message in upper case"]),
                ("BakeError(f'{a} has no {b}', 'Do this.')", []),
                ("BakeError('USD cannot read it ...')", []),
                ("ValueError(text)", []),
                ("ValueError()", []),
            )
        ),
        (no_string_is_a_statement, "a.py", "'x'\ndef f():\n  'y'\nclass C:\n  'z'", []),
        *(
            (
                no_string_is_a_statement,
                "a.py",
                source,
                [f"line {line} is a string that nothing uses"],
            )
            for source, line in (
                ("x = 'one'\n' two'", 2),
                ("def f():\n  'y'\n  return 'one'\n  ' two'", 4),
                ("if X:\n  f'{y}'", 2),
            )
        ),
    ],
)
def test_the_rule_sees_what_breaks_it(
    rule: Rule, file: str, source: str, faults: list[str]
) -> None:
    found = [fault.removeprefix("imports ") for fault in rule(Path(file), ast.parse(source))]
    assert found == faults


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for path in python_files(PACKAGE):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported_modules(graph: dict[str, Path]) -> dict[str, set[str]]:
    """For each module the modules that it imports: at its top, lazily or for its types."""
    edges: dict[str, set[str]] = {}
    for name, path in graph.items():
        found = set()
        for target in imports(path.relative_to(PACKAGE), parsed(path)):
            while target and target not in graph:
                target = target.rpartition(".")[0]
            found.add(target)
        edges[name] = found - {"", name}
    return edges


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of two or more modules that reach each other [Tarjan 1972]."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(edges.get(node, ())):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(edges):
        if node not in index:
            visit(node)
    return found


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_no_module_imports_itself_through_others() -> None:
    # A registry names its plug-ins in its own package; the facade names everything.
    edges = imported_modules(modules())
    inside = {
        name: {to for to in found if not to.startswith(name + ".") and to != "gf_usd"}
        for name, found in edges.items()
    }
    assert circles(inside) == []


def test_every_package_has_a_one_sentence_docstring() -> None:
    for folder in {path.parent for path in python_files(PACKAGE)}:
        text = ast.get_docstring(parsed(folder / "__init__.py"))
        assert (text or "").split("\n")[0].endswith("."), folder


def test_packages_and_files_stay_small() -> None:
    assert {p.name for p in PACKAGE.iterdir() if (p / "__init__.py").is_file()} == set(MAY_IMPORT)
    for folder in {path.parent for path in python_files(PACKAGE)} - {PACKAGE, PACKAGE / "cli"}:
        entries = {p.name for p in folder.glob("*.py")} - {"__init__.py"}
        entries |= {p.parent.name for p in folder.glob("*/__init__.py")}
        assert len(entries) <= MOST_ENTRIES, (folder, sorted(entries))
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in python_files(PACKAGE)
    }
    assert {name: n for name, n in lengths.items() if n > MOST_LINES} == {}


@pytest.mark.parametrize("module", ["gf_usd", "gf_usd.cli.main"])
def test_importing_costs_nothing(module: str) -> None:
    heavy = ("taichi", "pxr", "numpy", "scipy", "trimesh", "igl", "PIL", "rich.table")
    code = f"import sys, {module}; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_taichi_is_started_by_the_runtime_alone() -> None:
    # Imported elsewhere first, it prints its banner into the JSON on stdout.
    modules = "pipeline.run.run", "prepare.prepare", "verify.registry", "physics.solvers"
    named = ", ".join(f"gf_usd.{module}" for module in modules)
    code = f"import sys, {named}; print('taichi' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_small_bake_loads_no_more_than_it_needs(tmp_path: Path) -> None:
    # What takes a tenth of a CPU second to import, in a bake that has few points and no pictures.
    heavy = ("scipy.spatial", "scipy.linalg", "scipy.special", "scipy.sparse.csgraph", "trimesh",
             "PIL", "plotly", "rich", "imageio", "open3d", "distributed")  # fmt: skip
    code = (
        "import sys, gf_usd\n"
        f"gf_usd.bake({str(ROOT / 'samples' / 'sphere.usda')!r}, output={str(tmp_path) + '/'!r},"
        " preset='paper', frames=2)\n"
        f"print([m for m in {heavy!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "[]"


def test_tests_share_by_their_helpers_alone() -> None:
    """A test module imports no other: what two of them need lies in tests/helpers."""
    other = re.compile(r"^ *(?:from|import) +((?:tests|conftest|test_\w+)\b.*)", re.MULTILINE)
    found = [
        f"{file.relative_to(ROOT)} imports {name}"
        for file in sorted((ROOT / "tests").rglob("*.py"))
        for name in other.findall(file.read_text("utf-8"))
    ]
    assert found == []

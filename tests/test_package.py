"""The public names of the package."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from pathlib import Path

import pytest

import gf_usd
from gf_usd.prepare.options.table import OPTIONS


@pytest.mark.parametrize(
    "code",
    [
        "import gf_usd; gf_usd.bake; made = gf_usd.bake",
        "from gf_usd import bake as made",
        "import gf_usd.cli.bake; from gf_usd.pipeline.run.run import run; made = gf_usd.bake",
        "import gf_usd.api.bake; made = gf_usd.bake",
    ],
)
def test_bake_is_the_function_whatever_is_imported_first(code: str) -> None:
    # Importing a submodule binds it to its package: in a process of its own, for each order.
    code += "; print(made.__module__, made.__qualname__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("gf_usd.api.bake bake", "")


def test_every_public_name_is_there_and_is_listed() -> None:
    assert dir(gf_usd) == sorted(gf_usd.__all__)
    for name in gf_usd.__all__:
        assert getattr(gf_usd, name) is not None
    assert issubclass(gf_usd.UsageError, gf_usd.GfUsdError)


def test_other_names_are_refused() -> None:
    with pytest.raises(AttributeError) as caught:
        _ = gf_usd.cake
    assert str(caught.value) == "module 'gf_usd' has no attribute 'cake'"


def test_the_signature_of_bake_has_every_option() -> None:
    signature = inspect.signature(gf_usd.bake)
    assert list(signature.parameters) == ["path", *OPTIONS, "progress"]
    for name, option in OPTIONS.items():
        parameter = signature.parameters[name]
        assert (parameter.kind, parameter.default) == (parameter.KEYWORD_ONLY, option.default)
    assert str(signature.parameters["fps"]) == "fps: float | None = None"
    assert (Path(gf_usd.__file__).parent / "py.typed").is_file()


@pytest.mark.slow
def test_a_type_checker_knows_the_options_of_bake(tmp_path: Path) -> None:
    calls = {
        "gf_usd.bake('a.usda', particles=300, pins=['/A'], slice=1, progress=print).root": "",
        "gf_usd.bake(path='a.usda', wls=False, material='rubber', max_hours=2.0)": "",
        "gf_usd.bake('a.usda', particle=300)": 'No parameter named "particle"',
        "gf_usd.bake('a.usda', particles='many')": 'type "int | None"',
        "gf_usd.bake('a.usda', drop=3, floor=False, gravity=(0, -9.81, 0), prims='/A')": "",
        "gf_usd.bake('a.usda', drop=(1, 2))": 'type "float | str | None"',
        "gf_usd.bake('a.usda', device='tpu')": "Literal",
        "gf_usd.bake('a.usda') + 1": 'for types "BakeResult"',
    }
    file = tmp_path / "calls.py"
    file.write_text("\n".join(["import gf_usd", *calls]) + "\n")
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, file],
        capture_output=True, text=True, check=False, cwd=Path(__file__).parents[1],
    )  # fmt: skip
    faults = dict.fromkeys(range(1, len(calls) + 1), "")
    for fault in json.loads(done.stdout)["generalDiagnostics"]:
        if fault["severity"] == "error":
            faults[fault["range"]["start"]["line"]] += fault["message"]
    for line, expected in enumerate(calls.values(), start=1):
        assert expected in faults[line]
        assert bool(expected) == bool(faults[line]), faults[line]

"""The scripts of samples/python run, and a strict type checker has nothing to say of them."""

from __future__ import annotations

import csv
import inspect
import json
import os
import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

import gf_usd

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "samples" / "python"
PUBLIC = [getattr(gf_usd, name) for name in gf_usd.__all__ if name != "__version__"]


def script(name: str) -> Any:
    spec = spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.mark.slow
@pytest.mark.acceptance
def test_the_duck_is_baked_and_read(tmp_path: Path) -> None:
    result = script("bake_the_duck").main(ROOT / "samples" / "duck.usda", tmp_path, particles=300)
    assert (tmp_path / "duck.png").is_file()
    assert [bake.variant for bake in result.bakes] == ["rubber", "soft-foam"]
    table = tmp_path / "table.csv"
    script("read_a_bake").main(result.root, table)
    rows = list(csv.reader(table.open()))
    assert len(rows) == 1 + 24
    heights = [float(row[1]) for row in rows[1:]]
    assert max(heights) == heights[0] > min(heights)
    assert min(float(row[2]) for row in rows[1:]) < 1.0 + 1e-3


@pytest.mark.slow
def test_the_scene_is_struck() -> None:
    tips = script("simulate_a_scene").main(frames=12, particles=300)
    # gravity bends the bar by less than the hammer pushes it down, 40 mm at its tenth frame
    assert tips[0] == pytest.approx(0.025)
    assert min(tips) < 0.0


@pytest.mark.slow
def test_the_throw_is_learned() -> None:
    learn = script("learn_a_throw")
    assert learn.main(particles=100, frames=12) == pytest.approx(learn.MARK, abs=learn.CLOSE)


@pytest.mark.slow
def test_the_types_of_all_public_names_are_known(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable,
         "--verifytypes", "gf_usd.api", "--ignoreexternal"],
        capture_output=True, text=True, check=False, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    symbols = json.loads(done.stdout)["typeCompleteness"]["symbols"]
    files = {inspect.getsourcefile(made) for made in PUBLIC}
    unknown = {
        row["name"]: [fault["message"] for fault in row["diagnostics"]]
        for row in symbols
        if any(fault.get("file") in files for fault in row["diagnostics"])
        and not re.match(r"_[^_]", row["name"].rpartition(".")[2])
    }
    assert len(symbols) > 300
    assert unknown == {}


@pytest.mark.slow
def test_a_strict_type_checker_passes_the_scripts(tmp_path: Path) -> None:
    files = sorted(SCRIPTS.glob("*.py"))
    assert len(files) == 4
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import gf_usd\ngf_usd.bake('a.usda', partikles=4)\n", encoding="utf-8")
    config = tmp_path / "pyrightconfig.json"
    settings = {
        "include": [*map(str, files), str(wrong)], "typeCheckingMode": "strict",
        "extraPaths": [str(ROOT)],
        "reportMissingTypeStubs": False,
    }  # fmt: skip
    config.write_text(json.dumps(settings), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "-p",
         str(config)],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    found = json.loads(done.stdout)["generalDiagnostics"]
    errors = [
        (Path(row["file"]).name, row["range"]["start"]["line"] + 1, row["message"])
        for row in found if row["severity"] == "error"
    ]  # fmt: skip
    assert [name for name, _, _ in errors] == ["wrong.py"], errors
    assert 'No parameter named "partikles"' in errors[0][2]

"""The faults of usd-core that docs/upstream.md describes end in messages of gf-usd.

The files are made by the scripts of that page, which so stay true.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from isolated_tasks import stopped

from gf_usd.system.sandbox import Limits

PAGE = Path(__file__).parents[2] / "docs" / "upstream.md"
SCRIPTS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def made(script: str, name: str, folder: Path) -> Path:
    """The file of a script, which is stopped before it opens it."""
    writes = script[: script.index(f'open("{name}", "wb")')]
    code = f'{writes}open("{name}", "wb").write(data)\n'
    subprocess.run([sys.executable, "-c", code], cwd=folder, check=True)
    return folder / name


@pytest.mark.slow
def test_a_wrong_number_of_children(tmp_path: Path) -> None:
    file = made(SCRIPTS[0], "many_children.usdc", tmp_path)
    found = stopped([file], Limits(time=60.0))
    if not found:
        pytest.skip("this usd-core refuses the file itself: docs/upstream.md can go")
    # it reads bytes of other things as tokens: how that ends depends on what lies there
    assert re.search("caused its reader to (crash|fail)|took longer|needed more", found[file])


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_wrong_number_of_specs(tmp_path: Path) -> None:
    file = made(SCRIPTS[1], "many_specs.usdc", tmp_path)
    assert "reading it took longer than 2 s" in stopped([file], Limits(time=2.0))[file]

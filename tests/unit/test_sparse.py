"""What SciPy's sparse matrices bring along, and that they come from one place."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from gf_usd import sparse

ROOT = Path(sparse.__file__).parent


def test_a_bake_loads_nothing_of_numpy_that_it_does_not_ask_for() -> None:
    code = (
        "import sys, gf_usd.baking, gf_usd.physics.solver, gf_usd.usd.cache, gf_usd.usd.review\n"
        "print('scipy.sparse' in sys.modules,"
        " [m for m in ('numpy.f2py', 'numpy.testing') if m in sys.modules])\n"
        "import numpy; print(numpy.testing.__name__, numpy.f2py.__name__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["True []", "numpy.testing numpy.f2py"]


def test_numpy_names_all_of_it_again_afterwards_also_after_a_fault() -> None:
    before = {name: getattr(np, name) for name in sparse.LISTS}
    try:
        with sparse.unnamed():
            assert "f2py" not in np.__all__
            assert "f2py" not in getattr(np, sparse.LISTS[1])
            raise ImportError
    except ImportError:
        pass
    assert {name: getattr(np, name) for name in sparse.LISTS} == before
    assert "f2py" in np.__all__


def test_sparse_matrices_come_from_here() -> None:
    """A module that took them from SciPy first would bring the rest along."""
    taken = re.compile(r"^(from scipy import sparse|(from|import) scipy\.sparse)", re.MULTILINE)
    files = [path for path in ROOT.rglob("*.py") if taken.search(path.read_text())]
    assert files == []

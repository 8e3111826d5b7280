"""Imports of Taichi and SciPy leave out what is not used, and nothing is missing."""

import os
import subprocess
import sys

import pytest

from gf_usd.core import FAST_START

SCIPY = """
import sys
from gf_usd.system.fast_start.imports import install
install()
import scipy.sparse
print(*(name for name in ("numpy.f2py", "numpy.ma", "numpy.testing") if name in sys.modules))
from scipy._lib.array_api_compat import numpy as view
import numpy
assert view.ma is numpy.ma and view.testing is numpy.testing and view.f2py is numpy.f2py
assert {"sum", "float64", "linalg"} <= set(view.__all__)
assert not set(numpy.__all__) - set(dir(numpy))
try:
    view.nothing
except AttributeError:
    print("no")
import scipy.linalg, scipy.ndimage, scipy.optimize, scipy.special
"""
TAICHI = """
import sys
from gf_usd.system.taichi_runtime import import_taichi
taichi = import_taichi()
print(*(name for name in ("dill", "taichi._version_check") if name in sys.modules))
from taichi.lang import _wrap_inspect
import dill
assert _wrap_inspect.dill.source is dill.source
import taichi._version_check
print(taichi._version_check.try_check_version.__name__)
"""


def printed(code: str, switch: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, FAST_START: switch},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.splitlines()


@pytest.mark.slow
def test_scipys_view_of_numpy_asks_for_the_rest_later() -> None:
    quick, plain = printed(SCIPY, "1"), printed(SCIPY, "0")
    assert quick == ["", "no"]
    assert plain[1] == "no"
    assert "numpy.testing" in plain[0], "otherwise SciPy needs no help any more"


@pytest.mark.slow
def test_taichi_is_imported_without_what_it_asks_for_later() -> None:
    assert printed(TAICHI, "1") == ["", "try_check_version"]
    assert printed(TAICHI, "0") == ["dill taichi._version_check", "try_check_version"]

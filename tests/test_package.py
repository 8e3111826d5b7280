"""The public names of the package."""

from __future__ import annotations

import subprocess
import sys

import pytest

import gf_usd


@pytest.mark.parametrize(
    "code",
    [
        "import gf_usd; gf_usd.bake; made = gf_usd.bake",
        "from gf_usd import bake as made",
        "import gf_usd.cli.bake; from gf_usd.pipeline.run import run; made = gf_usd.bake",
        "import gf_usd.pipeline.run; made = gf_usd.bake",
    ],
)
def test_bake_is_the_function_whatever_is_imported_first(code: str) -> None:
    # Importing a submodule binds it to its package: in a process of its own, for each order.
    code += "; print(made.__module__, made.__qualname__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("gf_usd.pipeline.run bake", "")


def test_every_public_name_is_there_and_is_listed() -> None:
    assert dir(gf_usd) == sorted(gf_usd.__all__)
    for name in gf_usd.__all__:
        assert getattr(gf_usd, name) is not None
    assert issubclass(gf_usd.UsageError, gf_usd.GfUsdError)


def test_other_names_are_refused() -> None:
    with pytest.raises(AttributeError) as caught:
        _ = gf_usd.cake
    assert str(caught.value) == "module 'gf_usd' has no attribute 'cake'"

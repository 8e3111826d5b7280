"""gf-usd view, as far as it goes without a window."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys

import pytest


def test_no_open3d_is_said_before_the_file_is_read(gf_usd, here, monkeypatch):
    real = importlib.import_module

    def without(name, package=None):
        if name == "open3d":
            raise ModuleNotFoundError("No module named 'open3d'", name="open3d")
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", without)
    done = gf_usd("view", "gone.usda")
    assert (done.status, done.out) == (2, "")
    assert "open3d, which is not installed" in done.err
    assert "pip install open3d" in done.err


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only X has displays to miss")
@pytest.mark.parametrize("display", [None, ":9731"])
def test_no_display_ends_in_words_and_no_crash(here, display):
    # a module instead of open3d: it must not come so far as to use it
    (here / "open3d.py").write_text("", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(here)}
    environment.pop("DISPLAY", None)
    if display:
        environment["DISPLAY"] = display
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", "view", "gone.usda"],
        check=False, capture_output=True, text=True, env=environment,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert "display" in done.stderr
    assert "gf-usd report" in done.stderr


def test_help_says_the_keys_and_loads_nothing(gf_usd):
    done = gf_usd("view", "--help")
    assert done.status == 0
    for word in ("Space", "arrow", "G ", "R ", "open3d"):
        assert word in done.out

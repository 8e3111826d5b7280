"""Messages where a window lacks a library or a display."""

from __future__ import annotations

import ctypes
import importlib

import pytest

from gf_usd.core.errors import UsageError
from gf_usd.view.window import requirements


def test_no_open3d_is_said_with_the_extra(monkeypatch):
    def gone(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(importlib, "import_module", gone)
    with pytest.raises(UsageError, match="Python module open3d") as caught:
        requirements.import_open3d()
    assert "pip install open3d" in caught.value.hint


def test_a_missing_library_is_said_with_its_package(monkeypatch):
    def broken(name):
        raise ImportError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.setattr(importlib, "import_module", broken)
    with pytest.raises(UsageError, match=r"libusb-1\.0\.so\.0") as caught:
        requirements.import_open3d()
    assert "apt-get install" in caught.value.hint
    assert "libusb-1.0-0" in caught.value.hint


@pytest.mark.parametrize(
    ("display", "message"),
    [(None, "DISPLAY is not set"), ("", "DISPLAY is not set"), (":9731", "cannot be opened")],
)
def test_no_display_is_said_before_a_window_is_tried(monkeypatch, display, message):
    monkeypatch.setattr(requirements.sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    if display is not None:
        monkeypatch.setenv("DISPLAY", display)
    with pytest.raises(UsageError, match=message) as caught:
        requirements.require_display()
    assert "gf-usd report" in caught.value.hint


def test_no_x11_is_said_with_its_package(monkeypatch):
    def gone(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(requirements.sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(ctypes, "CDLL", gone)
    with pytest.raises(UsageError, match="libX11") as caught:
        requirements.require_display()
    assert "libx11-6" in caught.value.hint

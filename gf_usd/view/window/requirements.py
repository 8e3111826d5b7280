"""What a window needs: open3d, its system libraries, and a display.

open3d is an optional dependency, because it is large and needs system libraries.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from typing import Any

from gf_usd.core.errors import UsageError

PACKAGES = "on Debian and Ubuntu: apt-get install libx11-6 libgl1 libegl1 libusb-1.0-0 libgomp1"
ALTERNATIVE = "gf-usd report writes a page that plays in a browser"


def import_open3d() -> Any:
    """Import open3d.

    Raises UsageError where open3d or a system library that it needs is not installed.
    """
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise UsageError(
            f"a window needs the Python module {error.name}, which is not installed",
            f"pip install open3d; without it, {ALTERNATIVE}",
        ) from error
    except (ImportError, OSError) as error:
        raise UsageError(
            f"open3d is installed, but a system library that it needs is not: {error}", PACKAGES
        ) from error


def require_display() -> None:
    """Raise UsageError where no X display can be opened, on Linux.

    Without a display, open3d crashes at the first use of its window.
    """
    if not sys.platform.startswith("linux"):
        return
    name = os.environ.get("DISPLAY")
    if not name:
        raise UsageError(
            "there is no display: the environment variable DISPLAY is not set",
            f"run it on a desktop, or under xvfb-run; without a display, {ALTERNATIVE}",
        )
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError as error:
        raise UsageError(
            f"a system library that a window needs is not installed: {error}", PACKAGES
        ) from error
    x11.XOpenDisplay.argtypes = [ctypes.c_char_p]
    x11.XOpenDisplay.restype = ctypes.c_void_p
    x11.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = x11.XOpenDisplay(None)
    if not display:
        raise UsageError(
            f"the display DISPLAY={name} cannot be opened",
            f"check that it is running and that you may use it; without a display, {ALTERNATIVE}",
        )
    x11.XCloseDisplay(display)

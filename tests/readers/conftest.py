"""Small USD stages, written as text so that a test shows what it reads."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gf_usd.core.asset import Asset
from gf_usd.readers import read_asset

HEADER = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
)
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write text (or bytes) under a name; a body without a header gets one in meters, Y up."""

    def write(body: str | bytes, name: str = "asset.usda") -> Path:
        path = tmp_path / name
        if isinstance(body, bytes):
            path.write_bytes(body)
        else:
            path.write_text(body if body.startswith("#usda") else HEADER + body)
        return path

    return write


@pytest.fixture
def read(write: Callable[..., Path]) -> Callable[..., Asset]:
    """Read a stage given as text."""

    def read(body: str, **options: object) -> Asset:
        return read_asset(write(body), **options)  # type: ignore[arg-type]

    return read


@pytest.fixture
def picture(tmp_path: Path) -> np.ndarray:
    """A 2 x 3 picture t.png next to the stage; every texel differs."""
    pixels = (np.arange(18, dtype=np.uint8) * 10).reshape(2, 3, 3)
    Image.fromarray(pixels).save(tmp_path / "t.png")
    return pixels

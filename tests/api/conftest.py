"""What the tests of the Python functions share."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def _draw_quickly(small_pictures: None) -> None:
    """The functions hand over what is drawn: see `small_pictures`."""

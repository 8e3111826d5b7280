"""What the tests of the page share."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def _draw_quickly(small_pictures: None) -> None:
    """The page has pictures, of which `view/render` tests what they show: see `small_pictures`."""

"""What all tests of this folder have."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def _sample_volumes_coarsely(coarse_volumes: None) -> None:
    """The plan is made of volumes, and is tested with larger tolerances: see `coarse_volumes`."""

"""What all tests of this folder have."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def _sample_volumes_coarsely(coarse_volumes: None) -> None:
    """Which meshes are one body does not depend on it: see `coarse_volumes`."""

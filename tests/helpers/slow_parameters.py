"""Parameters of a test of which few run by default and the others with the slow tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def slow_but(values: Iterable[Any], *quick: Any) -> list[Any]:
    """``values`` for ``parametrize``, those that are not in ``quick`` marked as slow."""
    return [v if v in quick else pytest.param(v, marks=pytest.mark.slow) for v in values]


def longest_but(values: Iterable[Any], *kept: Any) -> list[Any]:
    """The same for a slow test: those that are not in ``kept`` are marked for the acceptance."""
    mark = pytest.mark.acceptance
    return [value if value in kept else pytest.param(value, marks=mark) for value in values]

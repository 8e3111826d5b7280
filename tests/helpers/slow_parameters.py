"""Parameters of a test of which few run by default and the others with the slow tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def slow_but(values: Iterable[Any], *quick: Any) -> list[Any]:
    """``values`` for ``parametrize``, those that are not in ``quick`` marked as slow."""
    return [v if v in quick else _marked(v, pytest.mark.slow) for v in values]


def longest_but(values: Iterable[Any], *kept: Any) -> list[Any]:
    """The same for a slow test: those that are not in ``kept`` are marked for the acceptance."""
    return [v if v in kept else _marked(v, pytest.mark.acceptance) for v in values]


def _marked(value: Any, mark: pytest.MarkDecorator) -> Any:
    """A tuple has the values of several parameters."""
    return pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=mark)

"""Numbers with their nouns in messages."""

from __future__ import annotations

import pytest

from gf_usd.core.errors import counted


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((0, "error"), "0 errors"),
        ((1, "error"), "1 error"),
        ((2, "error"), "2 errors"),
        ((1, "mesh", "meshes"), "1 mesh"),
        ((3, "mesh", "meshes"), "3 meshes"),
    ],
)
def test_a_noun_agrees_with_its_number(words: tuple[int, str], said: str) -> None:
    assert counted(*words) == said

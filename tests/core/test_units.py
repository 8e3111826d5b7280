"""Numbers of bytes as text."""

from __future__ import annotations

import pytest

from gf_usd.core.units import bytes_text


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (999.6, "1 kB"),
        (2000, "2 kB"),
        (386_400, "386 kB"),
        (999_700, "1 MB"),
        (2_308_000, "2.31 MB"),
        (73_196_650, "73.2 MB"),
        (12.34e9, "12.3 GB"),
        (4321e9, "4321 GB"),
    ],
)
def test_bytes_have_the_unit_that_fits(count: float, text: str):
    assert bytes_text(count) == text

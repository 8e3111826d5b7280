"""Numbers of bytes and lengths as text."""

from __future__ import annotations

import pytest

from gf_usd.core.units import (
    bytes_text,
    code_text,
    length_text,
    percent_text,
    rounded_text,
    volume_text,
)


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


@pytest.mark.parametrize(
    ("meters", "text"),
    [
        (2e-6, "2 µm"),
        (0.0042, "4.2 mm"),
        (0.1234, "12.3 cm"),
        (1.0, "1 m"),
        (2345.0, "2.35 km"),
        (999.96, "1 km"),
        (0.9999, "1 m"),
        (0.9999e-3, "1 mm"),
        (1e6, "1000 km"),
        (-0.004, "-4 mm"),
        (0.0, "0 m"),
    ],
)
def test_lengths_have_the_unit_that_fits(meters: float, text: str):
    assert length_text(meters) == text


@pytest.mark.parametrize(
    ("cubic_meters", "text"),
    [
        (0.0, "0 mm³"),
        (2.986e-7, "299 mm³"),
        (1.29e-4, "129 cm³"),
        (1.7e-3, "1700 cm³"),  # it was 1.7e+03 cm³
        (0.0099996, "10000 cm³"),
        (0.0384, "0.0384 m³"),
        (1088.0, "1090 m³"),
        (5.1482e5, "515000 m³"),
        (1e12, "1e+12 m³"),
    ],
)
def test_volumes_have_three_digits_and_no_exponent(cubic_meters: float, text: str):
    assert volume_text(cubic_meters) == text


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0.0, "0"),
        (-24.0, "-24"),
        (25 / 24, "1.04167"),
        (1_000_001.0, "1000001"),
        (1e9, f"{10**9}"),
        (-1e-7, "0"),
    ],
)
def test_time_codes_have_no_exponent(code: float, text: str):
    assert code_text(code) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0123, "0.012"), (99.4, "99"), (99.6, "100"), (213.0, "210"), (-250.0, "-250")],
)
def test_two_digits_have_no_exponent_from_a_hundred_on(value: float, text: str) -> None:
    assert rounded_text(value) == text


def test_all_is_a_hundred_percent() -> None:
    """Warnings wrote 1e+02 %."""
    assert [percent_text(share) for share in (1.0, 0.034)] == ["100 %", "3.4 %"]

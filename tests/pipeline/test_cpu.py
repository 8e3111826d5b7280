"""How fast the CPU of this machine is, for estimates of time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from gf_usd.pipeline.cost import cpu
from gf_usd.pipeline.cost.cpu import (
    REFERENCE_SECONDS,
    cpu_time_ratio,
    first_seconds,
    least_seconds,
)


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """No test sees what another one has measured."""
    for measured in (cpu_time_ratio, first_seconds):
        measured.cache_clear()
    yield
    for measured in (cpu_time_ratio, first_seconds):
        measured.cache_clear()


def test_the_quickest_run_counts() -> None:
    times = iter([0.0, 5.0, 5.0, 7.0, 10.0, 13.0])  # of 5, 2 and 3 s
    runs: list[int] = []
    assert least_seconds(lambda: runs.append(1), 3, clock=lambda: next(times)) == 2.0
    assert len(runs) == 3


@pytest.mark.parametrize("times", [(2.5, 4.0), (4.0, 2.5)])
def test_the_ratio_is_the_lower_of_two_to_the_reference_and_measured_once(
    monkeypatch: pytest.MonkeyPatch, times: tuple[float, float]
) -> None:
    """A core was slow for some milliseconds, and the estimate 1.6 times too long."""
    measured = iter([one * REFERENCE_SECONDS for one in times])
    monkeypatch.setattr(cpu, "least_seconds", lambda work, repeats: next(measured))
    first_seconds()
    assert cpu_time_ratio() == 2.5
    assert cpu_time_ratio() == 2.5


def test_a_machine_has_a_finite_ratio() -> None:
    assert 0.0 < cpu_time_ratio() < float("inf")

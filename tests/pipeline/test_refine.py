"""--until: when to bake again, and how finely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from gf_usd.core.errors import UsageError
from gf_usd.pipeline.measures.certify import Certificate
from gf_usd.pipeline.measures.convergence import Interval, unknown
from gf_usd.pipeline.measures.refine import (
    COARSEST,
    FINEST,
    MARGIN,
    Refining,
    Until,
    next_step,
)


def certificate(**widths: float | None) -> Certificate:
    """Figures of magnitude 1 with these half widths; None: not known.  Order 1."""
    one = np.array([1.0])
    return Certificate(
        runs=((4096, 0.1),),
        figures={
            name: unknown(one, "it is chaotic")
            if half is None
            else Interval(fine=one, value=one, half=half, order=1.0)
            for name, half in widths.items()
        },
    )


@pytest.mark.parametrize("text", ["2", "0%", "100%", "x%", "", "nan%", "size:2%", "rebound:2"])
def test_invalid_texts_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--until") as caught:
        Until.of(text)
    assert caught.value.hint


def test_figures_and_a_share() -> None:
    assert Until.of("2%") == Until(names=(), share=0.02)
    assert Until.of("rebound, peak-strain:0.5%").names == ("rebound", "peak_strain")
    assert Until.of("rebound:0.5%").share == pytest.approx(0.005)


def test_what_is_certain_enough_is_done() -> None:
    found = [certificate(squash=0.01, rebound=0.02, peak_strain=0.5)]
    step = next_step(Until.of("2%"), found, seconds=10.0, spent=10.0, budget=3600.0)
    assert step.spacing is None
    assert "rebound of the center of mass +- 2 %" in step.reason


def test_the_next_spacing_follows_from_the_order() -> None:
    found = [certificate(squash=0.025)]
    step = next_step(Until.of("2%"), found, seconds=1.0, spent=1.0, budget=3600.0)
    assert step.spacing == pytest.approx(0.1 * MARGIN * 0.02 / 0.025)
    far = next_step(Until.of("0.1%"), found, seconds=1.0, spent=1.0, budget=3600.0)
    assert far.spacing == pytest.approx(0.1 * FINEST)
    near = next_step(Until.of("2.49%"), found, seconds=1.0, spent=1.0, budget=3600.0)
    assert near.spacing == pytest.approx(0.1 * COARSEST)


def test_the_budget_ends_it() -> None:
    found = [certificate(squash=0.5)]
    # half of the spacing is 16 times the work
    step = next_step(Until.of("2%"), found, seconds=10.0, spent=10.0, budget=169.0)
    assert step.spacing is None
    assert "was not reached" in step.reason
    more = next_step(Until.of("2%"), found, seconds=10.0, spent=10.0, budget=171.0)
    assert more.spacing is not None


def test_what_is_chaotic_matters_where_it_is_asked_for() -> None:
    found = [certificate(squash=0.01, rebound=None)]
    assert next_step(Until.of("2%"), found, seconds=1.0, spent=1.0, budget=99.0).spacing is None
    named = next_step(Until.of("rebound:2%"), found, seconds=1.0, spent=1.0, budget=99.0)
    assert named.spacing == pytest.approx(0.1 * FINEST)
    assert "without an interval" in named.reason


def test_a_figure_that_is_not_there_ends_it() -> None:
    step = next_step(
        Until.of("sag:2%"), [certificate(squash=0.1)], seconds=1.0, spent=1.0, budget=9.0
    )
    assert step.spacing is None
    assert "none of the figures sag" in step.reason


@dataclass
class Baked:
    """What `Refining.bake_again` reads of a result."""

    certificate: Certificate
    seconds: float = 1.0

    @property
    def bakes(self):
        return [self]


def test_bakes_follow_until_it_is_certain() -> None:
    refining = Refining("2%", 1.0, {"particles": 4096, "overwrite": False})
    assert refining.options["certify"]
    assert refining.bake_again(Baked(certificate(squash=0.1)), unit=0.01)
    assert refining.options["particles"] is None
    assert refining.options["spacing"] == pytest.approx(0.1 * FINEST / 0.01)
    assert refining.options["overwrite"]
    assert refining.hours == pytest.approx(1.0 - 1.0 / 3600.0)
    assert not refining.bake_again(Baked(certificate(squash=0.01)), unit=0.01)
    assert len(refining.notes) == 2


def test_without_it_there_is_one_bake() -> None:
    refining = Refining(None, 1.0, {"particles": 4096})
    assert refining.options == {"particles": 4096}
    assert not refining.bake_again(Baked(certificate(squash=0.5)), unit=1.0)
    assert refining.notes == []

"""A coarse sibling of the case `locking`, which is slow."""

from __future__ import annotations

import pytest

from gf_usd.verify.cases.elastic.locking import locking


@pytest.mark.slow
def test_bending_does_not_lock() -> None:
    """A square beam of 8 x 1 with two cells through its thickness."""
    soft, nearly_incompressible = locking((0.0, 0.49), cells=2, periods=0.75)("cpu")
    assert soft.passed, soft.value
    assert nearly_incompressible.passed, nearly_incompressible.value
    # locking shows as stiffness that grows with nu: the errors differ by far less than their bound
    difference = nearly_incompressible.value - soft.value
    assert abs(difference) < 0.01 * nearly_incompressible.bound

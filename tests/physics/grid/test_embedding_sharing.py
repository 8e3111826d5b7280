"""Rows of a sparse product, shared: the same bits as alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from gf_usd.physics.grid import embedding


@pytest.mark.parametrize("parts", [1, 2, 3, 7])
@pytest.mark.parametrize("width", [None, 3])
def test_a_shared_product_is_the_product(monkeypatch, parts: int, width: int | None) -> None:
    rng = np.random.default_rng(0)
    M = sparse.random(100, 40, density=0.2, format="csr", random_state=1)
    u = rng.standard_normal(40 if width is None else (40, width))
    monkeypatch.setattr(embedding, "FEW", 10)
    monkeypatch.setattr(embedding, "threads", lambda: parts)
    assert np.array_equal(embedding.product(M, u), M @ u)


def test_few_rows_are_not_shared(monkeypatch) -> None:
    monkeypatch.setattr(embedding, "threads", lambda: 8)
    monkeypatch.setattr(embedding, "_pool", lambda size: pytest.fail(f"{size} threads"))
    M = sparse.eye(embedding.FEW + 1, format="csr")
    assert np.array_equal(embedding.product(M, np.ones((embedding.FEW + 1, 3))), np.ones((4097, 3)))

"""The row of the law of `von_mises_law`, registered for a test, and its closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from gf_usd.core import materials
from gf_usd.core.materials import Internal, LawSpec, Parameter
from gf_usd.verify.cases import patch

YIELD = Parameter(
    name="yield_stress",
    unit="Pa",
    attribute="yieldStress",
    default=1e9,
    meaning="Uniaxial stress at which the material begins to flow.",
    label="Yield stress",
)
ROW = LawSpec(
    token="testFlow",
    code="von_mises_law",
    source="Simo and Hughes 1998, boxes 3.1 and 9.1",
    parameters=(YIELD,),
    flows=True,
    internal=(Internal(name="plastic_strain", rest=0.0),),
)


def reference(F: np.ndarray, mu: float, lam: float) -> np.ndarray:
    """P = U diag((2 mu e_i + lam sum e) / s_i) V^T of an upright F below yield."""
    U, s, Vt = np.linalg.svd(F)
    e = np.log(s)
    return U @ np.diag((2.0 * mu * e + lam * e.sum()) / s) @ Vt


@contextmanager
def registered() -> Iterator[LawSpec]:
    """The law is one of LAWS, with its reference formula, as long as this lasts."""
    materials.LAWS[ROW.token] = ROW
    patch.REFERENCE[ROW.token] = reference
    try:
        yield ROW
    finally:
        del materials.LAWS[ROW.token], patch.REFERENCE[ROW.token]

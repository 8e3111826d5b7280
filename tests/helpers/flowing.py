"""The row of the law of `von_mises_law`, registered for a test, and its closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from gf_usd.core.materials.laws import LAWS, YIELD_STRESS, Internal, LawSpec
from gf_usd.verify.cases import patch

ROW = LawSpec(
    token="testFlow",
    code="von_mises_law",
    source="Simo and Hughes 1998, boxes 3.1 and 9.1",
    parameters=(YIELD_STRESS,),
    flows=True,
    internal=(Internal(name="plastic_strain", rest=0.0),),
)


@contextmanager
def registered() -> Iterator[LawSpec]:
    """The law is one of LAWS, with its reference formula, as long as this lasts."""
    LAWS[ROW.token] = ROW
    patch.REFERENCE[ROW.token] = patch.hencky
    try:
        yield ROW
    finally:
        del LAWS[ROW.token], patch.REFERENCE[ROW.token]

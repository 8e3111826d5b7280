"""What ``import gf_usd`` offers."""

from __future__ import annotations

import gf_usd


def test_every_public_name_is_what_it_says_however_often_it_is_asked():
    # A function that shares its module's name is replaced by the module at the first import.
    for _ in range(2):
        for name in gf_usd.__all__:
            assert getattr(gf_usd, name).__class__.__name__ != "module"
    assert callable(gf_usd.bake)
    assert callable(gf_usd.bake)

"""Values of an asset that need no reader."""

from __future__ import annotations

import pytest

from gf_usd.core.asset import prim_name


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("left one", "left_one"),
        ("3D-Model", "_3D_Model"),
        ("Größe é", "Grou00DFe_e"),
        ("e\u0301", "e"),  # as macOS writes é
        ("形体", "u5F62u4F53"),
        ("か", "u304B"),
        ("が", "u304C"),  # か and a mark, which is no accent
        ("😀", "u1F600"),
        ("a\u2013b", "a_b"),
        ("", "_"),
    ],
)
def test_names_of_prims_are_ascii_and_keep_what_they_can(text: str, name: str) -> None:
    assert prim_name(text) == name

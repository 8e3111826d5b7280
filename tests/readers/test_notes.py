"""Notes of a reader that concern several prims."""

from __future__ import annotations

from gf_usd.readers.notes import Notes


def test_texts_are_in_the_singular_however_many_prims_they_concern():
    notes = Notes()
    notes.add("the file has no unit")
    for count in (1, 2, 4):
        for number in range(count):
            notes.add(f"is {count}", f"/P{number}")
    assert notes.lines() == (
        "the file has no unit",
        "</P0>: is 1",
        "each of </P0> and </P1>: is 2",
        "each of </P0> and 3 more: is 4",
    )

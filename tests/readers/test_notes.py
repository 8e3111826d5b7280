"""Notes of a reader that concern several prims."""

from __future__ import annotations

from gf_usd.readers.notes import Notes, merged


def test_texts_are_in_the_singular_however_many_prims_they_concern():
    notes = Notes()
    notes.add("the file has no unit")
    for count in (1, 2, 4):
        for number in range(count):
            notes.add(f"is {count}", f"/P{number}")
    assert notes.lines() == (
        "the file has no unit",
        "</P0> is 1",
        "each of </P0> and </P1> is 2",
        "each of </P0> and 3 more is 4",
    )


def test_equal_notes_on_several_prims_are_one():
    assert merged(
        [
            "</A> is filled despite 2 holes; --repair fixes this",
            "the floor is at height 0",
            "</B> is filled despite 1 hole; --repair fixes this",
            *(f"</C{k}> is filled despite 2 holes; --repair fixes this" for k in range(3)),
            "</B> is foam",
            *(f"</C{k}> is foam" for k in range(3)),
            "</D> is filled despite 1 hole; --repair fixes this",
            "</A> and </B> is no sentence",
            "the floor is at height 0",
        ],
        ["</B> is foam"],
    ) == (
        "each of </A> and 3 more is filled despite 2 holes; --repair fixes this",
        "the floor is at height 0",
        "</B> is filled despite 1 hole; --repair fixes this",
        "</B> is foam",
        *(f"</C{k}> is foam" for k in range(3)),
        "</D> is filled despite 1 hole; --repair fixes this",
        "</A> and </B> is no sentence",
    )

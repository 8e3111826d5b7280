"""Notes of a reader on assumptions, repairs and omissions, without repetition."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

from gf_usd.core.asset import ASSUMED, FILE, OPTION, prim_name
from gf_usd.core.errors import listed
from gf_usd.core.units import number_text

ANIMATED = "is animated: the simulation starts from its pose at the first frame"
FLESH_KEEPS = "--flesh keeps the animation, and makes the flesh around the bones soft"
POSED = (
    "is animated by its skeleton: the simulation starts from its pose at the first frame; "
    + FLESH_KEEPS
)


VERB = re.compile(r"(?:is|has|was) ")  # at the start of a text about one prim
ALONE = re.compile(rf"<(?P<path>/[^<>]*)>(?P<text> {VERB.pattern}.*)", re.DOTALL)  # of one prim
MANY = 4  # prims with equal notes, from which on they are one note


class Notes:
    """Notes in order of first appearance; equal texts for several prims are merged."""

    def __init__(self) -> None:
        self._places: dict[str, list[str]] = {}

    def add(self, text: str, where: str = "") -> None:
        """Add a note on the prim path `where`; empty: on the whole file."""
        places = self._places.setdefault(text, [])
        if where and where not in places:
            places.append(where)

    def drop(self, text: str, where: str) -> None:
        """Take back a note on the prim path `where`."""
        places = self._places.get(text, [])
        if where in places:
            places.remove(where)
            if not places:
                del self._places[text]

    def lines(self, without: Collection[str] = ()) -> tuple[str, ...]:
        """One line per note: ``<PATH>: text``, or ``<PATH> is text`` of texts with a verb first.

        Of several prims: ``each of <PATH> and 3 more is text``.
        without : texts that are omitted.
        """
        return tuple(
            f"{_some(places)}{' ' if VERB.match(text) else ': '}{text}" if places else text
            for text, places in self._places.items()
            if text not in without
        )


def merged(notes: Iterable[str], without: Collection[str] = ()) -> tuple[str, ...]:
    """Notes in which ``<PATH> is TEXT`` of `MANY` prims is ``each of <PATH> and 3 more is TEXT``.

    They are in order of first appearance.  Instances of one asset have such notes.

    without : notes that stay as they are.
    """
    whole = dict.fromkeys(notes)  # each once
    texts: dict[str, str] = {}
    places: dict[str, list[str]] = {}
    for note in whole:
        alone = None if note in without else ALONE.fullmatch(note)
        if alone:
            texts[note] = alone["text"]
            places.setdefault(alone["text"], []).append(alone["path"])
    joined = {
        note: _some(places[text]) + text
        for note, text in texts.items()
        if len(places[text]) >= MANY
    }
    return tuple(dict.fromkeys(joined.get(note, note) for note in whole))


def source_of(given: object | None, known: bool) -> str:
    """Origin of a unit or an axis: OPTION if `given` for, FILE if `known` from it, or ASSUMED."""
    if given is not None:
        return OPTION
    return FILE if known else ASSUMED


def unit_and_axis(
    kind: str,
    unit: float,
    axis: str,
    unit_from: str,
    axis_from: str,
    hint: str = "",
    width: float = 0.0,
) -> list[str]:
    """Notes on the unit [m] and the up axis of a file, unless they are from the file.

    kind : name of the format.
    unit_from, axis_from : of `source_of`.
    hint : appended to the option in the note on an assumed axis.
    width : of the body in units of the file, where the assumed unit was chosen by it; else 0.
    """
    chosen = ""
    if width and unit != 1.0:
        chosen = (
            f", which makes the body {number_text(width * unit)} m wide instead of"
            f" {number_text(width)} m"
        )
    phrases = {
        OPTION: (f"metersPerUnit = {unit:g}, as requested", f"upAxis = {axis}, as requested"),
        ASSUMED: (
            f"{kind} files state no unit: {unit:g} m per unit is assumed{chosen}"
            " (--meters-per-unit)",
            f"{kind} files state no up axis: {axis} is assumed (--up-axis{hint})",
        ),
    }
    if unit_from == axis_from == ASSUMED:
        return [
            f"{kind} files state no unit and no up axis: {unit:g} m per unit is assumed{chosen}"
            f" (--meters-per-unit), and {axis} up (--up-axis{hint})"
        ]
    return [
        phrases[origin][which]
        for which, origin in enumerate((unit_from, axis_from))
        if origin != FILE
    ]


def renamed(names: Iterable[str]) -> list[str]:
    """A note on names that are not ASCII, with the names of their prims; none: no note."""
    other = [name for name in dict.fromkeys(names) if not name.isascii()]
    if not other:
        return []
    names = listed([f"{name!r} is {prim_name(name.strip())}" for name in other])
    return [
        f"prims are named in ASCII, as USD before 24.03 requires: {names}; displayName has"
        " the name in the file"
    ]


def _some(places: list[str]) -> str:
    named = [f"<{place}>" if place.startswith("/") else place for place in places[:2]]
    if len(places) == 1:
        return named[0]
    others = named[1] if len(places) == 2 else f"{len(places) - 1} more"
    return f"each of {named[0]} and {others}"  # texts are in the singular: "is an instance"

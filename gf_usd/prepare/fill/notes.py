"""Notes of a plan on what is not filled, not baked, or has no effect."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.material import Material
from gf_usd.prepare import paper as paper_options

if TYPE_CHECKING:
    from gf_usd.core.asset import StageFacts
    from gf_usd.core.stage import Advice
    from gf_usd.geometry.solid import Solid

FAST = 120.0  # frames per second above which time codes are rarely meant to be frames
MOST_NAMED = 3  # prims that each have a note of their own for the same reason


def not_baked_notes(skipped: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """The notes on prims that are not baked, each with a reason of the reader."""
    from gf_usd.prepare.bodies.flesh.characters import GROUND, OWN, PROP, SHEET
    from gf_usd.prepare.bodies.grounds import ROOM, SCENERY, WALL
    from gf_usd.readers.usd.select import KINDS, PROXY, REPEATED

    stays = "keeps the place and motion of its source and does not follow what is baked"
    ways = {
        KINDS: f"; it {stays}: attach it to a baked mesh in another program, or convert it to one",
        REPEATED: f"; it {stays}: attach its instances in another program, or make them prims",
        **dict.fromkeys(
            (SCENERY, WALL, GROUND),
            f"; it {stays}: apply PhysicsCollisionAPI to make it an obstacle",
        ),
        SHEET: f"; it {stays}: bind it to the skeleton, or animate it, to make it follow, or apply"
        " PhysicsCollisionAPI to make it an obstacle",
        ROOM: f"; it {stays}. Bodies collide with the floor of the bake, not with it: apply"
        " PhysicsCollisionAPI to make it an obstacle, or turn its faces outward to make it soft",
        OWN: f"; it {stays}: bind it to the skeleton to make it follow, or apply"
        " PhysicsCollisionAPI to make it an obstacle",
        PROP: f"; it {stays}: bake it by itself (--prim), or apply PhysicsCollisionAPI to make it"
        " an obstacle",
        PROXY: f"; it {stays}: viewers that draw proxies, as usdview does by default, show it at"
        " rest unless it is hidden, or the purpose render is drawn instead",
    }

    def note(path: str, more: int, reason: str) -> str:
        way = next((text for end, text in ways.items() if reason.endswith(end)), "")
        others = f" and {more} more are" if more else " is"
        return f"<{path}>{others} not baked: {reason}{way}"

    return tuple(note(*group) for group in by_reason(skipped))


# How meshes that are not filled move: of one, and of several.
WITH_BODY = ("moves with a body near it", "move with bodies near them")
SKINNED = (
    "follows its skinned pose, and the flesh near it,",
    "follow their skinned poses, and the flesh near them,",
)
WITH_JOINT = ("moves exactly with its joint", "move exactly with their joints")


def not_filled_notes(
    solid: Solid, sheets: Collection[str] = (), held: Collection[str] = ()
) -> tuple[str, ...]:
    """The notes on meshes that move with a body, each with the reason why it is not filled.

    Those on sides of walls are `Walls.notes`.

    sheets, held : prim paths of those that follow their skinned pose, and those that a joint moves.
    """

    def note(path: str, more: int, reason: str, way: tuple[str, str]) -> str:
        if more:
            return (
                f"<{path}> and {more} more are not filled: they {way[1]} and do not collide;"
                f" {reason}"
            )
        return f"<{path}> is not filled: it {way[0]} and does not collide; {reason}"

    def way_of(path: str) -> tuple[str, str]:
        return WITH_JOINT if path in held else SKINNED if path in sheets else WITH_BODY

    left = [one for one in solid.embedded if one[0] not in solid.walls]
    return tuple(
        note(*group, way)
        for way in (WITH_BODY, SKINNED, WITH_JOINT)
        for group in by_reason(one for one in left if way_of(one[0]) is way)
    )


def advice_notes(advice: Sequence[Advice]) -> tuple[str, ...]:
    """The notes on the materials that ``--material auto`` chose."""
    return tuple(
        f"<{path}> and {more} more are {chosen}" if more else f"<{path}> is {chosen}"
        for path, more, chosen in by_reason((one.path, one.chosen) for one in advice)
    )


def by_reason(prims: Iterable[tuple[str, str]]) -> list[tuple[str, int, str]]:
    """(path, 0, reason) of each prim (path, reason).

    Of more than `MOST_NAMED` prims with the same reason only the first is listed, with the number
    of the others.
    """
    paths: dict[str, list[str]] = {}
    for path, reason in prims:
        paths.setdefault(reason, []).append(path)
    return [
        (path, len(group) - 1 if len(group) > MOST_NAMED else 0, reason)
        for reason, group in paths.items()
        for path in (group if len(group) <= MOST_NAMED else group[:1])
    ]


def rate_notes(facts: StageFacts, settings: Settings, fps: float | None) -> tuple[str, ...]:
    """A note where a file has so many time codes per second that they are hardly frames.

    fps : of the command line; None: that of the file.
    """
    by_codes = settings.fps == facts.time_codes_per_second and facts.frames_per_second is None
    if fps is not None or not by_codes or settings.fps <= FAST:
        return ()
    return (
        f"{settings.fps:g} frames per second are written, one for each time code, because the file"
        " states no framesPerSecond: --fps 24 writes fewer",
    )


def paper_notes(materials: Sequence[Material], each: Sequence[Settings]) -> tuple[str, ...]:
    """Notes on the paper's options, once where they are the same for all materials."""
    if all(settings == each[0] for settings in each):
        return paper_options.notes(each[0])
    pairs = zip(materials, each)
    return tuple(note for m, s in pairs for note in paper_options.notes(s, m.name))


def no_internals_notes(materials: Sequence[Material], settings: Settings) -> tuple[str, ...]:
    """A note where `--internal` has no effect."""
    if not settings.internal or any(LAWS[m.law].flows for m in materials):
        return ()
    laws = ", ".join(dict.fromkeys(m.law for m in materials))
    return (f"--internal writes nothing: the law {laws} has no internal variables",)

"""Notes on the meshes of a character: which of them are rigid, held by springs, or hang."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gf_usd.core.errors import counted
from gf_usd.core.stage import BlendShapes
from gf_usd.core.units import length_text, percent_text


def shapes_notes(shapes: Mapping[str, BlendShapes]) -> tuple[str, ...]:
    """Notes on the blend shapes of meshes that change."""
    return tuple(
        f"the blend shape{'s' * (len(one.names) > 1)} {_names(one.names)} of <{path}> change"
        f"{'s' * (len(one.names) == 1)}: the surface follows on top of the motion of its flesh,"
        f" which does not feel it; neither do particles and Gaussians follow"
        for path, one in shapes.items()
    )


def _names(names: Sequence[str]) -> str:
    """The first three of some names, and how many more there are."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def loose_note(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes of several joints that no flesh supports."""
    if not paths:
        return ()
    follows, touches, it, its, pose = (
        ("follows", "touches", "it", "its", "pose")
        if len(paths) == 1
        else ("follow", "touch", "they", "their", "poses")
    )
    them = "it" if len(paths) == 1 else "them"
    return (
        f"{_listed(paths)} {follows} several joints and {touches} no flesh: springs hold {them} in"
        f" {its} skinned {pose}, because {it} would fall; --goal-frequency gives all flesh springs"
        f" instead",
    )


def hanging_notes(near: Mapping[str, float], frequency: float) -> tuple[str, ...]:
    """Notes on meshes of several joints that the flesh supports at few of their points.

    near : the share of these, by prim path; frequency : [Hz] of the springs that hold the others.
    """
    return tuple(
        f"<{path}> follows several joints, and only {percent_text(share)} of its points are near"
        f" the flesh that holds it: springs of {frequency:g} Hz pull it to its skinned pose,"
        f" because the rest would hang from there; --goal-frequency gives all flesh springs instead"
        for path, share in near.items()
    )


def apart_note(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and that no flesh supports."""
    if not paths:
        return ()
    moves, touches, is_, it = (
        ("moves", "touches", "is", "it") if len(paths) == 1 else ("move", "touch", "are", "they")
    )
    return (
        f"{_listed(paths)} {moves} with a single joint and {touches} no flesh: {it} {is_} kept"
        f" rigid, because {it} would fall",
    )


def thin_note(paths: Sequence[str], cell: float) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and are too thin to be soft."""
    if not paths:
        return ()
    moves, is_, it = ("moves", "is", "it is") if len(paths) == 1 else ("move", "are", "they are")
    return (
        f"{_listed(paths)} {moves} with a single joint and {is_} too thin for the grid, which has"
        f" cells of {length_text(cell)}: {it} kept rigid; more --particles make the grid finer",
    )


def worn_note(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and have no bone of their own."""
    if not paths:
        return ()
    moves, is_, it, has = (
        ("moves", "is", "it", "has") if len(paths) == 1 else ("move", "are", "they", "have")
    )
    return (
        f"{_listed(paths)} {moves} with a single joint and {has} no bone of"
        f" {'its' if len(paths) == 1 else 'their'} own: {it} {is_} kept rigid, because {it} would"
        f" hang from the rest; with --goal-frequency {it} {is_} as soft as the rest",
    )


def _listed(paths: Sequence[str]) -> str:
    """The first three of some prim paths, and how many more there are."""
    left = len(paths) - 3
    more = f" and {left} more mesh{'es' * (left > 1)}" if left > 0 else ""
    return ", ".join(f"<{path}>" for path in paths[:3]) + more


def soft_note(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and are not kept rigid."""
    if not paths:
        return ()
    moves, becomes = ("moves", "becomes") if len(paths) == 1 else ("move", "become")
    return (
        f"{_listed(paths)} {moves} with a single joint and {becomes} as soft as the"
        f" rest; --rigid keeps a mesh rigid, such as --rigid {paths[0]}",
    )


def unbound_notes(counts: Mapping[str, tuple[int, int]]) -> tuple[str, ...]:
    """Notes on sheets with points that no joint moves.

    counts : how many of how many points, by prim path.
    """
    return tuple(
        f"<{path}>: {unbound:,} of {counted(total, 'point')} {'has' if unbound == 1 else 'have'} no"
        f" joint weights and {'takes' if unbound == 1 else 'take'} those of the nearest point that"
        f" has"
        for path, (unbound, total) in counts.items()
        if unbound
    )

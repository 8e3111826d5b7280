"""Notes on the meshes of a character: which of them are rigid, held by springs, or hang."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gf_usd.core.errors import agreed, counted, listed, listed_paths
from gf_usd.core.stage import BlendShapes
from gf_usd.core.units import length_text, percent_text


def shapes_notes(shapes: Mapping[str, BlendShapes]) -> tuple[str, ...]:
    """Notes on the blend shapes of meshes that change."""
    return tuple(
        f"the blend {agreed(len(one.names), '[shape/shapes]')} {listed(one.names, 3)} of <{path}>"
        f" {agreed(len(one.names), '[changes/change]')}: the surface follows on top of the motion"
        f" of its flesh, which does not feel it; neither do particles and Gaussians follow"
        for path, one in shapes.items()
    )


def loose_note(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes of several joints that no flesh supports."""
    if not paths:
        return ()
    text = (
        "[follows/follow] several joints and [touches/touch] no flesh: springs hold [it/them] in"
        " [its/their] skinned [pose/poses], because [it/they] would fall; --goal-frequency gives"
        " all flesh springs instead"
    )
    return (_about(paths, text),)


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
    text = (
        "[moves/move] with a single joint and [touches/touch] no flesh: [it is/they are] kept"
        " rigid, because [it/they] would fall"
    )
    return (_about(paths, text),)


def thin_note(paths: Sequence[str], cell: float) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and are too thin to be soft."""
    if not paths:
        return ()
    text = (
        "[moves/move] with a single joint and [is/are] too thin for the grid, which has cells of"
        f" {length_text(cell)}: [it is/they are] kept rigid; more --particles make the grid finer"
    )
    return (_about(paths, text),)


def worn_note(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and have no bone of their own."""
    if not paths:
        return ()
    text = (
        "[moves/move] with a single joint and [has/have] no bone of [its/their] own: [it is/they"
        " are] kept rigid, because [it/they] would hang from the rest; with --goal-frequency [it"
        " is/they are] as soft as the rest"
    )
    return (_about(paths, text),)


def soft_note(paths: Sequence[str]) -> tuple[str, ...]:
    """The note on meshes that move with a single joint and are not kept rigid."""
    if not paths:
        return ()
    text = "[moves/move] with a single joint and [becomes/become] as soft as the rest"
    return (f"{_about(paths, text)}; --rigid keeps a mesh rigid, such as --rigid {paths[0]}",)


def unbound_notes(counts: Mapping[str, tuple[int, int]]) -> tuple[str, ...]:
    """Notes on sheets with points that no joint moves.

    counts : how many of how many points, by prim path.
    """
    return tuple(
        f"<{path}>: {unbound:,} of {counted(total, 'point')} "
        + agreed(
            unbound,
            "[has/have] no joint weights and [takes/take] those of the nearest point that has",
        )
        for path, (unbound, total) in counts.items()
        if unbound
    )


def _about(paths: Sequence[str], text: str) -> str:
    """The first three of some meshes, how many more there are, and a text that agrees with them."""
    left = len(paths) - 3
    meshes = agreed(left, " [mesh/meshes]") if left > 0 else ""
    return f"{listed_paths(paths, 3)}{meshes} {agreed(len(paths), text)}"

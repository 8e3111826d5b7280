"""Cages of subdivision surfaces: bodies are their polygons, and renderers draw another surface."""

from __future__ import annotations

from collections.abc import Sequence

from gf_usd.core.asset import Surface

FAR = 1.0  # [spacings]


def cage_notes(surfaces: Sequence[Surface], spacing: float) -> tuple[str, ...]:
    """Notes on cages that are FAR from their limit surfaces; spacing : [m] of the particles."""
    notes = []
    for one in surfaces:
        if one.limit is None or one.limit.shift <= FAR * spacing:
            continue
        notes.append(
            f"<{one.path}> is the cage of a subdivision surface, and its polygons are simulated:"
            f" the surface that renderers draw is up to {one.limit.shift:.3g} m"
            f" ({one.limit.shift / spacing:.2g} spacings) inside them and does not touch what"
            " the body touches; refine the cage with --max-edge-length auto, or author"
            " subdivisionScheme = none if the polygons are what is meant"
        )
    return tuple(notes)

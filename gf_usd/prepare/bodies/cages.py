"""Cages of subdivision surfaces: bodies have the shape of the cage, renderers draw the limit
surface.
"""

from __future__ import annotations

from collections.abc import Sequence

from gf_usd.core.asset import Surface

FAR = 1.0  # [spacings]


def cage_notes(surfaces: Sequence[Surface], spacing: float, *, refined: bool) -> tuple[str, ...]:
    """Notes on cages that are FAR from their limit surfaces.

    spacing : [m] of the particles; refined : cages were, except for those that cannot be.
    """
    what = "" if refined else "refine the cage with --max-edge-length auto, or "
    notes = []
    for one in surfaces:
        if one.limit is None or one.limit.shift <= FAR * spacing:
            continue
        notes.append(
            f"<{one.path}> is the cage of a subdivision surface, and its polygons are simulated:"
            f" the surface that renderers draw is up to {one.limit.shift:.3g} m"
            f" ({one.limit.shift / spacing:.2g} spacings) away from them and does not touch"
            f" what the body touches; {what}author subdivisionScheme = none if the polygons are"
            " what is meant"
        )
    return tuple(notes)

"""Meshes too coarse to show how their bodies move, as far as that is known before a bake.

Bodies have the shape of the cage of a subdivision surface, but renderers draw the limit surface.
A face is flat between its points however its body bends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gf_usd.core.asset import Surface
from gf_usd.core.mesh.measures import areas
from gf_usd.core.units import length_text, rounded_text

FAR = 1.0  # [spacings] from the limit surface
LONG = 4.0  # [spacings] edge length: shorter edges resolve any bend of the grid (cell size 2)
SHARE = 0.01  # least share of a mesh's area in faces with a long edge


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
            f" the surface that renderers draw is up to {length_text(one.limit.shift)}"
            f" ({rounded_text(one.limit.shift / spacing)} spacings) away from them and does not"
            f" touch what the body touches; {what}author subdivisionScheme = none if the polygons"
            " are what is meant"
        )
    return tuple(notes)


def coarse_note(
    surfaces: Sequence[Surface], spacing: float, *, refined: bool
) -> tuple[str, tuple[str, ...]]:
    """A note on meshes with faces too long to bend with their body, and the paths of these meshes.

    ("", ()) where there are none.  Cages that have a note are left out.

    spacing : [m] of the particles; refined : faces were divided, except for those that cannot be.
    """
    cages = {s.path for s in surfaces if s.limit is not None and s.limit.shift > FAR * spacing}
    own = [s for s in surfaces if s.splats is None and len(s.triangles) and s.path not in cages]
    found = coarse_meshes(own, spacing)
    if not found:
        return "", ()
    what = "" if refined else "; --max-edge-length auto divides them"
    note = (
        f"faces of {mesh_names(found, spacing)} stay flat however the body bends, and only the"
        f" particles and Gaussians show its shape{what}"
    )
    return note, tuple(found)


def coarse_meshes(surfaces: Sequence[Surface], spacing: float) -> dict[str, float]:
    """The longest edge [m] of meshes with many long faces, by path, longest first.

    surfaces : at rest; spacing : [m] of the particles.
    """
    found: dict[str, float] = {}
    for one in surfaces:
        corners = np.asarray(one.points, float)[one.triangles]
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(1)
        area = areas(one.points, one.triangles)
        if area[edges > LONG * spacing].sum() > SHARE * area.sum():
            found[one.path] = float(edges.max())
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def mesh_names(meshes: Mapping[str, float], spacing: float) -> str:
    """Text that names the meshes of `coarse_meshes`."""
    path, edge = next(iter(meshes.items()))
    more = f" and {len(meshes) - 1} more" if len(meshes) > 1 else ""
    long = f"{rounded_text(edge / spacing)} spacings of {length_text(spacing)}"
    return f"<{path}>{more} (edges up to {long})"

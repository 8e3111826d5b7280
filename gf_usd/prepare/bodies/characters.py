"""The characters of a stage: with `--flesh`, the surfaces of each skeleton form a separate body.

Bind poses of characters may overlap although the characters are apart in the shot, and a single
body would join them there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.core.asset import Asset, Surface
from gf_usd.core.neighbors import kd_tree

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.prepare.bodies.plan import BodyPlan

PROP = "no skeleton poses it, and it touches no mesh that one poses, so that nothing would hold it"


def without_props(asset: Asset, solid: Solid, file: Path, spacing: float) -> Asset:
    """The asset, with filled meshes that no bones hold among the prims that are skipped.

    They would fall: with `--flesh` there is no floor by default.  In the source no skeleton moves
    them either.

    spacing : [m] approximate spacing of the particles.
    """
    from gf_usd.geometry.connected.bodies import find_bodies
    from gf_usd.readers.usd.bones import skeletons

    posed = set(skeletons(file, [s.path for s in asset.surfaces], asset.facts))
    if not posed or all(s.path in posed or s.splats is not None for s in solid.surfaces):
        return asset
    of = find_bodies(solid, spacing)
    held = {int(k) for k, s in zip(of, solid.surfaces) if s.path in posed or s.splats is not None}
    props = {s.path for k, s in zip(of, solid.surfaces) if int(k) not in held}
    if not held or not props:
        return asset
    return replace(
        asset,
        surfaces=tuple(s for s in asset.surfaces if s.path not in props),
        skipped=(*asset.skipped, *((s.path, PROP) for s in asset.surfaces if s.path in props)),
    )


def characters_of(asset: Asset, file: Path) -> tuple[dict[str, str], tuple[str, ...]]:
    """The SkelRoot of the character that each surface belongs to, by prim path, and notes.

    Empty where there are fewer than two.  A surface without a skeleton, such as a prop, belongs to
    the character with the longest common path; among several, to the nearest.
    """
    from gf_usd.readers.usd.bones import skeletons

    posed_by = skeletons(file, [s.path for s in asset.surfaces], asset.facts)
    found = {path: root for path, (_, root) in posed_by.items()}
    notes = []
    for root in dict.fromkeys(found.values()):
        own = list(dict.fromkeys(one for one, above in posed_by.values() if above == root))
        if len(own) > 1:
            notes.append(
                f"{len(own)} skeletons under the SkelRoot <{root}> are one character, and one body:"
                f" <{own[0]}>, <{own[1]}>"
                + (f" and {len(own) - 2} more" * (len(own) > 2))
                + "; if they are several, bake them one by one (--prim)"
            )
    if len(set(found.values())) < 2:
        return {}, tuple(notes)
    posed = [s for s in asset.surfaces if s.path in found]
    each = {s.path: found.get(s.path) or _nearest(s, posed, found) for s in asset.surfaces}
    return each, tuple(notes)


def _nearest(surface: Surface, posed: Sequence[Surface], found: dict[str, str]) -> str:
    """The character of a surface without a skeleton."""
    shared = [_shared(surface.path, found[s.path]) for s in posed]
    closest = [s for s, count in zip(posed, shared, strict=True) if count == max(shared)]
    tree = kd_tree(surface.points)
    gaps = [float(tree.query(s.points)[0].min()) for s in closest]
    return found[closest[int(np.argmin(gaps))].path]


def _shared(one: str, other: str) -> int:
    """Number of leading names that two prim paths have in common."""
    pairs = zip(one.split("/"), other.split("/"))
    alike = [a == b for a, b in pairs]
    return alike.index(False) if False in alike else len(alike)


def character_paths(bodies: BodyPlan) -> list[list[str]]:
    """The surfaces that move with each body, filled or not, by prim path."""
    every = bodies.embedded.items()
    return [[path for path, body in every if body == k] for k in range(bodies.count)]

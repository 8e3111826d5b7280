"""The characters of a stage: with `--flesh`, the surfaces of each skeleton form a separate body.

Bind poses of characters may overlap although the characters are apart in the shot, and a single
body would join them there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.units import length_text
from gf_usd.prepare.bodies.grounds import grounds, scenery_of

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.prepare.bodies.flesh.character_file import CharacterFile
    from gf_usd.prepare.bodies.plan import BodyPlan

# Why a mesh is not part of a character, after what does not move it.
PROP = "it touches no mesh of a character, so that nothing would support it"
SHEET = "it encloses no volume and is not near a mesh of a character"
GROUND = "it is flat and lies under everything else, as a ground does"
OWN = "it has an animation of its own"
WORN = "it is open, and others pass through its holes, as through those of a garment"
THIN = "and around no bone; more --particles make it soft"
NEAR = 0.02  # of the size of the characters: open meshes that are farther away do not follow them


def without_props(asset: Asset, solid: Solid, source: CharacterFile, spacing: float) -> Asset:
    """The asset, with meshes that the animation does not hold among the prims that are skipped.

    They are neither posed by a skeleton, or animated where there is none, nor connected to meshes
    that are.  Filled ones would fall: with `--flesh` there is no floor by default.  Sheets would
    follow the nearest flesh, however far away, and the ground the feet that stand on it.  Beside a
    skeleton, a mesh with an animation of its own keeps it.

    spacing : [m] approximate spacing of the particles.
    """
    from gf_usd.readers.usd.skeleton.bones import lone_skeleton
    from gf_usd.readers.usd_bake.caches import animated_meshes, has_animated_points

    paths, unmoved = [s.path for s in asset.surfaces], "no skeleton poses it"
    file, posed = source.path, source.posed(asset)
    moved, nearest = set(posed), False
    if not moved:
        # without animated points all meshes follow the nearest bones of the only skeleton
        nearest = not has_animated_points(file, paths, asset.facts) and bool(lone_skeleton(file))
        if not nearest:
            moved, unmoved = animated_meshes(file, paths, asset.facts), "it is not animated"
    loose = {s.path for s in asset.surfaces if s.path not in moved and s.splats is None}
    if not loose or not (moved or nearest):
        return asset
    reasons = scenery_of(asset, solid)
    reasons |= {s.path: GROUND for s, _ in grounds(asset.surfaces, asset.facts.up)}
    reasons = {path: reason for path, reason in reasons.items() if path in loose}
    if posed:
        # In the bind pose, which is the rest shape, they would be at another part of the flesh.
        beside = sorted({skeleton for skeleton, _ in posed.values()})
        free = sorted(loose - reasons.keys())
        own = animated_meshes(file, free, asset.facts, beside)
        reasons |= dict.fromkeys(own, OWN)
    if not nearest:
        apart = _apart(asset, solid, loose, reasons, spacing)
        if apart is None:
            return asset
        reasons = apart | reasons
    out = {path: f"{unmoved}, and {reasons[path]}" for path in paths if path in reasons}
    return asset.without(out) if 0 < len(out) < len(paths) else asset


def worn_meshes(
    asset: Asset, solid: Solid, source: CharacterFile, spacing: float, *, repaired: bool = False
) -> dict[str, str]:
    """The reason why each of the garments of characters bounds no volume, by prim path.

    Only meshes of the same character count, since bind poses may overlap, and something of each is
    filled.

    spacing : [m] approximate spacing of the particles.
    repaired : open meshes are closed or thickened, so that only closed sheets bound none.
    """
    from gf_usd.geometry.flesh.sheets import garments, thin_sheets
    from gf_usd.readers.usd.skeleton.bones import read_skeleton

    posed = source.posed(asset) if len(solid.surfaces) > 1 else {}
    if not posed:
        return {}
    owners, _ = characters_of(asset, source)
    members: dict[str, list[int]] = {}
    for k, surface in enumerate(solid.surfaces):
        members.setdefault(owners.get(surface.path, ""), []).append(k)
    out: dict[str, str] = {}
    for owner, rows in members.items():
        if len(rows) < 2:
            continue
        part, first = solid.part(np.array(rows)), source.animation(asset).first
        own = [s.path for s in asset.surfaces if owners.get(s.path, "") == owner]
        skeleton = read_skeleton(source.path, own, asset.facts, first=first, times=[first])
        drawn = asset.surfaces if repaired else ()
        thin = _thin_reasons(thin_sheets(part, skeleton, spacing, drawn), spacing)
        found = thin | dict.fromkeys(() if repaired else garments(part, posed), WORN)
        out |= found if len(found) < len(rows) else thin  # which are not all: one has a bone in it
    return out


def _thin_reasons(thickness: Mapping[str, float], spacing: float) -> dict[str, str]:
    """The reason why closed sheets are not filled, the same for all, so that a note lists them.

    thickness : [m] of each; spacing : [m] of the particles.
    """
    if not thickness:
        return {}
    at_most = "at most " if len(thickness) > 1 else ""
    text = (
        f"closed, but {at_most}{length_text(max(thickness.values()))} thick on average, less than"
        f" the spacing of the particles, {length_text(spacing)}, {THIN}"
    )
    return dict.fromkeys(thickness, text)


def _apart(
    asset: Asset, solid: Solid, loose: Collection[str], ground: Collection[str], spacing: float
) -> dict[str, str] | None:
    """The reason for each of the meshes `loose` that is not at one of the others; None: there are
    no others.

    ground : paths of those on which others stand, which are not one body for that.
    """
    from gf_usd.geometry.connected.bodies import find_bodies

    kinds = np.array([s.path in ground for s in solid.surfaces], np.int64)
    of = find_bodies(solid, spacing, kinds=kinds)
    flesh = {int(k) for k, s in zip(of, solid.surfaces) if s.path not in loose}
    held = np.flatnonzero([int(k) in flesh for k in of])
    if not len(held):
        return None
    apart = {s.path: PROP for k, s in enumerate(solid.surfaces) if int(of[k]) not in flesh}
    hanging = {path for path, _ in solid.embedded} - solid.walls.keys()
    sheets = [
        s for s in asset.surfaces if s.path in hanging and s.path in loose and s.path not in ground
    ]
    near = _near(solid, held, sheets)
    return apart | {s.path: SHEET for s, one in zip(sheets, near, strict=True) if not one}


def _near(solid: Solid, held: Ints, sheets: Sequence[Surface]) -> NDArray[np.bool_]:
    """(k,) which sheets have points in a solid or near its surfaces `held`, as a part of their
    size.

    All sheets at once: each query of libigl builds a tree of the surface.
    """
    from gf_usd.geometry.regions import Shape

    if not sheets:
        return np.zeros(0, bool)
    X = np.concatenate([s.face_points for s in sheets])
    of = np.repeat(np.arange(len(sheets)), [len(s.face_points) for s in sheets])
    found = solid.inside(X)
    skins = [(solid.surfaces[k].points, solid.triangles[k]) for k in held]
    low, high = (np.array([end(x, axis=0) for x, _ in skins]) for end in (np.min, np.max))
    reach = NEAR * float(np.linalg.norm(high.max(0) - low.min(0)))
    for (points, triangles), least, most in zip(skins, low - reach, high + reach, strict=True):
        rows = np.flatnonzero(~found & ((least <= X) & (most >= X)).all(1))
        found[rows] = Shape(points, triangles).closest(X[rows])[0] <= reach
    return np.bincount(of, found, len(sheets)) > 0


def characters_of(asset: Asset, source: CharacterFile) -> tuple[dict[str, str], tuple[str, ...]]:
    """The SkelRoot of the character that each surface belongs to, by prim path, and notes.

    Empty where there are fewer than two.  A surface without a skeleton, such as a prop, belongs to
    the character with the longest common path; among several, to the nearest.
    """
    posed_by = source.posed(asset)
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


def overlap_notes(
    asset: Asset, starts: Sequence[Mapping[str, Floats]], code: str
) -> tuple[str, ...]:
    """Notes on characters that are inside each other in the first frame, at a time code.

    starts : of each character, points (V, 3) [m] of its surfaces in that frame, by prim path.
    """
    from gf_usd.geometry.regions import Shape

    surfaces = {s.path: s for s in asset.surfaces}
    shapes = [
        {path: Shape(points, surfaces[path].triangles) for path, points in start.items()}
        for start in starts
    ]
    notes = []
    for a, b in combinations(range(len(starts)), 2):
        deepest, paths = 0.0, ("", "")
        for k, other in ((a, b), (b, a)):
            for (one, points), (two, shape) in product(starts[k].items(), shapes[other].items()):
                depth = shape.deepest(points)
                if depth > deepest:
                    deepest, paths = depth, (one, two) if k == a else (two, one)
        if deepest > 0.0:
            notes.append(
                f"<{paths[0]}> and <{paths[1]}> overlap by up to {length_text(deepest)} where"
                f" contact begins, at time code {code}: parts that overlap there pass through each"
                " other until they are apart"
            )
    return tuple(notes)


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

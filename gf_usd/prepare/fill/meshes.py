"""The meshes that are filled: repaired or consistently oriented, and the solid that they bound."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import InputError, listed_paths
from gf_usd.core.mesh.measures import signed_volume

if TYPE_CHECKING:
    from gf_usd.geometry.connected.joined import Joined
    from gf_usd.geometry.connected.walls import Walls
    from gf_usd.geometry.diagnosis import Diagnosis
    from gf_usd.geometry.repair import Repairs
    from gf_usd.geometry.solid import Solid
    from gf_usd.prepare.fill.parts import Parts
    from gf_usd.prepare.settings import Resolution

Volumes = Callable[[], Mapping[tuple[str, ...], float]]  # see `stated_spacing`
ResolutionOf = Callable[[Volumes], "Resolution"]
OfTwo = Callable[[str, str], str]  # of two prim paths the one that collides for the other
OneThing = Callable[[str, str], bool]  # whether two prim paths may be sides of one wall
WITH_FLESH = "meshes are not joined with --flesh"
MERGE = "merge them into one mesh whose common points are welded"


@dataclass(frozen=True, kw_only=True)
class FilledMeshes:
    """The meshes of an asset, and the solid to fill."""

    asset: Asset  # for display: its points are those of the source
    solid: Solid
    notes: tuple[str, ...] = ()  # on repairs and on defects that are tolerated
    thickened: bool = False  # sheets are as thick as the spacing
    repairs: tuple[Repairs, ...] = ()  # of each surface that is filled, where it was asked for
    spacing: float | None = None  # [m] of as many particles as requested, sheets included
    lost: str = ""  # see `lost_volume_warning`; one of the notes

    def volumes(self) -> dict[tuple[str, ...], float]:
        """[m^3] of its closed surfaces, by the prim paths of their meshes."""
        closed = ((s, s.signed_volume) for s in self.solid.surfaces)
        return _volumes(closed, _with_inner_sides(self.solid.joined, self.solid.walls))


def _volumes(
    closed: Iterable[tuple[Surface, float]], groups: Sequence[tuple[str, ...]]
) -> dict[tuple[str, ...], float]:
    """[m^3] of surfaces with their signed volumes [m^3], by the prim paths of their meshes.

    groups : prim paths of meshes that are one surface; the first is that of the surface.
    """
    parts = {group[0]: group for group in groups}
    return {parts.get(s.path, (s.path,)): abs(volume) for s, volume in closed}


def _with_inner_sides(
    joined: Sequence[tuple[str, ...]], outer: Mapping[str, str]
) -> tuple[tuple[str, ...], ...]:
    """Groups of joined meshes with the inner sides of their walls, and those of other walls.

    outer : of each inner side; the outer side is the first of its group.
    """
    groups = {group[0]: group for group in joined}
    for inner, host in outer.items():
        groups[host] = (*groups.get(host, (host,)), inner)
    return tuple(groups.values())


def build_meshes(
    asset: Asset,
    *,
    repair: bool,
    resolution: ResolutionOf,
    paper: bool,
    parts: Parts | None = None,
    flesh: bool = False,
    one_thing: OneThing | None = None,
    collider_of: OfTwo | None = None,
    known: Sequence[Diagnosis] = (),
    built: Solid | None = None,
    unfilled: Mapping[str, str] | None = None,
) -> FilledMeshes:
    """The meshes of an asset and their solid.  Raises InputError where they cannot be filled.

    resolution : see `repair_for_fill`; paper : whether the fill is that of the paper.
    parts : which meshes may be parts of one (see `joined_surfaces`); None: all are filled by
        themselves, for --flesh if `flesh`.
    one_thing : see `find_walls`; None: no two meshes are sides of one wall.
    collider_of : see `find_walls`.
    known : result of `diagnose` for the surfaces, if available.
    built : the solid without `repair`, if available.
    unfilled : see `build_solid`.
    """
    from gf_usd.geometry.connected.joined import Joined, joined_alike, joined_surfaces
    from gf_usd.geometry.connected.walls import Walls, find_walls, with_walls
    from gf_usd.geometry.diagnosis import diagnose, lost_volume_warning, tolerated_defects
    from gf_usd.geometry.repair import consistently_oriented_asset, notes
    from gf_usd.geometry.solid import build_solid

    oriented, turned = consistently_oriented_asset(asset)
    if built and not repair:
        _release_edges(asset, oriented)
        return FilledMeshes(asset=oriented, solid=built)
    joined = Joined(asset=oriented)
    if parts is not None:
        joined = joined_surfaces(oriented, parts.apart, parts.alike)
    sides = find_walls(joined.asset, one_thing, collider_of) if one_thing else Walls()
    # a repair makes the winding consistent itself, and counts what it turns
    groups = joined.groups
    whole = with_walls(joined_alike(asset, joined) if repair else joined.asset, sides)
    walls, joined = sides.with_parts(joined)
    why_not = parts.why_not if parts is not None else lambda _: WITH_FLESH if flesh else ""

    def made(filled: Asset) -> Solid:
        try:
            solid = build_solid(filled, repaired=repair, unfilled=unfilled)
        except InputError as refused:
            apart = _apart(oriented, groups, why_not)
            if not apart:
                raise
            ways = [] if parts is None else [parts.remedy(group) for group in apart]
            hint = ", or ".join((*dict.fromkeys(ways), MERGE))
            raise InputError("\n".join((refused.message, *apart.values())), hint) from refused
        embedded = (*solid.embedded, *walls.embedded)
        return replace(solid, embedded=embedded, walls=walls.outer)

    if repair:
        _release_edges(asset, oriented)
        display, filled, repairs, spacing = repair_for_fill(
            whole,
            resolution,
            paper=paper,
            groups=_with_inner_sides(joined.groups, walls.outer),
            unfilled=unfilled or {},
        )
        thickened = any(one.thickened for one in repairs)
        return FilledMeshes(
            asset=_as_authored(display, asset, walls, joined),
            solid=built or replace(made(filled), joined=joined.groups),
            notes=(
                *notes(repairs),
                *joined.notes,
                *walls.notes,
                *(_not_joined(oriented, groups, why_not) if thickened else ()),
            ),
            repairs=tuple(repairs),
            thickened=thickened,
            spacing=spacing,
        )
    solid = replace(made(whole), joined=joined.groups)
    changed = {*walls.outer.values(), *(paths[0] for paths in joined.groups)}
    by_path = {} if turned else {one.path: one for one in known if one.path not in changed}
    diagnoses = [by_path.get(s.path) or diagnose(s) for s in solid.surfaces]
    lost = lost_volume_warning(diagnoses, solid.volume, solid.adding_nothing)
    defects = (*tolerated_defects(diagnoses), lost)
    left = {path for path, _ in solid.embedded} - walls.outer.keys()
    not_joined = _not_joined(oriented, groups, why_not) if left else ()
    notes_on = (*turned, *joined.notes, *not_joined, *filter(None, defects), *walls.notes)
    _release_edges(asset, oriented, whole)
    return FilledMeshes(asset=oriented, solid=solid, notes=notes_on, lost=lost)


def _release_edges(*assets: Asset) -> None:
    """Free the edges of surfaces, which only the steps so far need."""
    for one in assets:
        for surface in one.surfaces:
            surface.welded.release()


def _not_joined(
    asset: Asset, groups: Sequence[tuple[str, ...]], why_not: Callable[[Sequence[str]], str]
) -> tuple[str, ...]:
    """A line on each group of `_apart`."""
    return tuple(_apart(asset, groups, why_not).values())


def _apart(
    asset: Asset, groups: Sequence[tuple[str, ...]], why_not: Callable[[Sequence[str]], str]
) -> dict[tuple[str, ...], str]:
    """The groups of meshes that enclose a volume only together and were not joined, each with a
    line on why.

    groups : of those that were; why_not : the reason for prim paths, "": none is known.
    """
    from gf_usd.geometry.connected.joined import joined_surfaces

    known = [set(group) for group in groups]
    left = (group for group in joined_surfaces(asset).groups if set(group) not in known)
    found = ((group, why_not(group)) for group in left)
    return {
        group: f"{listed_paths(group)} share borders and enclose a volume only together, but are"
        f" not filled as one body: {reason}"
        for group, reason in found
        if reason
    }


def _as_authored(repaired: Asset, asset: Asset, walls: Walls, joined: Joined) -> Asset:
    """The repaired asset with the sides of walls and the parts of joined meshes as they were, each
    a surface of its own.
    """
    by_path = {s.path: s for s in repaired.surfaces}
    sides = {*walls.outer, *walls.outer.values(), *(p for group in joined.groups for p in group)}
    surfaces = (s if s.path in sides else by_path[s.path] for s in asset.surfaces)
    return replace(repaired, surfaces=tuple(surfaces))


def repair_for_fill(
    asset: Asset,
    resolution: ResolutionOf,
    *,
    paper: bool,
    groups: Sequence[tuple[str, ...]] = (),
    unfilled: Collection[str] = (),
) -> tuple[Asset, Asset, tuple[Repairs, ...], float | None]:
    """The repaired asset, the same with sheets thickened for the fill, and the repairs.

    The first is for display: its points are those of the source.  The last value is the spacing [m]
    that gives the requested number of particles; None: nothing is thickened, or the spacing is
    given.

    resolution : the requested one, for the volumes of the repaired surfaces.
    groups : prim paths of meshes that are one surface; the first is that of the surface.
    unfilled : prim paths of surfaces that are not thickened, and do not count.
    """
    from gf_usd.geometry.repair import repair_asset
    from gf_usd.geometry.thin.thicken import thicken_asset, thicken_to_count

    repaired, repairs = repair_asset(asset)
    kept = [k for k, s in enumerate(repaired.surfaces) if s.path not in unfilled]
    whole = replace(repaired, surfaces=tuple(repaired.surfaces[k] for k in kept))
    own, spacing = tuple(repairs[k] for k in kept), None
    requested = resolution(
        lambda: _volumes(
            ((s, signed_volume(s.points, s.triangles)) for s in whole.surfaces), groups
        )
    )
    if requested.spacing is None and not paper:
        filled, own, spacing = thicken_to_count(whole, own, requested.particles)
    else:
        filled, own = thicken_asset(
            whole, own, spacing=requested.spacing, particles=requested.particles
        )
    surfaces, every = list(repaired.surfaces), list(repairs)
    for k, surface, one in zip(kept, filled.surfaces, own, strict=True):
        surfaces[k], every[k] = surface, one
    return repaired, replace(repaired, surfaces=tuple(surfaces)), tuple(every), spacing

"""Meshes of the stage that would close the open ones among those that are named."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import InputError, listed_paths
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.fill.parts import Parts
from gf_usd.readers.isolated import Reading
from gf_usd.readers.usd_bake.spec import read_stage_spec

NAME_THEM = "name those meshes as well (--prim), or a prim above all of them"


@dataclass(frozen=True, kw_only=True)
class Around:
    """Reads the meshes of a stage around those of an asset."""

    file: Path  # the USD form of the asset
    usd: bool  # it is the file of the user
    again: Callable[[], Reading] | None  # converts a mesh file anew, for faces that are not divided
    rest: float | None  # time code of the rest pose; None: the asset's own
    elastic: bool  # False: materials and painted values of bodies are not used

    def surfaces(self, asset: Asset) -> tuple[Surface, ...]:
        """The meshes of an asset and those around them, see `read_around`."""
        from gf_usd.readers.usd.asset import read_around

        paths = [s.path for s in asset.surfaces]
        if self.again is None:
            return read_around(self.file, asset.facts, paths, rest=self.rest)
        with self.again() as read:
            converted = read.result().converted
            assert converted is not None
            return read_around(converted.layer, asset.facts, paths, rest=self.rest)

    def stated(self, asset: Asset, named: Sequence[str]) -> tuple[Asset, StageSpec]:
        """The asset without meshes that the stage excludes, and what it states of the others.

        named : prim paths that are not excluded.
        """
        if not self.usd:
            return asset, StageSpec()
        try:
            return read_stage_spec(asset, self.file, named, rest=self.rest, elastic=self.elastic)
        except InputError:
            # What is stated of a mesh that was not named is invalid.  Its shape still closes the
            # others, and the refusal names the fault where it is named as well.
            return asset, StageSpec()


def with_neighbors(refused: InputError, asset: Asset, around: Around) -> InputError | None:
    """The refusal of an asset with the meshes of its stage that would close its open ones.

    None where there are none that could be filled together with these.
    """
    if would_fill(asset):
        return None
    text = next(_neighbors(asset, around), "")
    return InputError(f"{refused.message}\n{text}", NAME_THEM) if text else None


def neighbor_notes(asset: Asset, around: Around) -> tuple[str, ...]:
    """Notes on the meshes of the stage that would close the large holes of an asset that is filled.

    The stage is only read where there are such holes.
    """
    from gf_usd.geometry.connected.joined import joined_surfaces
    from gf_usd.geometry.diagnosis import HOLE_LIMIT, diagnose

    own = (s for s in joined_surfaces(asset).asset.surfaces if s.splats is None)
    if all(hole.share <= HOLE_LIMIT for one in own for hole in diagnose(one).holes):
        return ()
    return tuple(f"{text}: {NAME_THEM}" for text in _neighbors(asset, around))


def _neighbors(asset: Asset, around: Around) -> Iterator[str]:
    """Texts on meshes of an asset that enclose a volume together with others of its stage."""
    from gf_usd.geometry.connected.joined import bordering, joined_surfaces

    mine = {s.path for s in asset.surfaces}
    near = around.surfaces(asset)
    linked = bordering(near, mine)
    if linked <= mine:
        return
    # in the order of the stage, as where all of it is baked
    candidates = tuple(s for s in near if s.path in linked)
    whole = replace(asset, surfaces=candidates, splats=(), skipped=())
    whole, spec = around.stated(whole, sorted(mine))
    parts = Parts(spec)
    for group in joined_surfaces(whole, parts.apart, parts.alike).groups:
        named, others = ([p for p in group if (p in mine) == own] for own in (True, False))
        if named and others:
            one = "encloses" if len(named) == 1 else "enclose"
            yield f"{listed_paths(named)} {one} a volume together with {listed_paths(others)}"


def would_fill(asset: Asset) -> bool:
    """Whether the surfaces of an asset enclose a volume."""
    from gf_usd.geometry.connected.joined import joined_surfaces
    from gf_usd.geometry.solid import build_solid

    try:
        build_solid(joined_surfaces(asset).asset)
    except InputError:
        return False
    return True

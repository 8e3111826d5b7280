"""What --repair does to an asset before it is filled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gf_usd import body_materials
from gf_usd.model import Asset
from gf_usd.planning import DEFAULT_PARTICLES, PAPER_PARTICLES, Request
from gf_usd.stage_reading import StageWords

if TYPE_CHECKING:
    from gf_usd.geometry.repair import Repairs


def mend(
    asset: Asset, request: Request, words: StageWords
) -> tuple[Asset, Asset, tuple[Repairs, ...]]:
    """The asset mended, the same with its sheets thickened for the fill, and what was done.

    The first is what is drawn and carried: its points are those of the source.
    """
    from gf_usd.geometry.repair import repair_asset
    from gf_usd.geometry.thicken import thicken_asset
    from gf_usd.topology import signed_volume

    paper = request.preset == "paper"
    particles = request.particles or (PAPER_PARTICLES if paper else DEFAULT_PARTICLES)
    mended, repairs = repair_asset(asset)
    spacing = request.spacing * asset.facts.units.length if request.spacing else None
    if spacing is None and request.particles is None and not paper:
        volumes = {s.path: abs(signed_volume(s.points, s.triangles)) for s in mended.surfaces}
        spacing, _ = body_materials.stated_spacing(words, volumes)
    filled, repairs = thicken_asset(mended, repairs, spacing=spacing, particles=particles)
    return mended, filled, repairs

"""What --repair does to an asset before it is filled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gf_usd.model import Asset
from gf_usd.planning import Request
from gf_usd.resolution import resolution
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

    mended, repairs = repair_asset(asset)
    asked = resolution(
        request, words, asset.facts.units.length,
        lambda: {s.path: abs(signed_volume(s.points, s.triangles)) for s in mended.surfaces},
    )  # fmt: skip
    filled, repairs = thicken_asset(
        mended, repairs, spacing=asked.spacing, particles=asked.particles
    )
    return mended, filled, repairs

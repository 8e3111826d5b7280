"""What the file of some characters states about them, each read once for all steps of `fill`."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from gf_usd.core.asset import Asset
from gf_usd.prepare.bodies.flesh.animation import read_animation
from gf_usd.prepare.settings import Animation


class CharacterFile:
    """The skeletons and the animation of the characters of an asset, read when first asked for.

    asset : with all surfaces that may be asked for; path : its USD form; start : time code of the
    first frame, as given.
    """

    def __init__(self, asset: Asset, path: Path, start: float | None) -> None:
        self.path = path
        self._asset, self._start = asset, start
        self._animations: dict[tuple[str, ...], Animation] = {}

    @cached_property
    def _posed(self) -> dict[str, tuple[str, str]]:
        from gf_usd.readers.usd.skeleton.bones import skeletons

        return skeletons(self.path, [s.path for s in self._asset.surfaces], self._asset.facts)

    def posed(self, asset: Asset) -> dict[str, tuple[str, str]]:
        """The Skeleton of each of the surfaces of an asset that have one, and the SkelRoot above
        it, by prim path: see `skeletons`.
        """
        return {s.path: self._posed[s.path] for s in asset.surfaces if s.path in self._posed}

    def animation(self, asset: Asset) -> Animation:
        """The animation of an asset; see `read_animation`, which raises InputError."""
        paths = tuple(s.path for s in asset.surfaces)
        if paths not in self._animations:
            posed = bool(self.posed(asset))
            self._animations[paths] = read_animation(asset, self.path, self._start, posed)
        return self._animations[paths]

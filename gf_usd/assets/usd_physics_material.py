"""Physics materials as bound: what they say of a prim."""

from __future__ import annotations

from typing import Any

from pxr import Sdf, Usd, UsdShade

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_physics_values import authored
from gf_usd.model import Material, StageFacts
from gf_usd.vocabulary import WATER, MaterialWords, read_words

PURPOSE = "physics"


class PhysicsMaterials:
    """The physics materials of a stage at one time, each read once."""

    def __init__(self, facts: StageFacts, time: Usd.TimeCode, notes: Notes) -> None:
        self._facts = facts
        self._time = time
        self._notes = notes
        self._words: dict[Sdf.Path, MaterialWords] = {}

    def bound(self, prim: Usd.Prim) -> MaterialWords:
        """What the material says that is bound to a prim (or above it, or by a collection) for
        physics, else for all purposes.

        Raises InputError for values out of range.
        """
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(PURPOSE)
        if not material:
            return MaterialWords()
        path = material.GetPath()
        if path not in self._words:
            self._words[path] = self._read(material.GetPrim())
        return self._words[path]

    def whole(self, words: MaterialWords, density: float | None = None) -> Material | None:
        """The material that the words make; None where they say nothing of elasticity.

        density : [kg/m^3] that goes before the material's, so that it needs none of its own.
        """
        if words.elastic and words.density is None and density is None:
            self._notes.add(f"no density is stated: {WATER:g} kg/m^3 is assumed", words.path)
        return words.whole()

    def _read(self, prim: Usd.Prim) -> MaterialWords:
        def value(name: str) -> Any:
            return authored(prim, name, self._time)

        where = str(prim.GetPath())
        return read_words(
            value,
            where,
            self._facts.units,
            where=f"{self._facts.path}: <{where}>",
            assume=lambda text: self._notes.add(text, where),
        )

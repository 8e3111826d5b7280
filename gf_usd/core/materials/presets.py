"""All presets by name, and materials with all values given."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gf_usd.core.errors import UsageError, meant, similar
from gf_usd.core.materials.dimensionless import DIMENSIONLESS, DimensionlessPreset
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.physical import PHYSICAL, PhysicalPreset

Preset = DimensionlessPreset | PhysicalPreset


@dataclass(frozen=True)
class Fixed:
    """A material with all values given, for example by a file."""

    given: Material
    notes: tuple[str, ...] = ()  # what was chosen for it

    @property
    def name(self) -> str:
        return self.given.name

    def material(self, radius: float, law: str | None = None) -> Material:
        """The material as given; radius [m] changes nothing."""
        del radius
        return replace(self.given, law=law or self.given.law)


def presets() -> dict[str, Preset]:
    """Every preset by name, the dimensionless ones first."""
    return {**DIMENSIONLESS, **PHYSICAL}


def find_preset(name: str) -> Preset:
    """The preset of that name; UsageError with the nearest names where there is none."""
    known = presets()
    if name in known:
        return known[name]
    # similarity alone finds only one of dry-sand and wet-sand for "sand"
    guess = meant([one for one in known if name.lower() in one.split("-")] or similar(name, known))
    raise UsageError(
        f"there is no material {name!r}",
        f"{guess}choose one of {', '.join(known)} (gf-usd materials shows them),"
        " or a USD file with a material",
    )

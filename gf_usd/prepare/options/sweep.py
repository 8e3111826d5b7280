"""``--material-sweep``: one material with several values of one property, as variants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from gf_usd.core.errors import UsageError
from gf_usd.core.units import number

if TYPE_CHECKING:
    from gf_usd.core.materials.material import Material
    from gf_usd.core.materials.presets import Fixed, Preset

# name -> field of `Material`, least and largest value, spaced by ratios
PROPERTIES: dict[str, tuple[str, float, float, bool]] = {
    "youngs": ("youngs_modulus", 1e-3, 1e15, True),
    "poisson": ("poissons_ratio", 0.0, 0.499, False),
    "density": ("density", 1e-6, 1e9, True),
    "damping": ("damping_time", 0.0, 1e6, True),
    "friction": ("friction", 0.0, 100.0, False),
    "restitution": ("restitution", 0.0, 1.0, False),
}
MOST = 16  # variants


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """The values of a property."""

    name: str  # of PROPERTIES
    values: tuple[float, ...]


def parse_sweep(text: str) -> Sweep:
    """The values of "youngs=1e4:1e6:5", in geometric progression for ratio scales.

    Raises UsageError for an unknown property, or an invalid range.
    """
    name, equals, span = text.partition("=")
    parts = span.split(":")
    if name not in PROPERTIES or not equals or len(parts) != 3:
        raise UsageError(
            f"--material-sweep is {text}",
            f"give NAME=LOW:HIGH:COUNT, such as youngs=1e4:1e6:5; NAME is one of"
            f" {', '.join(PROPERTIES)}",
        )
    _, least, most, by_ratio = PROPERTIES[name]
    low, high = (number("--material-sweep", part, "a number") for part in parts[:2])
    if not least <= low < high <= most:
        raise UsageError(
            f"--material-sweep {text}: {name} goes from {low:g} to {high:g}",
            f"give two numbers from {least:g} to {most:g}, the lower one first",
        )
    if not parts[2].isdecimal() or not 2 <= int(parts[2]) <= MOST:
        raise UsageError(
            f"--material-sweep {text}: {parts[2]} is not a number of variants",
            f"give a whole number from 2 to {MOST}",
        )
    count = int(parts[2])
    steps = [i / (count - 1) for i in range(count)]
    if by_ratio and low > 0.0:
        values = [low * (high / low) ** step for step in steps]
    else:
        values = [low + (high - low) * step for step in steps]
    return Sweep(name=name, values=tuple(float(f"{value:.4g}") for value in values))


@dataclass(frozen=True)
class Swept:
    """A preset with one replaced value."""

    base: Preset | Fixed
    quantity: str  # of PROPERTIES
    value: float

    @property
    def name(self) -> str:
        """Of the variant, as USD takes it: rubber_youngs_31620."""
        shown = f"{self.value:.9f}".rstrip("0").rstrip(".").replace(".", "_")
        return f"{self.base.name}_{self.quantity}_{shown}"

    @property
    def swept(self) -> str:
        """Name of all variants together: rubber_youngs."""
        return f"{self.base.name}_{self.quantity}"

    def material(self, radius: float, law: str | None = None) -> Material:
        """The base material for a body of radius [m], with the value."""
        made = self.base.material(radius, law)
        return replace(made, name=self.name, **{PROPERTIES[self.quantity][0]: self.value})


def swept(base: Preset | Fixed, sweep: Sweep) -> list[Swept]:
    """A preset for each value."""
    return [Swept(base, sweep.name, value) for value in sweep.values]

"""`gf_usd.materials`: the presets."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gf_usd.core.materials import Preset


def materials() -> Mapping[str, Preset]:
    """The material presets by name, those without dimensions first.

    >>> gf_usd.materials()["silicone"].youngs_modulus
    2000000.0
    >>> gf_usd.materials()["rubber"].material(radius=0.1).name
    'rubber'

    A preset without dimensions (rubber, metal, jelly, ...) has its moduli in units of rho g0 r and
    its times in sqrt(r / g0), with r the radius [m] of a ball of the body's volume, so that bodies
    of every size squash alike; the others have numbers of real materials in SI.
    `material(radius)` is the `Material` that a preset gives on a body, to change and to bake with.
    """
    from gf_usd.core.materials import presets

    return MappingProxyType(presets())

"""Conversion: particles of a solid that become a flowing material once they pass a limit.

    time     the time code of a frame
    strain   max_i |ln s_i|, the largest logarithmic principal stretch of F
    stress   von Mises' sqrt(3/2 s:s) [Pa], s the deviator of the Cauchy stress

Each particle is tested once per frame.  A particle that was converted keeps its mass and velocity
and never turns back.
"""

from __future__ import annotations

from dataclasses import dataclass

from gf_usd.core.arrays import Ints
from gf_usd.core.units import code_text

TIME, STRAIN, STRESS = "time", "strain", "stress"
KINDS = {TIME: "", STRAIN: "", STRESS: " Pa"}  # with their units


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The limit beyond which a particle is converted."""

    kind: str  # of KINDS
    value: float

    @property
    def text(self) -> str:
        """The limit as text."""
        if self.kind == TIME:
            return f"from time code {code_text(self.value)} on"
        return f"beyond a {self.kind} of {self.value:g}{KINDS[self.kind]}"


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """Particles, and the material to which they are converted."""

    particles: Ints  # (k,)
    material: int  # into the materials of the bake
    limit: Limit

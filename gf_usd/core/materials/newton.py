"""The attributes of Newton for materials with flow, ``newton:mpm:``, and their counterparts here.

Newton bounds sqrt(J2), the stress of pure shear, by yieldStress + internalFriction p, and the
pressure p by yieldPressure and, in tension, by tensileYieldRatio times that.
"""

from __future__ import annotations

import math

# sqrt(3 J2), the equivalent stress, is bounded here, and a viscosity refers to its rate.
FLOW = {"yield_stress": ("yieldStress", 3.0**0.5), "flow_viscosity": ("viscosity", 3.0)}
GRAINS = {"internal_friction": ("internalFriction", 1.0), "cohesion": ("yieldStress", 1.0)}
GRANULAR, CRUSHABLE = "druckerPrager", "crushable"
TENSION = "tensileYieldRatio"


def cap(shear: float, pressure: float) -> tuple[float, float]:
    """Yield stress [Pa] and shape alpha of the cap of `crushable`, from Newton's two bounds [Pa].

    Its ellipse sigma^2 + alpha^2 p^2 = Y^2 (1 + alpha^2 / 9) has sigma = sqrt(3) shear at p = 0 and
    p = pressure at sigma = 0.
    """
    alpha = math.sqrt(3.0) * shear / pressure
    return math.sqrt(3.0) * shear / math.sqrt(1.0 + alpha**2 / 9.0), alpha


def bounds(yield_stress: float, alpha: float) -> tuple[float, float]:
    """The inverse of `cap`: yieldStress and yieldPressure [Pa]."""
    sigma = yield_stress * math.sqrt(1.0 + alpha**2 / 9.0)
    return sigma / math.sqrt(3.0), sigma / alpha

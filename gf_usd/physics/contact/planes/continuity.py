"""Energy continuity of contact planes between two detections.

A detection changes points and normals without any motion, and so the energy of the springs. The new
planes of a pair (a body and its partner) are therefore shifted along their normals, so that the
depth of its samples is f times the true one: with A and B the energy of the first and second term
of the springs at the true depths, f^2 A + f^4 B = E_old conserves the energy of the pair. f differs
from 1 by a few percent, and is computed at each detection from the true depths. An `EnergyBudget`,
which bounds the power and the total energy added, lets f approach 1.

Friction springs are kept while a sample has the same partner: they are rotated into the new plane
with their length. Otherwise they are released.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gf_usd.core.arrays import Floats, Ints, nonzero_rows, row_dots
from gf_usd.core.materials.dimensionless import time_scale
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes, along

EASE = 0.1  # [spacings] largest increase of a sample's depth by a detection
# Bound of f, for a pair with hardly a sample left inside after a detection.
MOST = 2.0
# Of m g r: power in T, and energy in all, by which detections may bring pairs to their true depths.
# This lifts what rests on them, and takes a few T.  Without a bound of the whole, a sample between
# two sheets, whose plane changes sides at every detection, is given energy for ever.
POWER = 1e-4
RESERVE = 4e-4


@dataclass
class EnergyBudget:
    """Energy that detections may give to the contact springs of a body so that depths are true."""

    power: float  # [W] for each pair
    reserve: float  # [J] in all
    given: float = 0.0  # [J] so far; what was taken back does not count

    @classmethod
    def of_body(cls, mass: float, g: float, radius: float) -> EnergyBudget:
        """For a body of a mass [kg] and a radius [m] under gravity g [m/s^2]."""
        energy = mass * g * radius
        return cls(power=POWER * energy / time_scale(radius), reserve=RESERVE * energy)

    def spend(self, missing: Floats, elapsed: float) -> Floats:
        """(p,) [J] given to each pair, below 0: taken, of what is missing (p,) [J] to its true
        energy; elapsed : [s] since the last detection."""
        most = self.power * elapsed
        given = np.clip(missing, -most, most)
        asked, taken = float(given[given > 0.0].sum()), -float(given[given < 0.0].sum())
        left = self.reserve - self.given + taken
        if asked > left:
            given = np.where(given > 0.0, given * (max(left, 0.0) / asked), given)
        self.given += float(given.sum())
        return given


@dataclass(frozen=True, kw_only=True)
class Stored:
    """The depths and stiffnesses of n samples under the planes of one detection."""

    planes: ContactPlanes
    depth: Floats  # (n,) [m]
    stiffness: Floats  # (n,) [N/m] of a spring at small depth
    hardening: float  # [1/m^2] 1 / a^2: see `kernels.pair_contact`
    pair: Ints  # (n,) number of the pair of bodies, or of body and obstacle; below 0: none

    @property
    def normal_energy(self) -> Floats:
        """(n,) [J] k d^2 (1 + (d / a)^2 / 2) / 2."""
        square = self.depth**2
        return 0.5 * self.stiffness * square * (1.0 + 0.5 * self.hardening * square)

    @property
    def energy(self) -> float:
        """[J] of all springs."""
        xi = self.planes.spring
        return float(self.normal_energy.sum() + 0.5 * self.stiffness @ row_dots(xi, xi))


def continued(
    old: Stored, true: Stored, *, ease: float, budget: EnergyBudget, elapsed: float
) -> Stored:
    """The true planes, shifted along their normals so that each pair conserves its energy.

    ease : [m] largest increase of a depth; budget : by which the energies of pairs may approach the
    true ones; elapsed : [s] since the last detection.
    """
    eased = replace(true, depth=np.minimum(true.depth, old.depth + ease))
    pairs = 1 + int(max(old.pair.max(initial=-1), true.pair.max(initial=-1)))

    def summed(pair: Ints, energy: Floats) -> Floats:
        some = pair >= 0
        return np.bincount(pair[some], energy[some], pairs)

    had, aim = summed(old.pair, old.normal_energy), summed(true.pair, true.normal_energy)
    goal = had + budget.spend(aim - had, elapsed)
    linear = 0.5 * eased.stiffness * eased.depth**2
    a, b = summed(true.pair, linear), summed(true.pair, eased.normal_energy - linear)
    root = a + np.sqrt(a * a + 4.0 * b * goal)
    scale = np.minimum(np.sqrt(2.0 * goal / np.where(root > 0.0, root, 1.0)), MOST)
    depth = np.where(true.pair >= 0, np.append(scale, 0.0)[true.pair] * eased.depth, 0.0)
    planes = true.planes
    point = planes.point - (true.depth - depth)[:, None] * planes.normal
    planes = replace(planes, point=point, spring=_kept(old, true))
    return replace(true, planes=planes, depth=depth)


def _kept(old: Stored, new: Stored) -> Floats:
    """(n, 3) [m] friction springs in the new planes, with their energy."""
    xi = old.planes.spring
    kept = nonzero_rows(xi)
    kept = kept[(old.pair[kept] == new.pair[kept]) & (new.pair[kept] >= 0)]
    out = np.zeros_like(xi)
    if len(kept):
        turned = along(xi[kept], new.planes.normal[kept])
        length = np.linalg.norm(turned, axis=1)
        asked = np.linalg.norm(xi[kept], axis=1) * np.sqrt(
            old.stiffness[kept] / new.stiffness[kept]
        )
        out[kept] = turned * (asked / np.where(length > 0.0, length, 1.0))[:, None]
    return out

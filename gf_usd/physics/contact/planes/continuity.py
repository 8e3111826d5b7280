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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints, nonzero_rows, row_dots
from gf_usd.core.materials.dimensionless import time_scale
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes, along

EASE = 0.1  # [spacings] largest increase of a sample's depth by a detection
# Bound of f, for a pair with hardly a sample left inside after a detection.
MOST = 2.0
# Fractions of m g r: power per T by which detections may bring a pair to its true depths, and the
# energy in all that they may add to a body's contact with itself.
POWER = 1e-4
RESERVE = 4e-4


@dataclass(frozen=True, kw_only=True)
class PairNumbers:
    """Indices of the pairs of one of B bodies and what is opposite: O obstacles, then bodies."""

    obstacles: int  # O
    bodies: int  # B

    def of(self, body: Ints, other: Ints) -> Ints:
        """The numbers of pairs of a body and an obstacle, or O + another body."""
        return body * (self.obstacles + self.bodies) + other

    def split(self, pair: Any) -> tuple[Any, Any]:
        """The inverse of `of`; pair : (k,) numbers, or one."""
        return divmod(pair, self.obstacles + self.bodies)


class EnergyBudget:
    """Energy that detections may add to contact springs so that depths become the true ones.

    The power is bounded for each pair.  Along a curved surface it is needed at every detection,
    since samples that follow their planes are found deeper than before.  In the contact of a body
    with itself the total energy is bounded, too: a sample between two sheets, whose plane changes
    sides at every detection, would gain energy without limit.

    power : [W] of pairs, by their numbers (k,); own : (B,) numbers of the pairs
    of a body with itself; reserve : (B,) [J] for each of these.
    """

    def __init__(self, power: Callable[[Ints], Floats], own: Ints, reserve: Floats) -> None:
        self._power, self._own, self._reserve = power, own, reserve
        self.given = np.zeros(len(own))  # (B,) [J] of the reserve; less what was taken back

    @classmethod
    def of_flow(
        cls, mass: float, radius: float, solids: tuple[Floats, Floats], obstacles: int, g: float
    ) -> EnergyBudget:
        """For a flow of mass [kg] and radius [m], which has no self-contact.

        Pairs are numbered by the opposite body: first O obstacles, then bodies.  The flow and a
        solid body have the power of the one of the two that has less.

        solids : masses [kg] and radii [m] (B,) of the solid bodies.
        """
        flow, each = _power(np.array([mass]), np.array([radius]), g), _power(*solids, g)
        power = np.concatenate([np.repeat(flow, obstacles), np.minimum(flow, each)])
        return cls(lambda pair: power[pair], np.zeros(0, np.int64), np.zeros(0))

    @classmethod
    def of_bodies(cls, mass: Floats, radius: Floats, obstacles: int, g: float) -> EnergyBudget:
        """For bodies of masses [kg] and radii [m] (B,), with pairs as in `PairNumbers`.

        A pair of bodies has the power of the one of the two that has less.
        """
        power = _power(mass, radius, g)
        numbers = PairNumbers(obstacles=obstacles, bodies=len(mass))

        def of_pairs(pair: Ints) -> Floats:
            body, other = numbers.split(pair)
            theirs = power[np.maximum(other - obstacles, 0)]
            return np.where(other < obstacles, power[body], np.minimum(power[body], theirs))

        body = np.arange(len(mass))
        return cls(of_pairs, numbers.of(body, obstacles + body), RESERVE * mass * g * radius)

    def spend(self, missing: Floats, elapsed: float) -> Floats:
        """(p,) [J] by which the energy of each pair changes.

        missing : (p,) [J] to the true energy; elapsed : [s] since the last detection.
        """
        given, pairs = np.zeros(len(missing)), np.flatnonzero(missing)
        most = elapsed * self._power(pairs)
        given[pairs] = np.clip(missing[pairs], -most, most)
        some = np.flatnonzero(self._own < len(given))
        own = self._own[some]
        given[own] = np.minimum(given[own], np.maximum(self._reserve - self.given, 0.0)[some])
        self.given[some] += given[own]
        return given


def _power(mass: Floats, radius: Floats, g: float) -> Floats:
    """(B,) [W] `POWER` m g r / T of masses [kg] and radii [m] (B,); g : [m/s^2]."""
    return POWER * mass * g * radius / np.array([time_scale(float(r)) for r in radius])


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
        target = np.linalg.norm(xi[kept], axis=1) * np.sqrt(
            old.stiffness[kept] / new.stiffness[kept]
        )
        out[kept] = turned * (target / np.where(length > 0.0, length, 1.0))[:, None]
    return out

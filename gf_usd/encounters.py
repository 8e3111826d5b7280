"""What the bodies of a bake may meet besides the floor: obstacles, each other, themselves."""

from __future__ import annotations

from dataclasses import dataclass

from gf_usd.model import Floats, Ints
from gf_usd.stage_physics import Collider


@dataclass(frozen=True, kw_only=True)
class Skin:
    """The surface of a body that others meet, closed and seen from outside."""

    points: Floats  # (V, 3) [m] at rest
    triangles: Ints  # (T, 3) into points, counter-clockwise seen from outside


@dataclass(frozen=True, kw_only=True)
class Encounters:
    """Who meets whom."""

    skins: tuple[Skin, ...]  # one a body
    colliders: tuple[Collider, ...] = ()
    through: frozenset[tuple[int, int]] = frozenset()  # (body, body) that pass through each other
    through_colliders: frozenset[tuple[int, int]] = frozenset()  # (body, collider)
    self_contact: bool = False  # a body meets itself

    def lowest(self, normal: Floats) -> float:
        """[m] of the lowest obstacle with an end along a normal (3,); inf where there is none."""
        ends = [c for c in self.colliders if c.shape != "plane"]
        return min((float((c.positions(0) @ normal).min()) for c in ends), default=float("inf"))

    @property
    def any(self) -> bool:
        """Whether there is anything to meet."""
        return len(self.skins) > 1 or bool(self.colliders) or self.self_contact

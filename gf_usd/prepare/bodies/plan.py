"""The bodies of a bake: surfaces that fall as one, and their particles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset
from gf_usd.core.frames import Particles
from gf_usd.core.neighbors import kd_tree

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


LEAST = 16  # particles: a body of fewer does not hold a grid


@dataclass(frozen=True, kw_only=True)
class BodyPlan:
    """The bodies of a bake."""

    of_surface: Ints  # (S,) body of each filled surface, in the order of `Solid.surfaces`
    radius: Floats  # (B,) [m] r = (3 V / 4 pi)^(1/3)
    surfaces: tuple[tuple[str, ...], ...]  # prim paths of each body
    embedded: dict[str, int]  # body that each mesh moves with, by prim path
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        return len(self.radius)

    def flows(self, surfaces: Ints) -> Ints:
        """(B,) which bodies flow; surfaces : (S,) which filled surfaces do."""
        return np.bincount(self.of_surface, surfaces, minlength=self.count) > 0.0


def plan_bodies(
    asset: Asset,
    solid: Solid,
    spacing: float,
    sample: Callable[[Ints], Particles],
    owners: dict[str, str],
    *,
    combine: bool,
    kinds: Ints | None = None,
) -> tuple[BodyPlan, Particles]:
    """The bodies of a solid, and the particles that fill them.

    spacing : [m] about that of the particles; sample : particles for the body (S,) of each surface;
    owners : the physics body prim that a surface belongs to, by path; combine : one body in all;
    kinds : (S,) surfaces of two kinds are never one body; None: all are of one.
    """
    from gf_usd.geometry.connected.bodies import find_bodies

    owned = [owners.get(s.path, "") for s in solid.surfaces]
    of = find_bodies(solid, spacing, owners=owned, combine=combine, kinds=kinds)
    particles = sample(of)
    of, fused = _fuse_small(of, solid, particles, kinds)
    if fused:
        particles = sample(of)
    body = of[particles.surface]
    volume = np.bincount(body, particles.V0, minlength=int(of.max()) + 1)
    paths = [s.path for s in solid.surfaces]
    names = tuple(tuple(p for p, k in zip(paths, of) if k == b) for b in range(int(of.max()) + 1))
    notes = [
        f"<{paths[s]}> holds {n} particles and is merged with <{paths[host]}>"
        for s, n, host in fused
    ]
    if len(names) > 1:
        notes.append(
            f"{len(names)} bodies, which collide: {_listed(names)}; --combine makes them one body"
        )
    several = len(names) > 1
    radius = np.cbrt(3.0 * volume / (4.0 * np.pi)) if several else np.array([particles.radius])
    plan = BodyPlan(
        of_surface=of,
        radius=radius,
        surfaces=names,
        embedded=_embedded(asset, dict(zip(paths, of.tolist())), particles, body),
        notes=tuple(notes),
    )
    return plan, replace(particles, body=body if several else None)


def _listed(names: Sequence[Sequence[str]]) -> str:
    first = ", ".join(f"<{one[0]}>" for one in names[:4])
    return first + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _fuse_small(
    of: Ints, solid: Solid, particles: Particles, kinds: Ints | None = None
) -> tuple[Ints, list[Any]]:
    """Bodies of too few particles become one with the nearest; (surface, particles, host) of each.

    A surface without any particle is a shell about nothing: it can only be embedded.
    """
    of, fused = of.copy(), []
    for body in range(int(of.max()) + 1):
        members = np.flatnonzero(of == body)
        mine = np.isin(particles.surface, members)
        if mine.sum() >= LEAST or len(members) == len(of):
            continue
        rest = np.flatnonzero(~mine)
        if kinds is not None:
            rest = rest[kinds[particles.surface[rest]] == kinds[members[0]]]
        if not len(rest):
            continue
        points = np.concatenate([solid.surfaces[s].points for s in members])
        gap, at = kd_tree(particles.X[rest]).query(points)
        host = int(particles.surface[rest[at[np.argmin(gap)]]])
        of[members] = of[host]
        fused += [(int(s), int((particles.surface == s).sum()), host) for s in members]
    _, first = np.unique(of, return_index=True)
    renumbered = np.argsort(np.argsort(first))[np.unique(of, return_inverse=True)[1]]
    return renumbered, fused


def _embedded(
    asset: Asset, filled: dict[str, int], particles: Particles, body: Ints
) -> dict[str, int]:
    """Body that each surface moves with: its own, or that which most of its points are nearest."""
    tree, out = None, {}
    for surface in asset.surfaces:
        if surface.path in filled:
            out[surface.path] = filled[surface.path]
            continue
        if tree is None:
            tree = kd_tree(particles.X)
        out[surface.path] = int(np.bincount(body[tree.query(surface.points)[1]]).argmax())
    return out

"""The bodies of a bake: groups of surfaces, and their particles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.asset import Asset
from gf_usd.core.errors import counted, listed, listed_paths
from gf_usd.core.frames.particles import Particles
from gf_usd.core.neighbors import kd_tree
from gf_usd.core.units import length_text

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid


LEAST = 16  # particles: what has fewer is no more than a lump
REACH = 2.0  # [spacings] within which a mesh that is not filled touches a body
LARGE = 0.8  # of the size of such a mesh: a smaller body does not carry it if it touches another
MOST_NAMED = 2  # meshes of a body that a note names
CELL = 2.0  # [spacings] parts in neighboring cells have two planes of nodes or more in common


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
        """(B,) whether each body flows; surfaces : (S,) which filled surfaces do."""
        return np.bincount(self.of_surface, surfaces, minlength=self.count) > 0.0


def plan_bodies(
    asset: Asset,
    solid: Solid,
    spacing: float,
    sample: Callable[[Ints], Particles],
    owners: dict[str, str],
    find: Callable[[float], Ints],
    *,
    combine: bool,
    kinds: Ints | None = None,
    characters: bool = False,
    can_combine: bool = True,
) -> tuple[BodyPlan, Particles]:
    """The bodies of a solid, and the particles that fill them.

    spacing : [m] approximate spacing of the particles; sample : particles for the body (S,) of each
        surface; owners : the physics body prim of each surface, by path, or the SkelRoot where
        bodies are `characters` of --flesh; find : (S,) the body of each surface by `find_bodies`,
        at a spacing [m]; combine : a single body; can_combine : there is such an option, for notes;
        kinds : (S,) surfaces of different kinds are never one body; None: all are of one kind.
    """
    from gf_usd.geometry.connected.bodies import TOUCHING, overlapping

    owned = [owners.get(s.path, "") for s in solid.surfaces]
    of = find(spacing)
    notes = [] if combine else _touching(of, solid, owned, TOUCHING * spacing, asset)
    particles = sample(of)
    of, fused = _fuse_small(of, solid, particles, owned, kinds)
    if fused:
        particles = sample(of)
    body = of[particles.surface]
    volume = np.bincount(body, particles.V0, minlength=int(of.max()) + 1)
    paths = [s.path for s in solid.surfaces]
    names = tuple(tuple(p for p, k in zip(paths, of) if k == b) for b in range(int(of.max()) + 1))
    notes += [
        f"<{paths[s]}> has {counted(n, 'particle')}, too few for a body of its own, and is one"
        f" body with <{paths[host]}>"
        for s, n, host in fused
    ]
    notes += _small(names, np.bincount(body))
    if len(names) > 1:
        what = "characters" if characters else "bodies"
        when = ", from the first frame of the animation on" if characters else ""
        notes.append(
            f"{len(names)} {what}, which collide{when}: {listed_paths([one[0] for one in names])}"
            + ("; --combine makes them one body" if can_combine else "")
        )
    pairs: list[tuple[int, int]] = []
    if len(names) > 1 and not characters:
        inner = [particles.X[particles.surface == k] for k in range(len(paths))]
        pairs = overlapping(solid, spacing, of, owned, inner)
    if pairs:
        one, two = (f"<{paths[k]}>" for k in pairs[0])
        more = f" (and {counted(len(pairs) - 1, 'more pair')})" if len(pairs) > 1 else ""
        notes.append(
            f"{one} and {two}{more} are different physics bodies that overlap: they keep this"
            " overlap until they move apart; move them apart"
            + (" in the asset, or use --combine" if can_combine else "")
        )
    several = len(names) > 1
    radius = np.cbrt(3.0 * volume / (4.0 * np.pi)) if several else np.array([particles.radius])
    plan = BodyPlan(
        of_surface=of,
        radius=radius,
        surfaces=names,
        embedded=_embedded(
            asset, {path: int(of[k]) for path, k in solid.filled.items()}, particles, body, owners
        ),
        notes=tuple(notes),
    )
    return plan, replace(particles, body=body if several else None)


def _touching(
    of: Ints, solid: Solid, owners: Sequence[str], reach: float, asset: Asset
) -> list[str]:
    """A note on surfaces that are one body only because they touch; reach : [m] distance that
    counts as touching.
    """
    paths = [s.path for s in solid.surfaces]
    found = []
    for body in range(int(of.max()) + 1):
        members = np.flatnonzero(of == body)
        if len({owners[int(s)] or paths[int(s)] for s in members}) > 1:
            found.append([paths[int(s)] for s in members])
    if not found:
        return []
    count = sum(len(one) for one in found)
    what = "one body" if len(found) == 1 else f"{len(found)} bodies"
    away = f"{length_text(reach)} ({reach / asset.facts.units.length:.3g} stage units)"
    bodies = listed([listed_paths(one, MOST_NAMED) for one in found], join="; ")
    return [
        f"{count} meshes that touch or overlap are {what}: {bodies}"
        f"; to keep them apart, make them rigid or deformable bodies (UsdPhysics), move them"
        f" more than {away} apart, or, if they only touch, make them models of kind component"
    ]


def _small(names: Sequence[Sequence[str]], particles: Ints) -> list[str]:
    """A note on bodies with few particles."""
    few = np.flatnonzero(particles < LEAST)
    if len(names) == 1 or not len(few):
        return []
    most = int(particles[few].max())
    count = f"{most} particle{'s' * (most > 1)}"
    have = f"has only {count}" if len(few) == 1 else f"have at most {count} each"
    return [
        f"{listed_paths([names[int(k)][0] for k in few])} {have}, too few to bend: give more"
        " --particles, or a smaller --spacing"
    ]


def _fuse_small(
    of: Ints, solid: Solid, particles: Particles, owners: Sequence[str], kinds: Ints | None = None
) -> tuple[Ints, list[Any]]:
    """Join bodies with few particles to an adjacent body; returns (surface, particles, host).

    Bodies more than a cell apart share too few nodes to move together stiffly.  A surface without
    particles has no volume and can only be embedded.
    """
    of, fused = of.copy(), []
    kinds = np.zeros(len(of), np.int64) if kinds is None else kinds
    held = np.array(owners)
    for body in range(int(of.max()) + 1):
        members = np.flatnonzero(of == body)
        mine = np.isin(particles.surface, members)
        if mine.sum() >= LEAST or not len(members) or len(members) == len(of):
            continue
        others = of[particles.surface] != body
        others &= kinds[particles.surface] == kinds[members[0]]
        if mine_of := "".join(set(held[members])):  # of one owner, or of none
            rivals = of[(held != "") & (held != mine_of)]
            others &= ~np.isin(of[particles.surface], rivals)
        rest = np.flatnonzero(others)
        if not len(rest):
            continue
        near = CELL * particles.lattice if mine.any() else np.inf
        points = (
            particles.X[mine]
            if mine.any()
            else np.concatenate([solid.surfaces[s].points for s in members])
        )
        gap, at = kd_tree(particles.X[rest]).query(points, p=np.inf)
        if gap.min() > near:
            continue
        host = int(particles.surface[rest[at[np.argmin(gap)]]])
        of[members] = of[host]
        fused += [(int(s), int((particles.surface == s).sum()), host) for s in members]
    _, first = np.unique(of, return_index=True)
    renumbered = np.argsort(np.argsort(first))[np.unique(of, return_inverse=True)[1]]
    return renumbered, fused


def _embedded(
    asset: Asset,
    filled: dict[str, int],
    particles: Particles,
    body: Ints,
    owners: dict[str, str],
) -> dict[str, int]:
    """The body that each surface moves with: its own, or the one nearest to most of its points;
    where that is smaller than LARGE times the surface, another that is not and touches it.

    filled : of the meshes that are filled, or parts of one (`Solid.filled`).

    A surface with an owner moves with a body of that owner, if there is one, and one of a component
    with a body of that.
    """
    of_owner: dict[str, set[int]] = {}
    belongs = {s.path: owners.get(s.path, "") or s.component for s in asset.surfaces}
    for path, k in filled.items():
        of_owner.setdefault(belongs.get(path, ""), set()).add(k)
    every = set(filled.values())
    sizes = _sizes(particles.X, body)
    trees: dict[frozenset[int], Any] = {}
    out = {}
    for surface in asset.surfaces:
        if surface.path in filled:
            out[surface.path] = filled[surface.path]
            continue
        owner = belongs[surface.path]
        mine = frozenset(of_owner.get(owner, every) if owner else every)
        rows = np.flatnonzero(np.isin(body, list(mine)))
        if not len(rows):  # its own body is too small for a particle
            mine, rows = frozenset(every), np.arange(len(body))
        if mine not in trees:
            trees[mine] = kd_tree(particles.X[rows])
        near = rows[trees[mine].query(surface.points)[1]]
        k = int(np.bincount(body[near]).argmax())
        size = float(np.linalg.norm(np.ptp(surface.face_points, axis=0)))
        # Particles are half a spacing within the surface of their body: a label is no larger.
        large = sizes + REACH * particles.lattice >= LARGE * size
        if not large[k]:  # such as a tooth in an open head, which comes off
            k = _touched(surface.points, rows[large[body[rows]]], particles, body, k)
        out[surface.path] = k
    return out


def _sizes(X: Floats, of: Ints) -> Floats:
    """(B,) [m] diagonal of the bounding box of the points X (n, 3) of each body."""
    low = np.full((int(of.max(initial=0)) + 1, 3), np.inf)
    high = -low
    np.minimum.at(low, of, X)
    np.maximum.at(high, of, X)
    return np.where(np.isfinite(low[:, 0]), np.linalg.norm(high - low, axis=1), 0.0)


def _touched(points: Floats, rows: Ints, particles: Particles, body: Ints, otherwise: int) -> int:
    """The body of the particles `rows` that is at most of the points (n, 3) [m] within REACH."""
    if not len(rows):
        return otherwise
    gap, near = kd_tree(particles.X[rows]).query(points)
    close = gap <= REACH * particles.lattice
    return int(np.bincount(body[rows[near[close]]]).argmax()) if close.any() else otherwise

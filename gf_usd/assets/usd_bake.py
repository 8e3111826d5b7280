"""Bake settings that a stage carries: GaussianFleshBakeAPI."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from pxr import Usd

from gf_usd.assets.usd_physics_roles import role
from gf_usd.assets.usd_physics_values import count, flag, number, word
from gf_usd.assets.usd_select import named_prim
from gf_usd.assets.usd_stage import open_stage, reading
from gf_usd.materials import presets
from gf_usd.model import StageFacts
from gf_usd.playback import first_time_code
from gf_usd.stage_physics import PrimBake

T = TypeVar("T")

ENABLED, MATERIAL = "gaussianFlesh:enabled", "gaussianFlesh:material"
SPACING, PARTICLES = "gaussianFlesh:spacing", "gaussianFlesh:particles"
SEED, SOLVER = "gaussianFlesh:seed", "gaussianFlesh:solver"
SOLVERS = {"totalLagrangian": "tl", "updatedLagrangian": "ul"}


def read_bake_settings(
    file: Path, facts: StageFacts, prims: Sequence[str], *, rest: float | None = None
) -> tuple[PrimBake, ...]:
    """The settings that hold for each of the prims, in their order.

    Each attribute is that of the prim itself or of the nearest one above that authors it.  The
    attributes count also where the API's name is not applied: a program without our schema can
    author those but not this.

    file : the USD file; facts.path is what messages call it.  rest : time code of the rest pose.

    Raises InputError for a path that names no prim and for values that make no sense.
    """
    with reading(file):
        stage = open_stage(file)
        time = Usd.TimeCode(first_time_code(facts, rest))
        return tuple(_settings(named_prim(stage, facts.path, path), facts, time) for path in prims)


def _settings(prim: Usd.Prim, facts: StageFacts, time: Usd.TimeCode) -> PrimBake:
    path = facts.path
    spacing, particles, particles_of = _resolution(prim, path, time)
    return PrimBake(
        path=str(prim.GetPath()),
        enabled=_nearest(prim, lambda p: flag(path, p, ENABLED, time)),
        # Without a name the bound physics material counts, whatever is named above.
        material=_nearest(prim, lambda p: word(path, p, MATERIAL, time, ("", *presets()))) or None,
        spacing=None if spacing is None else spacing * facts.units.length,
        particles=particles,
        particles_of=particles_of,
        seed=_nearest(prim, lambda p: count(path, p, SEED, time)),
        solver=SOLVERS.get(_nearest(prim, lambda p: word(path, p, SOLVER, time, SOLVERS)) or ""),
        role=role(prim, time),
    )


def _resolution(
    prim: Usd.Prim, path: Path, time: Usd.TimeCode
) -> tuple[float | None, int | None, str]:
    """Spacing [stage units], or number of particles with its prim: the nearest that is set, and of
    two on one prim the spacing.  0 unsets what is said above.
    """
    spacing_open = particles_open = True
    for above in _upwards(prim):
        spacing = number(path, above, SPACING, time)
        particles = count(path, above, PARTICLES, time)
        if spacing and spacing_open:
            return spacing, None, ""
        if particles and particles_open:
            return None, particles, str(above.GetPath())
        spacing_open = spacing_open and spacing is None
        particles_open = particles_open and particles is None
    return None, None, ""


def _nearest(prim: Usd.Prim, read: Callable[[Usd.Prim], T | None]) -> T | None:
    """What the prim itself says, or the nearest above it."""
    return next((value for one in _upwards(prim) if (value := read(one)) is not None), None)


def _upwards(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    """The prim and those above it."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()

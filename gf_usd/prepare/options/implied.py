"""The request, completed with values of the stage and the presets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError, UsageError, listed_paths
from gf_usd.core.frames.settings import MIXED
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.materials.flowing import Dispatch
from gf_usd.prepare.materials.regions import shown
from gf_usd.prepare.options.request import Request


def with_stage(request: Request, spec: StageSpec, asset: Asset) -> tuple[Request, tuple[str, ...]]:
    """The request, with the stage's values where an option is not set, and notes."""
    notes = []
    path, physics = asset.facts.path, spec.physics
    more: dict[str, Any] = {}
    mixed = request.solver == MIXED
    unaware = "bakes with flowing bodies" if mixed else "--rigid and --solver ul"
    if request.gravity is None and physics.gravity is not None:
        more["gravity"] = ",".join(repr(g) for g in physics.gravity)
        notes.append(
            f"gravity is that of <{physics.scene}>: {shown(physics.gravity)} m/s^2"
            + (f", and {len(physics.gravity_keys)} time samples" if physics.gravity_keys else "")
        )
        if physics.gravity_keys and (request.rigid or request.solver in ("ul", MIXED)):
            raise UsageError(
                f"{path}: gravity of <{physics.scene}> changes over time, which {unaware} do not"
                f" support",
                "give one with --gravity",
            )
    if physics.fields and not request.fields:
        if request.rigid or request.solver in ("ul", MIXED):
            raise UsageError(
                f"{path}: <{physics.scene}> has fields, which {unaware} do not support",
                "remove the fields" if mixed else "omit --rigid or --solver ul",
            )
        notes.append(f"fields are those of <{physics.scene}>: {' '.join(physics.fields)}")
    if request.floats:
        more["floor"] = "none"
    if obstacles := physics.obstacles:
        several = len(obstacles) > 1
        counted = f"there {'are' if several else 'is'} {len(obstacles)} obstacle{'s' * several}"
        if request.floor is None and not request.flesh:
            more["floor"] = "none"
            notes.append(f"{counted}, so there is no floor; --floor 0 adds one")
    for name in ("seed", "solver"):
        if getattr(request, name) is None:
            agreed = agreed_value(
                name, [(p, getattr(b, name)) for p, b in spec.bakes.items()], path
            )
            if agreed is not None:
                more[name] = agreed
                notes.append(f"{name} is {agreed}, from the stage")
    return replace(request, **more), tuple(notes)


ON_FLOOR = 1e-3  # of the height of an asset that is less far below the floor: it stands on it


def replaced_masses(spec: StageSpec, material: str, request: Request) -> tuple[str, ...]:
    """A note on the masses and densities of the stage that presets replace.

    material : names of the presets, which --preset paper and --material-sweep imply.
    """
    stated: dict[str, str] = {}
    for body in spec.bodies.values():
        if body.mass is not None:
            stated[body.mass_of] = "mass"
        elif body.density is not None:
            stated[body.density_of] = "density"
    if not stated:
        return ()
    what, way = f"--material {material}", "leave --material out to keep it"
    if request.material_sweep:
        what = "--material-sweep"
        way = "bakes without --material-sweep and --material keep it"
    elif request.preset == "paper":
        what = f"--preset paper with the material {material}"
        way = "bakes without --preset and --material keep it"
    first = stated[next(iter(stated))]
    return (
        f"{what} replaces the {first} that the stage gives {listed_paths([*stated], 1)}: {way}",
    )


def proposed_floor(asset: Asset, lowest: float, still: Sequence[str] = ()) -> str:
    """A note on the floor that a bake with flesh does not have, at a height that clears its poses.

    lowest : [m] height of the lowest point of the poses in the frames of the bake.
    still : prim paths of surfaces without poses, which count as they are at rest.
    """
    heights = np.concatenate([s.face_points @ asset.facts.up for s in asset.surfaces])
    others = f" and the rest shape of {listed_paths(still)}" if still else ""
    # one at height 0 would cut through a bind pose about the origin
    lowest = min(lowest, float(heights.min())) / asset.facts.units.length
    if lowest > -ON_FLOOR * float(np.ptp(heights)) / asset.facts.units.length:
        lowest = 0.0
    # three digits, rounded down: a point below the floor is pushed out at once
    digit = 10.0 ** (math.floor(math.log10(-lowest)) - 2) if lowest else 1.0
    height = math.floor(lowest / digit + 1e-6) * digit
    where = f", under its poses in these frames{others}," if lowest < 0.0 else ""
    return f"there is no floor under the animation; --floor {height:.3g}{where} adds one"


def with_flow(request: Request, flow: Dispatch) -> tuple[Request, tuple[str, ...]]:
    """The request for flowing bodies, with a note; unchanged where nothing flows.

    Raises UsageError for options that flowing bodies do not support.
    """
    names, paths = ", ".join(flow.names), listed_paths(flow.paths)
    mixed = (
        f"{paths}: flows without limit ({names}; Updated Lagrangian solver, with contact at every"
        f" particle); the other bodies are solid (Total Lagrangian solver); the flowing meshes are"
        f" hidden, and "
        + ("a surface around its particles is" if request.surface else "its particles are")
        + " shown with the other meshes"
    )
    if flow.later and request.solver is None:
        return replace(request, solver=MIXED), (mixed,) if flow.paths else ()
    if not flow.paths:
        return request, ()
    if request.solver == "tl":
        raise UsageError(
            f"--solver tl cannot be combined with {names}, which flows without limit",
            "omit it, or use --solver ul",
        )
    if flow.some and request.solver is None:
        for option, given in request.of_solids:
            if given:
                raise UsageError(
                    f"{option} cannot be combined with flowing bodies next to solid ones:"
                    f" {paths} ({names})",
                    f"leave {option} out, or bake the bodies separately with --prim",
                )
        return replace(request, solver=MIXED), (mixed,)
    if flow.some:
        return request, (f"{paths}: flows without limit ({names}); all is one body (--solver ul)",)
    if request.only is None and not request.surface:
        request = replace(request, only="gaussians,points")
    note = (
        f"{names}: flows without limit (Updated Lagrangian solver, with contact at every particle)"
    )
    if request.surface:
        note += "; a surface around the particles is shown instead of the mesh"
    elif "mesh" in (request.parsed["only"] or ()):
        note += "; the mesh tears where particles separate: --surface writes a surface around them"
    else:
        note += "; the mesh is hidden; --surface writes a surface around the particles"
    return replace(request, solver="ul"), (note,)


def stated_values(request: Request) -> dict[str, float]:
    """Values of the request that replace those of materials."""
    own = {
        name: value
        for name in ("damping_time", "friction", "restitution")
        if (value := getattr(request, name)) is not None
    }
    if request.preset == "paper":
        own.setdefault("damping_time", 0.0)  # the paper has none
    return own


def agreed_value(what: str, agreed: Sequence[tuple[str, object]], file: Path) -> object | None:
    """The value on which all that state one agree; None where none does.

    agreed : (prim path, value or None).  Raises InputError where two disagree.
    """
    known = [(path, value) for path, value in agreed if value is not None]
    for path, value in known:
        if value != known[0][1]:
            raise InputError(
                f"{file}: <{known[0][0]}> has {what} {known[0][1]}, <{path}> {value}:"
                " a bake has one",
                f"give --{what}, or bake them separately with --prim",
            )
    return known[0][1] if known else None

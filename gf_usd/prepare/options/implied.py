"""The request with what the stage and the presets say where it says nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.materials.presets import Preset
from gf_usd.core.stage import StageSpec
from gf_usd.prepare.materials.regions import shown
from gf_usd.prepare.options.request import Request


def with_stage(request: Request, spec: StageSpec, asset: Asset) -> tuple[Request, tuple[str, ...]]:
    """The request with what the stage says where it says nothing, and notes on that."""
    notes = []
    path, physics = asset.facts.path, spec.physics
    more: dict[str, Any] = {}
    if request.gravity is None and physics.gravity is not None:
        more["gravity"] = ",".join(repr(g) for g in physics.gravity)
        notes.append(
            f"gravity is that of <{physics.scene}>: {shown(physics.gravity)} m/s^2"
            + (f", and {len(physics.gravity_keys)} time samples" if physics.gravity_keys else "")
        )
        if physics.gravity_keys and (request.rigid or request.solver == "ul"):
            raise UsageError(
                f"{path}: gravity of <{physics.scene}> changes, which --rigid and --solver ul do"
                " not know",
                "give one with --gravity",
            )
    if physics.fields and not request.fields:
        if request.rigid or request.solver == "ul":
            raise UsageError(
                f"{path}: <{physics.scene}> has fields, which --rigid and --solver ul do not know",
                "leave --rigid or --solver ul out",
            )
        notes.append(f"fields are those of <{physics.scene}>: {' '.join(physics.fields)}")
    if request.flesh and request.floor is None:
        more["floor"] = "none"
        notes.append("there is no floor under the animation; --floor 0 adds one")
    if obstacles := physics.obstacles:
        several = len(obstacles) > 1
        counted = f"there {'are' if several else 'is'} {len(obstacles)} obstacle{'s' * several}"
        if request.floor is None and not request.flesh:
            more["floor"] = "none"
            notes.append(f"{counted}, so there is no floor; --floor 0 adds one")
        if request.solver == "ul":
            raise UsageError(
                f"{path}: --solver ul, which sand, pastes and liquids need, does not know"
                f" obstacles, and {counted}: <{obstacles[0].path}>",
                "use --solver tl with a material that does not flow without end, or remove the"
                " obstacles from a copy of the stage",
            )
    for name in ("seed", "solver"):
        if getattr(request, name) is None:
            said = one_said(name, [(p, getattr(b, name)) for p, b in spec.bakes.items()], path)
            if said is not None:
                more[name] = said
                notes.append(f"{name} is {said}, as the stage asks for")
    return replace(request, **more), tuple(notes)


def with_flow(
    request: Request, presets: Sequence[Any], law: str | None
) -> tuple[Request, tuple[str, ...]]:
    """The request for what flows without end, with a note; as it is where nothing does.

    Raises UsageError where only some of the variants do, or where the solver does not let them.
    """
    laws = [law or (p.law if isinstance(p, Preset) else "") for p in presets]
    flows = [one in LAWS and LAWS[one].unbounded for one in laws]
    if not any(flows):
        return request, ()
    names = ", ".join(preset.name for preset in presets)
    if not all(flows):
        raise UsageError(
            f"{names}: some of these flow without end, and are simulated by another solver",
            "bake them one by one",
        )
    if request.solver == "tl":
        raise UsageError(
            f"--solver tl does not go with {names}, which flows without end",
            "leave it out, or use --solver ul",
        )
    if request.only is None and not request.surface:
        request = replace(request, only="gaussians,points")
    note = f"{names}: flows without end (Updated Lagrangian solver; every particle feels the floor)"
    if request.surface:
        note += "; a surface around the particles is shown in place of the mesh"
    elif "mesh" in (request.parsed["only"] or ()):
        note += "; the mesh is torn where particles part: --surface draws a surface around them"
    else:
        note += "; the mesh is hidden, and --surface draws a surface around the particles"
    return replace(request, solver="ul"), (note,)


def stated_values(request: Request) -> dict[str, float]:
    """What the request says in place of a material's own values."""
    own = {
        name: value
        for name in ("damping_time", "friction", "restitution")
        if (value := getattr(request, name)) is not None
    }
    if request.preset == "paper":
        own.setdefault("damping_time", 0.0)  # the paper has none
    return own


def one_said(what: str, said: Sequence[tuple[str, object]], file: Path) -> object | None:
    """The value that all who say something agree on; None where nobody does.

    said : (prim path, value or None).  Raises InputError where two disagree.
    """
    known = [(path, value) for path, value in said if value is not None]
    for path, value in known:
        if value != known[0][1]:
            raise InputError(
                f"{file}: <{known[0][0]}> asks for {what} {known[0][1]}, <{path}> for {value}:"
                " a bake has one",
                f"give --{what}, or bake them apart with --prim",
            )
    return known[0][1] if known else None

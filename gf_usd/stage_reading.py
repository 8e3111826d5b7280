"""What a stage says of its own bake and of physics, read for the prims that are made soft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from gf_usd.advice import Advice
from gf_usd.errors import InputError
from gf_usd.model import Asset, Floats
from gf_usd.stage_physics import BodyPhysics, PrimBake, StagePhysics


@dataclass(frozen=True, kw_only=True)
class StageWords:
    """What is said; empty for an asset that is no USD file."""

    bakes: dict[str, PrimBake] = field(default_factory=dict)  # by prim path of a surface
    physics: StagePhysics = field(default_factory=StagePhysics)
    advice: dict[str, Advice] = field(default_factory=dict)  # of --material auto, by prim path
    painted: dict[str, dict[str, Floats]] = field(default_factory=dict)  # see `read_painted`

    @property
    def bodies(self) -> dict[str, BodyPhysics]:
        """By prim path of a surface."""
        return {body.path: body for body in self.physics.bodies}

    @property
    def says_material(self) -> bool:
        """Whether any prim asks for a material of its own."""
        named = any(bake.material for bake in self.bakes.values())
        bound = any(
            body.material or any(subset.material for subset in body.subsets)
            for body in self.physics.bodies
        )
        return named or bound or bool(self.painted)


def read_words(
    asset: Asset, file: Path, prims: Sequence[str], *, rest: float | None, elastic: bool
) -> tuple[Asset, StageWords]:
    """The asset without what its stage keeps out of a bake, and what the stage says of the rest.

    file : the asset's USD file; prims : what was asked for by name, which goes before the stage;
    rest : time code of the rest pose; elastic : False: the materials of bodies and what is painted
    on them are not read.

    Raises InputError where nothing is left, and for values that make no sense.
    """
    from gf_usd.assets.usd_bake import read_bake_settings
    from gf_usd.assets.usd_painted import read_painted

    found = read_bake_settings(file, asset.facts, [s.path for s in asset.surfaces], rest=rest)
    bakes = {bake.path: bake for bake in found}
    out = {
        path: why for path, bake in bakes.items() if path not in prims and (why := _kept_out(bake))
    }
    if out and len(out) == len(asset.surfaces):
        listed = "\n".join(f"  {path}: {why}" for path, why in out.items())
        raise InputError(
            f"{asset.facts.path}: the stage keeps every mesh out of a bake:\n{listed}",
            "name the mesh that is to be soft with --prim",
        )
    asset = replace(
        asset,
        surfaces=tuple(s for s in asset.surfaces if s.path not in out),
        skipped=(*asset.skipped, *out.items()),
    )
    physics = read_motion(asset, file, rest=rest, times=(), elastic=elastic)
    left = {s.path for s in asset.surfaces}
    return asset, StageWords(
        bakes={path: bake for path, bake in bakes.items() if path in left},
        physics=physics,
        painted=read_painted(file, asset.facts, asset.surfaces, rest=rest) if elastic else {},
    )


def read_motion(
    asset: Asset, file: Path, *, rest: float | None, times: Sequence[float], elastic: bool
) -> StagePhysics:
    """What the stage says of physics, with its obstacles at time codes `times`."""
    from gf_usd.assets.usd_physics import read_physics

    paths = [s.path for s in asset.surfaces]
    return read_physics(file, asset.facts, paths, rest=rest, times=times, elastic=elastic)


def _kept_out(bake: PrimBake) -> str:
    """Why the stage wants a prim left as it is; "" where it does not."""
    if bake.enabled is False:
        return "the stage turns its bake off (gaussianFlesh:enabled)"
    if bake.obstacle:
        return f"it is a {bake.role} collider: an obstacle"
    return ""


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

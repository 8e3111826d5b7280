"""The bake settings and physics of a stage, for the prims that are simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gf_usd.core.asset import Asset
from gf_usd.core.errors import InputError
from gf_usd.core.stage import PrimBake, StagePhysics, StageSpec


def read_stage_spec(
    asset: Asset, file: Path, prims: Sequence[str], *, rest: float | None, elastic: bool
) -> tuple[Asset, StageSpec]:
    """The asset without prims that the stage excludes from a bake, and the spec of the others.

    file : the asset's USD file.
    prims : prim paths of the user, which take precedence over the stage.
    rest : time code of the rest pose.
    elastic : False: materials and painted values of bodies are not read.

    Raises InputError where no prim is left, and for invalid values.
    """
    from gf_usd.readers.usd_bake.settings import read_bake_settings, read_painted

    found = read_bake_settings(file, asset.facts, [s.path for s in asset.surfaces], rest=rest)
    bakes = {bake.path: bake for bake in found}
    out = {
        path: why for path, bake in bakes.items() if path not in prims and (why := _excluded(bake))
    }
    if out and len(out) == len(asset.surfaces):
        listed = "\n".join(f"  <{path}>: {why}" for path, why in out.items())
        raise InputError(
            f"{asset.facts.path}: the stage excludes every mesh from the bake:\n{listed}",
            "name the mesh to bake with --prim",
        )
    asset = asset.without(out)
    physics = read_motion(asset, file, rest=rest, times=(), elastic=elastic)
    met = {one.path: _obstacle(one.role) for one in physics.colliders}
    asset = replace(asset, skipped=tuple((p, met.get(p, why)) for p, why in asset.skipped))
    left = {s.path for s in asset.surfaces}
    return asset, StageSpec(
        bakes={path: bake for path, bake in bakes.items() if path in left},
        physics=physics,
        painted=read_painted(file, asset.facts, asset.surfaces, rest=rest) if elastic else {},
    )


def read_motion(
    asset: Asset, file: Path, *, rest: float | None, times: Sequence[float], elastic: bool
) -> StagePhysics:
    """The physics of the stage, with the motion of its obstacles at time codes `times`."""
    from gf_usd.readers.usd_physics.scene import read_physics

    paths = [s.path for s in asset.surfaces]
    return read_physics(file, asset.facts, paths, rest=rest, times=times, elastic=elastic)


def _excluded(bake: PrimBake) -> str:
    """The reason why the stage excludes a prim from the bake; "" where it does not."""
    if bake.enabled is False:
        return "the stage turns off its bake (gaussianFlesh:enabled)"
    if bake.obstacle:
        return _obstacle(bake.role)
    return ""


def _obstacle(role: str) -> str:
    return f"{role} colliders are obstacles"

"""Which bake of a root layer is read: its variants, selected in the session only."""

from __future__ import annotations

from pathlib import Path

from pxr import Usd

from gf_usd.errors import UsageError

VARIANTS, NONE = "gaussianFlesh", "none"  # the variant set of a bake, and the source in it
DISPLAYS = {"mesh", "gaussians", "points"}


def looks_of(stage: Usd.Stage) -> tuple[str, ...]:
    """Names of the bakes in a file, in the order of the variants."""
    names: list[str] = []
    for prim in _switches(stage):
        names += prim.GetVariantSet(VARIANTS).GetVariantNames()
    return tuple(name for name in dict.fromkeys(names) if name != NONE) or _flattened(stage)


def select_look(stage: Usd.Stage, path: Path, look: str | None) -> str:
    """Select a look on every root prim that has it, and its display of meshes; returns its name.

    look : None: what is selected in the file, or the first where that is the source.  The name is
    "" where the file holds no bake.

    Raises UsageError where there is no such look.
    """
    looks = looks_of(stage)
    if look is not None and look not in looks:
        there = f"it holds {', '.join(looks)}" if looks else "it holds no bake: leave --look out"
        raise UsageError(f"{path} has no look {look!r}.", there)
    prims = _switches(stage)
    if not prims or not looks:
        return looks[0] if looks else ""
    chosen = look or prims[0].GetVariantSet(VARIANTS).GetVariantSelection()
    if chosen not in looks:
        chosen = looks[0]
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in prims:
        prim.GetVariantSet(VARIANTS).SetVariantSelection(chosen)
    for prim in prims:
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            if "mesh" in displays_in(prim, name):
                sets.SetSelection(name, "mesh")
    return chosen


def displays_in(prim: Usd.Prim, name: str) -> set[str]:
    """The shapes that a variant set switches between; empty where it is no display of ours.

    A bake need not hold all of the shapes.
    """
    names = set(prim.GetVariantSet(name).GetVariantNames())
    return names if name.lower().endswith("display") and names <= DISPLAYS else set()


def _flattened(stage: Usd.Stage) -> tuple[str, ...]:
    """The look of a bake that is one file, which has no variants of looks any more."""
    told = stage.GetRootLayer().customLayerData.get(VARIANTS)
    names = told.get("looks") if isinstance(told, dict) else None
    return tuple(names) if isinstance(names, dict) and len(names) == 1 else ()


def _switches(stage: Usd.Stage) -> list[Usd.Prim]:
    """Root prims that carry the variants of a bake."""
    return [
        prim
        for prim in stage.GetPseudoRoot().GetChildren()
        if prim.GetVariantSets().HasVariantSet(VARIANTS)
    ]

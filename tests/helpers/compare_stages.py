"""Everything that two stages say, side by side."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom

EVERYTHING = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
# How a stage is put together is what a layer over it changes; what it says is compared.
ARCS = {"references", "payload", "inheritPaths", "specializes", "variantSetNames", "instanceable"}
ARCS |= {"variantSelection"}
OUR_SETS = ("gaussianFlesh", "display", "gaussianFleshDisplay")


def says(stage: Usd.Stage) -> Iterator[tuple[str, object]]:
    """(name, value) of every prim, property, time sample and piece of metadata, composed."""
    for prim in Usd.PrimRange.Stage(stage, EVERYTHING):
        path = str(prim.GetPath())
        yield path, (prim.GetTypeName(), prim.GetSpecifier(), prim.IsActive())
        yield f"{path} instance", prim.IsInstance()
        yield f"{path} schemas", prim.GetAppliedSchemas()
        below = [p.GetName() for p in prim.GetFilteredChildren(EVERYTHING)]
        yield f"{path} children", [name for name in below if name != "GaussianFlesh"]
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            if name not in OUR_SETS:
                chosen = sets.GetVariantSelection(name), sets.GetVariantSet(name).GetVariantNames()
                yield f"{path} variant {name}", chosen
        for key, value in prim.GetAllAuthoredMetadata().items():
            if key not in ARCS:
                yield f"{path} {key}", value
        for attr in prim.GetAuthoredAttributes():
            where = str(attr.GetPath())
            yield where, (attr.GetTypeName(), attr.GetVariability(), attr.IsCustom())
            yield f"{where} default", attr.Get()
            yield f"{where} samples", [(t, attr.Get(t)) for t in attr.GetTimeSamples()]
            yield f"{where} connections", attr.GetConnections()
            for key, value in attr.GetAllAuthoredMetadata().items():
                if key not in ("default", "timeSamples"):
                    yield f"{where} {key}", value
        for rel in prim.GetAuthoredRelationships():
            yield str(rel.GetPath()), (rel.GetTargets(), rel.IsCustom())


def differences(source: Usd.Stage, result: Usd.Stage) -> dict[str, tuple[object, object]]:
    """Names of which the result says something else, or nothing: (source's, result's)."""
    theirs, ours = dict(says(source)), dict(says(result))
    return {
        name: (value, ours.get(name, "nothing"))
        for name, value in theirs.items()
        if name not in ours or ours[name] != value
    }


def additions(source: Usd.Stage, result: Usd.Stage) -> set[str]:
    """Names of which only the result says something."""
    return set(dict(says(result))) - set(dict(says(source)))


def world_points(stage: Usd.Stage, path: str, time_code: float) -> np.ndarray:
    """(V, 3) points of a prim in the world, stage units."""
    prim = stage.GetPrimAtPath(path)
    rows = np.array(UsdGeom.XformCache(time_code).GetLocalToWorldTransform(prim))
    points = np.array(prim.GetAttribute("points").Get(time_code), np.float64)
    return points @ rows[:3, :3] + rows[3, :3]


def with_variant(path: Path, name: str) -> Usd.Stage:
    """The stage, with a bake (or none) selected on every root prim that has the choice."""
    stage = Usd.Stage.Open(Sdf.Layer.FindOrOpen(str(path)), Sdf.Layer.CreateAnonymous(".usda"))
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in stage.GetPseudoRoot().GetAllChildren():
        if prim.GetVariantSets().HasVariantSet("gaussianFlesh"):
            assert prim.GetVariantSet("gaussianFlesh").SetVariantSelection(name)
    return stage

"""Helpers of the writers: the source stage, time codes, the scope of the particle prims, and the
conversion of NumPy arrays to those of USD.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import BAKES, Asset, StageFacts, baked_already, free_name
from gf_usd.core.errors import BakeError, InputError, UsageError
from gf_usd.core.frames.choices import Choices
from gf_usd.core.frames.settings import Settings
from gf_usd.system.atomic_files import partial_path, same_place

VARIANT_SET = BAKES
SCOPE = "GaussianFlesh"

# Attributes that are time derivatives of others.
RATES = ("velocities", "accelerations", "angularVelocities")


@dataclass(frozen=True, kw_only=True)
class Home:
    """The scope of the particle prims."""

    root: Sdf.Path  # the root prim that counts as the asset: default prim of the output
    scope: Sdf.Path  # parent of Gaussians, Points and Materials
    inside: bool  # scope is a child of root; else a root prim next to it, which is a Gprim


@dataclass(frozen=True, kw_only=True)
class Clock:
    """The time codes of a bake and of its source.

    USD scales the time of a layer with another timeCodesPerSecond where it is referenced, so source
    time is ``time_code * source_rate / rate``.
    """

    rate: float  # time codes per second of the output layers
    source_rate: float  # of the source
    start: float  # time code of the first frame that is written
    end: float  # time code of the last
    step: float  # time codes per frame

    def source_time(self, time_code: float) -> Usd.TimeCode:
        """The source's time code at a time code of the bake."""
        return Usd.TimeCode(time_code * self.source_rate / self.rate)


def open_source(path: Path) -> Usd.Stage:
    """The source stage with its payloads loaded.

    Raises
    ------
    InputError : it cannot be opened, has 0 time codes per second, or is itself a bake.
    """
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
    except Tf.ErrorException as error:
        raise InputError(f"{path} cannot be opened as USD", "check it with usdcat") from error
    if not 0 < stage.GetTimeCodesPerSecond() < math.inf:
        raise InputError(
            f"{path}: timeCodesPerSecond is {stage.GetTimeCodesPerSecond():g}",
            "author a positive number, for example 24",
        )
    for prim in stage.GetPseudoRoot().GetAllChildren():
        if prim.GetVariantSets().HasVariantSet(VARIANT_SET):
            raise baked_already(path, str(prim.GetPath()))
    return stage


def clock(source: Usd.Stage, settings: Settings) -> Clock:
    """The time line of a bake with these settings over the source stage."""
    step = settings.time_codes_per_second / settings.fps
    return Clock(
        rate=settings.time_codes_per_second,
        source_rate=source.GetTimeCodesPerSecond(),
        start=settings.time_code(settings.first),
        end=settings.time_code(settings.frames - 1),
        step=step,
    )


def find_home(source: Usd.Stage, asset: Asset, choices: Choices | None = None) -> Home:
    """The scope of the particle prims: under the root prim, or next to one that is a Gprim.

    The root prim is the default prim, or else the first root prim that contains a surface and is
    placed on the stage.  Gprims may not nest, hence the sibling; a bake that writes no particles
    needs no scope.
    """
    roots = list(source.GetPseudoRoot().GetAllChildren())
    held = {Sdf.Path(surface.path).GetPrefixes()[0] for surface in asset.surfaces}
    defined = [p for p in roots if p.IsDefined() and not p.IsAbstract()]
    chosen = source.GetDefaultPrim()
    if not chosen or not chosen.GetPath().IsRootPrimPath():
        chosen = next((p for p in defined if p.GetPath() in held), next(iter(defined), None))
    if chosen is None:
        raise InputError(f"{asset.facts.path} has no defined root prim", "check it with usdcat")
    empty = choices is not None and not choices.particles
    inside = empty or not chosen.IsA(UsdGeom.Gprim)
    if inside:
        scope = _free(source, chosen.GetPath().AppendChild(SCOPE))
    else:
        scope = _free(source, Sdf.Path(f"/{chosen.GetName()}_{SCOPE}"))
    return Home(root=chosen.GetPath(), scope=scope, inside=inside)


def roots_of(asset: Asset, home: Home) -> tuple[Sdf.Path, ...]:
    """Root prims that a bake changes, in the source's order: the home's, and every surface's."""
    changed = {Sdf.Path(surface.path).GetPrefixes()[0] for surface in asset.surfaces}
    changed.add(home.root if home.inside else home.scope)
    order = [Sdf.Path(path) for path in asset.facts.root_prims]
    return (*(p for p in order if p in changed), *sorted(p for p in changed if p not in order))


def author_facts(
    layer: Sdf.Layer, facts: StageFacts, settings: Settings, source: Usd.Stage
) -> None:
    """Author units, axis and rates, none of which are inherited from a referenced layer."""
    root = layer.pseudoRoot
    root.SetInfo("upAxis", facts.up_axis)
    root.SetInfo("metersPerUnit", facts.units.meters_per_unit)
    if source.HasAuthoredMetadata("kilogramsPerUnit"):
        root.SetInfo("kilogramsPerUnit", facts.units.kilograms_per_unit)
    layer.timeCodesPerSecond = settings.time_codes_per_second
    layer.framesPerSecond = settings.fps


def new_layer(path: Path, source: Path) -> Sdf.Layer:
    """An empty layer at ``partial_path(path)``.

    Raises
    ------
    UsageError : ``path`` is the source itself, which is never overwritten.
    BakeError : the folder cannot be written.
    """
    if path.exists() and same_place(path, source):
        raise UsageError(f"{path} is the asset itself", "give the output another name with -o")
    partial = partial_path(path)
    try:
        return Sdf.Layer.CreateNew(str(partial.absolute()))
    except Tf.ErrorException as error:
        raise BakeError(
            f"{partial} cannot be created",
            f"check that {partial.absolute().parent} exists, is writable and has space left",
        ) from error


def save(layer: Sdf.Layer) -> None:
    """Write the layer's unsaved edits to its file; raises BakeError where that fails."""
    try:
        saved = layer.Save()
    except Tf.ErrorException as error:
        raise _unsaved(layer) from error
    if not saved:
        raise _unsaved(layer)


def freeze_at_last_sample(layer: Sdf.Layer) -> None:
    """Make the last time sample of every attribute its value at all times.

    Velocities and accelerations are blocked, so that none of the source is visible.
    """
    paths: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    with Sdf.ChangeBlock():
        for path in paths:
            times = layer.ListTimeSamplesForPath(path) if path.IsPropertyPath() else []
            if not times:
                continue
            spec = layer.GetAttributeAtPath(path)
            moves = path.name.split(":")[-1] in RATES
            spec.default = Sdf.ValueBlock() if moves else layer.QueryTimeSample(path, times[-1])
            spec.ClearInfo("timeSamples")
    layer.ClearStartTimeCode()
    layer.ClearEndTimeCode()


def freeze_source(
    layer: Sdf.Layer, source: Usd.Stage, roots: Sequence[Sdf.Path], time: Usd.TimeCode
) -> tuple[str, ...]:
    """Author the source's animated attributes at one time as constant values of ``layer``.

    Obstacles, lights and cameras then stay where they are with the rest pose.  Attributes that the
    layer has are unchanged.

    roots : root prims that the layer is composed with.
    Returns notes: what is frozen, and which animated prims under other roots, or inside instances,
    are not.
    """
    held, moving = set[Sdf.Path](), set[Sdf.Path]()
    for prim in source.Traverse(Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)):
        for attribute in prim.GetAuthoredAttributes():
            path = attribute.GetPath()
            if not attribute.ValueMightBeTimeVarying() or layer.GetAttributeAtPath(path):
                continue
            if prim.IsInstanceProxy() or path.GetPrefixes()[0] not in roots:
                moving.add(prim.GetPath())
                continue
            spec = Sdf.AttributeSpec(
                Sdf.CreatePrimInLayer(layer, prim.GetPath()), attribute.GetName(),
                attribute.GetTypeName(), Sdf.VariabilityVarying, attribute.IsCustom(),
            )  # fmt: skip
            value = attribute.Get(time)
            spec.default = Sdf.ValueBlock() if value is None else value
            held.add(prim.GetPath())
    notes = [
        f"<{path}> is animated and is kept in its pose at the time everything is at rest"
        for path in held
    ]
    notes += [
        f"<{path}> is animated by its source and keeps moving while the baked prims are at rest"
        for path in moving
    ]
    return tuple(sorted(notes))


def refresh(path: Path) -> None:
    """Reload a layer that this process has open from the file that now has its name."""
    layer = Sdf.Layer.Find(str(path.absolute()))
    if layer:
        layer.Reload(force=True)


def to_metadata(value: Any) -> Any:
    """A Python value as layer metadata: mappings become dictionaries, numbers vectors.

    Raises TypeError for unsupported types.
    """
    if isinstance(value, Mapping):
        return {str(k): to_metadata(v) for k, v in value.items() if v is not None}
    if isinstance(value, (bool, int, float, str)):
        return value
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        return value.item()
    items = list(value)
    if all(isinstance(item, str) for item in items):
        return Vt.StringArray(items)
    if len(items) == 3:
        return Gf.Vec3d(*(float(item) for item in items))
    return Vt.DoubleArray([float(item) for item in items])


def _free(source: Usd.Stage, path: Sdf.Path) -> Sdf.Path:
    parent = path.GetParentPath()
    return parent.AppendChild(
        free_name(path.name, lambda name: bool(source.GetPrimAtPath(parent.AppendChild(name))))
    )


def _unsaved(layer: Sdf.Layer) -> BakeError:
    return BakeError(
        f"{layer.realPath} could not be saved", "check the space left on the disk and its quota"
    )


def require_prim(stage: Usd.Stage, source: Path, path: str) -> Usd.Prim:
    """The prim at a path of the source; BakeError where it no longer exists."""
    prim = stage.GetPrimAtPath(path)
    if not prim:
        raise BakeError(
            f"{source}: the prim <{path}> does not exist",
            "the file changed since it was read: run the bake again",
        )
    return prim


def f32(values: Floats) -> np.ndarray:
    """Single precision, contiguous as USD requires."""
    return np.ascontiguousarray(values, np.float32)


def vectors(values: Floats) -> Vt.Vec3fArray:
    """Rows (n, 3) as vectors of single precision."""
    return Vt.Vec3fArray.FromNumpy(f32(values))


def quaternions(wxyz: Floats) -> Vt.QuatfArray:
    """(N, 4) quaternions (w, x, y, z) in single precision."""
    return Vt.QuatfArray.FromNumpy(f32(xyzw(wxyz)))


def xyzw(wxyz: Floats) -> np.ndarray:
    """Quaternions in the order in which USD's FromNumpy reads them."""
    return np.asarray(wxyz)[:, [1, 2, 3, 0]]


POSE = "bind"  # instance of the API


def author_bind_pose(prim: Usd.Prim, points: np.ndarray) -> None:
    """Author the bind pose of meshes of a deformable body, by the AOUSD proposal (OpenUSD-proposals
    111).

    points : (V, 3) single precision, in the prim's own space.
    """
    prim.AddAppliedSchema(f"PhysicsDeformablePoseAPI:{POSE}")
    name, types = f"physics:deformablePose:{POSE}", Sdf.ValueTypeNames
    uniform = Sdf.VariabilityUniform
    purposes = prim.CreateAttribute(f"{name}:purposes", types.TokenArray, False, uniform)
    purposes.Set(["bindPose"])
    made = prim.CreateAttribute(f"{name}:points", types.Point3fArray, False)
    made.Set(Vt.Vec3fArray.FromNumpy(points))


def box(low: Floats, high: Floats) -> Vt.Vec3fArray:
    """The extent with the corners `low` and `high` (3,)."""
    return Vt.Vec3fArray.FromNumpy(f32(np.stack([low, high])))


def visibility(prim: Usd.Prim) -> Usd.Attribute:
    """The visibility attribute of a prim, with a spec in the edit target's layer."""
    return prim.CreateAttribute("visibility", Sdf.ValueTypeNames.Token, False)


def show(prim: Usd.Prim, shown: bool, time_code: float) -> None:
    """Author the visibility of a prim at a time code."""
    tokens = UsdGeom.Tokens
    visibility(prim).Set(tokens.inherited if shown else tokens.invisible, time_code)

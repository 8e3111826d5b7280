"""Reading of a USD file (usda, usdc, usd, usdz) as an `Asset`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom

from gf_usd.core import USD_SUFFIXES
from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, Splats, StageFacts, Surface, bake_original, first_time_code
from gf_usd.core.errors import InputError, counted, listed_paths
from gf_usd.readers.notes import ANIMATED, POSED, Notes
from gf_usd.readers.usd.mesh import Reading, read_faces, read_surface, with_limit, world_box
from gf_usd.readers.usd.select import (
    INVISIBLE,
    OF_BAKE,
    PROXIES,
    PURPOSE,
    REPEATED,
    Selection,
    instances_above,
    select,
    shapes_outside,
    shapes_under,
)
from gf_usd.readers.usd.shading import ShadingReader
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.splats import is_captured, read_captured
from gf_usd.readers.usd.stage import (
    SkippedPrim,
    baked_asset,
    open_stage,
    reading,
    require_saved,
    stage_facts,
)
from gf_usd.readers.usd.variants import note_other_variants
from gf_usd.readers.usd_physics.attributes import body_of, is_collider, stands

CACHE = ".cache."  # before the suffix in the names of caches of bakes
MOST_NAMED = 3  # prims that a note lists
INSTANCE = "is an instance: it becomes an ordinary prim in the bake because its content moves"


def read_usd(
    path: Path,
    *,
    prims: Sequence[str] = (),
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
    time_code: float | None = None,
    bind_pose: bool = False,
    named: Path | None = None,
) -> Asset:
    """The visible meshes, implicit shapes and Gaussian splats of a stage, posed at one time.

    The arguments are those of `gf_usd.readers.read_asset`.

    named : the user's file, for messages, where `path` was converted from it.

    Raises InputError for a file that is not USD or damaged, for invalid meshes, and where there is
    no prim that can be simulated.
    """
    with reading(path):
        stage = open_stage(path)
        path = named or path
        require_saved(path, stage)
        notes = Notes()
        facts = stage_facts(stage, path, notes, meters_per_unit=meters_per_unit, up_axis=up_axis)
        time = Usd.TimeCode(first_time_code(facts, time_code))
        found = select(stage, path, prims, time)
        surfaces, splats, skipped = _surfaces(path, found, facts, time, notes, bind_pose, prims)
        if not surfaces and not splats:
            facts.require_not_baked()  # the bake of what flows hides its meshes
            raise _no_geometry(stage, path, found, skipped, notes, by_name=bool(prims))
        _note_passed_through(stage, found, time, notes)
        filled = {surface.path for surface in surfaces}
        baked = [
            prim
            for prim in found.geometry
            if prim.IsA(UsdGeom.Mesh)
            and str(prim.GetPath()) in filled
            and not stands(prim, time, prims)
        ]
        note_other_variants(stage, found, baked, time, notes, prims)
        return Asset(
            facts=replace(facts, notes=notes.lines()),
            surfaces=tuple(surfaces),
            splats=tuple(splats),
            skipped=tuple(skipped.items()),
        )


BORDER_MARGIN = 1e-4  # of the diagonal of a border's box, as points of two meshes differ slightly


def read_around(
    file: Path, facts: StageFacts, paths: Sequence[str], *, rest: float | None
) -> tuple[Surface, ...]:
    """The meshes at prim paths and those of the stage around them, without their appearance.

    A mesh is around others where a point of its open border is in the box of the open border of one
    of them, or of one that is around them itself.  Meshes whose boxes touch none of these boxes are
    neither triangulated nor checked, and invalid ones are left out.  In stage order.

    file : the USD form of the asset; rest : time code of the rest pose, None: the asset's own.
    """
    with reading(file):
        stage, notes = open_stage(file), Notes()
        time = Usd.TimeCode(first_time_code(facts, rest))
        context = _context(facts.path, facts, time, notes, bind_pose=False)
        boxes: dict[str, tuple[Usd.Prim, Floats]] = {}
        borders: list[Floats] = []
        for prim in shapes_under(stage, [Sdf.Path.absoluteRootPath], time):
            if prim.IsA(UsdGeom.Mesh):
                with suppress(InputError, SkippedPrim):
                    boxes[str(prim.GetPath())] = prim, world_box(prim, context)
        found: dict[str, tuple[Surface, Floats]] = {}  # and the (n, 3) points of its open border
        taken: set[str] = set()
        left = {path for path in paths if path in boxes}
        while left:
            for path in left - found.keys():
                with suppress(InputError, SkippedPrim):
                    one = read_faces(boxes[path][0], context)
                    found[path] = one, one.points[one.welded.boundary].reshape(-1, 3)
            # those that were not named have points of their border in another one's
            mine = left & found.keys()
            if taken:
                mine = {p for p in mine if any(_inside(found[p][1], b).any() for b in borders)}
            taken |= mine
            borders = [_grown_box(found[p][1]) for p in sorted(mine) if len(found[p][1])]
            left = {
                path
                for path, (_, (low, high)) in boxes.items()
                if path not in taken
                and any((low <= b[1]).all() and (high >= b[0]).all() for b in borders)
            }
        return tuple(found[path][0] for path in boxes if path in taken)


def _inside(points: Floats, box: Floats) -> NDArray[np.bool_]:
    """(n,) which points (n, 3) are in a box (2, 3)."""
    return ((points >= box[0]) & (points <= box[1])).all(1)


def _grown_box(points: Floats) -> Floats:
    """(2, 3) [m] the corners of the box around points, with BORDER_MARGIN."""
    low, high = points.min(0), points.max(0)
    margin = BORDER_MARGIN * float(np.linalg.norm(high - low))
    return np.array([low - margin, high + margin])


def _context(
    path: Path, facts: StageFacts, time: Usd.TimeCode, notes: Notes, *, bind_pose: bool
) -> Reading:
    """The context of reading prims; path : the file, for messages."""
    xforms = UsdGeom.XformCache(time)
    return Reading(
        path=path,
        time=time,
        meters_per_unit=facts.units.length,
        xforms=xforms,
        skins=Skins(time, xforms, notes, bind=bind_pose),
        shadings=ShadingReader(time, notes),
        notes=notes,
    )


def _surfaces(
    path: Path,
    found: Selection,
    facts: StageFacts,
    time: Usd.TimeCode,
    notes: Notes,
    bind_pose: bool,
    named: Sequence[str],
) -> tuple[list[Surface], list[Splats], dict[str, str]]:
    """The surfaces and Gaussians of the selection, and the reasons for skipped prims by path."""
    context = _context(path, facts, time, notes, bind_pose=bind_pose)
    xforms = context.xforms
    surfaces: list[Surface] = []
    splats: list[Splats] = []
    skipped = dict(found.skipped)
    for prim in found.geometry:
        try:
            if is_captured(prim):
                place = xforms.GetLocalToWorldTransform(prim)
                unit = facts.units.length
                splats.append(read_captured(prim, time, place, unit, notes))
            else:
                surfaces.append(with_limit(prim, read_surface(prim, context)))
        except SkippedPrim as reason:
            skipped[str(prim.GetPath())] = str(reason)
        else:
            if stands(prim, time, named):
                for text in (ANIMATED, POSED):
                    notes.drop(text, str(prim.GetPath()))
                continue
            for instance in instances_above(prim):
                notes.add(INSTANCE, str(instance.GetPath()))
    return surfaces, splats, skipped


def _note_passed_through(
    stage: Usd.Stage, found: Selection, time: Usd.TimeCode, notes: Notes
) -> None:
    """Add a note on shapes of the stage that are neither selected nor obstacles."""
    stands = {
        body.GetPath()
        for prim in Usd.PrimRange.Stage(stage, PROXIES)
        if is_collider(prim, time) and (body := body_of(prim, time))
    }
    loose = [
        str(prim.GetPath())
        for prim in shapes_outside(stage, found.roots, time)
        if not is_collider(prim, time)
        and not ((body := body_of(prim, time)) and body.GetPath() in stands)
    ]
    if not loose:
        return
    paths = listed_paths(loose, MOST_NAMED)
    one = len(loose) == 1
    notes.add(
        f"{counted(len(loose), 'shape')} of the stage, {paths}, {'is' if one else 'are'} neither"
        f" soft nor {'an obstacle' if one else 'obstacles'}: bodies pass through"
        f" {'it' if one else 'them'}; a PhysicsCollisionAPI makes a shape an obstacle, and --prim"
        " makes it soft"
    )


def _no_geometry(
    stage: Usd.Stage,
    path: Path,
    found: Selection,
    skipped: dict[str, str],
    notes: Notes,
    *,
    by_name: bool,
) -> InputError:
    """The error for a selection without surfaces, which lists the prims found instead."""
    under = ", ".join(f"<{root.GetPath()}>" for root in found.roots[:3]) or "its root"
    if missing := [line for line in notes.lines() if line.startswith("does not compose")]:
        return InputError(
            f"{path}: no mesh was found under {under}; {missing[0]}",
            "supply the missing files, or correct the paths in the asset",
        )
    if skipped:
        where, reason = next(iter(skipped.items()))
        more = f" and {len(skipped) - 1} more" if len(skipped) > 1 else ""
        return InputError(
            f"{path}: nothing under {under} can be made soft: <{where}> ({reason}){more}",
            _remedy(stage, where, reason, by_name),
        )
    there = ", ".join(f"{n} {name}" for name, n in found.types.most_common(5)) or "nothing"
    elsewhere = [] if by_name else _meshes_elsewhere(stage)
    hint = "give an asset that contains a mesh"
    if elsewhere:
        hint = f"there are meshes outside the default prim: --prim {elsewhere[0]}"
    elif unselected := _unselected_variants(found.roots):
        hint = unselected
    elif inactive := _inactive(found.roots):
        hint = f"<{inactive}> is inactive: activate it in the file if it is meant"
    return InputError(f"{path}: no mesh was found under {under}, which contains {there}", hint)


def _remedy(stage: Usd.Stage, where: str, reason: str, by_name: bool) -> str:
    """A hint at how the skipped prim at a path can be simulated."""
    if reason.endswith(OF_BAKE):
        return bake_original(_asset_of_cache(stage.GetRootLayer()))
    if reason == INVISIBLE:
        return f"make <{where}> visible in the file: what is hidden is not baked"
    if reason.startswith(INVISIBLE):
        return f"start the bake where <{where}> is visible: --start {reason.split()[-1]}"
    if reason.startswith(PURPOSE):
        return f"set the purpose of <{where}> to default or render in the file"
    if reason.endswith(REPEATED):
        own = _own_file(stage, where)
        what = f"the prototype's own file, {own}" if own else "a file with the prototype alone"
        return f"bake {what}; the prototype may reference the result"
    mesh = "give the asset a visible mesh"
    return mesh if by_name else f"{mesh}, or name other prims with --prim"


def _asset_of_cache(cache: Sdf.Layer) -> str:
    """The asset of the bake whose cache a layer is, by the root layer next to it; "": not known."""
    path = Path(cache.realPath)
    name, is_cache, _ = path.name.rpartition(CACHE)
    for suffix in USD_SUFFIXES if is_cache else ():
        root = path.with_name(f"{name}{suffix}")
        layer = Sdf.Layer.FindOrOpen(str(root)) if root.is_file() else None
        if layer and (asset := baked_asset(layer)):
            return asset
    return ""


def _own_file(stage: Usd.Stage, where: str) -> str:
    """Name of the file of a prototype, or of a PointInstancer's first one; "": the asset's own."""
    prim = stage.GetPrimAtPath(where)
    if instancer := UsdGeom.PointInstancer(prim):
        prims = map(stage.GetPrimAtPath, instancer.GetPrototypesRel().GetForwardedTargets())
        prim = next((one for one in prims if one), prim)
    layers = [spec.layer for spec in prim.GetPrimStack()]
    others = [layer for layer in layers if layer not in stage.GetLayerStack()]
    return Path(others[0].realPath).name if others else ""


def _unselected_variants(roots: Sequence[Usd.Prim]) -> str:
    """A hint at the first variant set without a selection: its variants may hold the meshes."""
    for prim in (p for root in roots for p in Usd.PrimRange(root)):
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            one = sets.GetVariantSet(name)
            if (variants := one.GetVariantNames()) and one.GetVariantSelection() not in variants:
                return (
                    f"<{prim.GetPath()}> has a variant set {name!r} without a selection: select one"
                    f" of {', '.join(variants)} in the file"
                )
    return ""


def _inactive(roots: Sequence[Usd.Prim]) -> Sdf.Path | None:
    """The first inactive prim that may be, or hold, a mesh; None: there is none."""
    for prim in (p for root in roots for p in Usd.PrimRange(root, Usd.PrimAllPrimsPredicate)):
        groups = prim.GetTypeName() in ("", "Xform", "Scope")
        if not prim.IsActive() and (groups or prim.IsA(UsdGeom.Gprim)):
            return prim.GetPath()
    return None


def _meshes_elsewhere(stage: Usd.Stage) -> list[str]:
    every = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    return [str(prim.GetPath()) for prim in every if prim.IsA(UsdGeom.Mesh)]

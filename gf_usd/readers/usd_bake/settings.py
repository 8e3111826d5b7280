"""Bake settings authored in a stage.

read_bake_settings   GaussianFleshBakeAPI attributes of prims
read_subjects        bound materials and UsdSemantics labels, for advice on materials
read_painted         material values painted as primvars of the namespace gaussianFlesh
read_goals           goal weights painted as primvar gaussianFlesh:goal
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from pxr import Usd, UsdGeom, UsdSemantics, UsdShade

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import StageFacts, Surface, first_time_code
from gf_usd.core.errors import InputError
from gf_usd.core.materials.laws import law_parameters
from gf_usd.core.materials.presets import presets
from gf_usd.core.stage import PrimBake, Subject
from gf_usd.readers.usd.select import named_prim
from gf_usd.readers.usd.stage import open_stage, reading, upwards
from gf_usd.readers.usd_physics.attributes import count, flag, number, role, word

T = TypeVar("T")

ENABLED, MATERIAL = "gaussianFlesh:enabled", "gaussianFlesh:material"
SPACING, PARTICLES = "gaussianFlesh:spacing", "gaussianFlesh:particles"
SEED, SOLVER = "gaussianFlesh:seed", "gaussianFlesh:solver"
SOLVERS = {"totalLagrangian": "tl", "updatedLagrangian": "ul"}


def read_bake_settings(
    file: Path, facts: StageFacts, prims: Sequence[str], *, rest: float | None = None
) -> tuple[PrimBake, ...]:
    """The settings of each of the prims, in order.

    Attributes are inherited from the nearest ancestor that authors them.  They are used without
    the API schema being applied, too, since programs without the schema cannot apply it.

    file : the USD file; facts.path is its name in messages.  rest : time code of the rest pose.

    Raises InputError for a path without a prim, and for invalid values.
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
        # An empty name blocks that of an ancestor: the bound physics material is used.
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
    """Spacing [stage units], or number of particles with the path of its prim.

    Inherited from the nearest ancestor with either; of two on one prim, the spacing is used.  0
    blocks the value of an ancestor.
    """
    spacing_open = particles_open = True
    for above in upwards(prim):
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
    """The first result of `read` that is not None, from the prim upward."""
    return next((value for one in upwards(prim) if (value := read(one)) is not None), None)


PURPOSES = (UsdShade.Tokens.preview, UsdShade.Tokens.full, "physics")


def read_subjects(
    file: Path, facts: StageFacts, prims: Sequence[str], *, rest: float | None = None
) -> tuple[Subject, ...]:
    """Names of each of the prims, of its bound materials and its semantic labels, in order.

    file : the USD file; facts.path is its name in messages.  rest : time code of the rest pose.

    Raises InputError for a path without a prim.
    """
    with reading(file):
        stage = open_stage(file)
        time = Usd.TimeCode(first_time_code(facts, rest))
        return tuple(_subject(named_prim(stage, facts.path, path), time) for path in prims)


def _subject(prim: Usd.Prim, time: Usd.TimeCode) -> Subject:
    above = [label for one in upwards(prim.GetParent()) for label in _labels(one, time)]
    return Subject(
        path=str(prim.GetPath()),
        looks=_bound_materials(prim, time),
        labels=_labels(prim, time),
        labels_above=tuple(dict.fromkeys(above)),
    )


def _bound_materials(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[str, ...]:
    """Paths of the materials bound to the prim and its subsets, by descending number of faces."""
    faces: dict[str, int] = {}
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        count = len(subset.GetIndicesAttr().Get(time) or [])
        for path in _bound(subset.GetPrim()):
            faces[path] = faces.get(path, 0) + count
    mesh = UsdGeom.Mesh(prim)
    total = len(mesh.GetFaceVertexCountsAttr().Get(time) or []) if mesh else 0
    left = total - sum(faces.values())
    for path in _bound(prim):
        faces[path] = faces.get(path, 0) + left
    return tuple(sorted(faces, key=lambda path: -faces[path]))


def _bound(prim: Usd.Prim) -> tuple[str, ...]:
    api = UsdShade.MaterialBindingAPI(prim)
    found = (api.ComputeBoundMaterial(purpose)[0] for purpose in PURPOSES)
    return tuple(dict.fromkeys(str(one.GetPath()) for one in found if one))


def _labels(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[str, ...]:
    """The semantic labels applied to a prim, in order of their taxonomies."""
    out: list[str] = []
    for taxonomy in UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
        labels = UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr()
        out += [str(label) for label in (labels.Get(time) if labels else None) or []]
    return tuple(dict.fromkeys(out))


YOUNG, NU, DENSITY = (
    f"gaussianFlesh:{name}" for name in ("youngsModulus", "poissonsRatio", "density")
)
# primvar -> (field, least and greatest value)
KNOWN = {
    YOUNG: ("youngs_modulus", 0.0, np.inf),
    NU: ("poissons_ratio", -1.0, 0.5),
    DENSITY: ("density", 0.0, np.inf),
}


def read_painted(
    file: Path, facts: StageFacts, surfaces: Sequence[Surface], *, rest: float | None = None
) -> dict[str, dict[str, Floats]]:
    """Painted material values (C,) at face corners, by prim path and field.

    Fields are youngs_modulus [Pa], density [kg/m^3], law parameters and others; corners are in the
    order of Surface.face_indices.  Constant primvars are inherited, as in USD.

    rest : time code of the rest pose.

    Raises InputError for values that are not finite or out of range, and for a wrong number of
    values.
    """
    scales = {YOUNG: facts.units.pressure, NU: 1.0, DENSITY: facts.units.density}
    known = dict(KNOWN)
    for p in law_parameters():
        name, factor = f"gaussianFlesh:{p.attribute}", facts.units.factor(p.unit)
        known[name] = (p.name, np.nextafter(p.low / factor, -np.inf), p.high / factor)
        scales[name] = factor
    out: dict[str, dict[str, Floats]] = {}
    with reading(file):
        stage = open_stage(file)
        time = Usd.TimeCode(first_time_code(facts, rest))
        for surface in surfaces:
            api = UsdGeom.PrimvarsAPI(named_prim(stage, facts.path, surface.path))
            for name, (field, least, most) in known.items():
                primvar = api.FindPrimvarWithInheritance(name)
                if not (primvar and primvar.HasValue()):
                    continue
                where = f"{facts.path}: <{surface.path}>: {primvar.GetAttr().GetName()}"
                values = _numbers(primvar, time, where)
                _require_within(values, least, most, where)
                corners = _at_corners(values, str(primvar.GetInterpolation()), surface, where)
                out.setdefault(surface.path, {})[field] = corners * scales[name]
    return out


GOAL = "gaussianFlesh:goal"


def read_goals(
    file: Path, facts: StageFacts, surfaces: Sequence[Surface], *, rest: float | None = None
) -> dict[str, Floats]:
    """Painted goal weights (C,) in 0..1 at face corners, by prim path, as `read_painted`.

    A constant primvar of a face GeomSubset takes precedence over the mesh's.  Faces without a value
    are NaN.
    """
    out = {}
    with reading(file):
        stage = open_stage(file)
        time = Usd.TimeCode(first_time_code(facts, rest))
        for surface in surfaces:
            prim = named_prim(stage, facts.path, surface.path)
            primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(GOAL)
            if primvar and primvar.HasValue():
                values, where = _goals(primvar, time, facts, surface.path)
                kind = str(primvar.GetInterpolation())
                out[surface.path] = _at_corners(values, kind, surface, where)
            for faces, goal in _goals_of_subsets(prim, time, facts, surface):
                mine = np.repeat(np.isin(np.arange(len(surface.face_counts)), faces),
                                 surface.face_counts)  # fmt: skip
                before = out.get(surface.path, np.full(len(mine), np.nan))
                out[surface.path] = np.where(mine, goal, before)
    return out


def goals_vary(file: Path, facts: StageFacts, surfaces: Sequence[Surface]) -> bool:
    """Whether any goal that `read_goals` reads has time samples."""
    with reading(file):
        stage = open_stage(file)
        for surface in surfaces:
            prim = named_prim(stage, facts.path, surface.path)
            found = [UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(GOAL)]
            for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
                found.append(UsdGeom.PrimvarsAPI(subset.GetPrim()).GetPrimvar(GOAL))
            if any(one and one.ValueMightBeTimeVarying() for one in found):
                return True
    return False


def _goals(
    primvar: UsdGeom.Primvar, time: Usd.TimeCode, facts: StageFacts, path: str
) -> tuple[Floats, str]:
    """The values of a goal primvar, and its name for messages; InputError for invalid values."""
    where = f"{facts.path}: <{path}>: {primvar.GetAttr().GetName()}"
    values = _numbers(primvar, time, where)
    bad = ~((values >= 0.0) & (values <= 1.0))  # NaN compares false
    if bad.any():
        raise InputError(
            f"{where} has {int(bad.sum())} of {len(values)} values out of range; the first is"
            f" {float(values[bad][0]):g}",
            "paint 0 (free) to 1 (keyframed)",
        )
    return values, where


def _goals_of_subsets(
    prim: Usd.Prim, time: Usd.TimeCode, facts: StageFacts, surface: Surface
) -> Iterator[tuple[Floats, float]]:
    """The faces and the goal weight of each face subset of a prim with a goal primvar."""
    for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim)):
        primvar = UsdGeom.PrimvarsAPI(subset.GetPrim()).GetPrimvar(GOAL)
        if not (primvar and primvar.HasValue()):
            continue
        path, count = str(subset.GetPath()), len(surface.face_counts)
        values, where = _goals(primvar, time, facts, path)
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face or len(values) != 1:
            raise InputError(
                f"{where} has {len(values)} values on a subset of"
                f" {subset.GetElementTypeAttr().Get()}s",
                "author one constant number on a subset of faces, or paint the mesh for varying "
                "values",
            )
        faces = np.asarray(subset.GetIndicesAttr().Get(time) or [], np.int64)
        if len(faces) and (faces.min() < 0 or faces.max() >= count):
            raise InputError(
                f"{facts.path}: <{path}>: its indices range from {faces.min()} to "
                f"{faces.max()}, but the mesh has {count} faces",
                "repair the subset in the program that made it",
            )
        yield faces, float(values[0])


def _numbers(primvar: UsdGeom.Primvar, time: Usd.TimeCode, where: str) -> Floats:
    """(n,) flattened values of a primvar."""
    flat = primvar.ComputeFlattened(time)
    if flat is None:
        raise InputError(
            f"{where} has indices that do not refer to any of its values",
            "author the primvar again, without indices",
        )
    values = np.atleast_1d(np.asarray(flat))
    if values.ndim != 1 or not np.issubdtype(values.dtype, np.number):
        raise InputError(
            f"{where} is of type {primvar.GetTypeName()}", "author it as float or float[]"
        )
    return values.astype(np.float64)


def _require_within(values: Floats, least: float, most: float, where: str) -> None:
    # comparisons with NaN are false, so that it counts as out of range
    bad = ~((values > least) & (values < most))
    if bad.any():
        first = float(values[np.flatnonzero(bad)[0]])
        limits = f"between {least:g} and {most:g}" if np.isfinite(most) else f"above {least:g}"
        raise InputError(
            f"{where} has {int(bad.sum())} of {len(values)} values out of range; the first is"
            f" {first:g}",
            f"paint finite values {limits}, in units of the stage",
        )


def _at_corners(values: Floats, interpolation: str, surface: Surface, where: str) -> Floats:
    """(C,) values at face corners, from values (n,) of an interpolation."""
    corners = np.asarray(surface.face_indices)
    faces = np.repeat(np.arange(len(surface.face_counts)), surface.face_counts)
    rows = {
        "constant": (1, np.zeros_like(corners)),
        "uniform": (len(surface.face_counts), faces),
        "varying": (len(surface.points), corners),
        "vertex": (len(surface.points), corners),
        "faceVarying": (len(corners), np.arange(len(corners))),
    }
    count, index = rows[interpolation]
    if len(values) != count:
        raise InputError(
            f"{where} has {len(values)} values, but '{interpolation}' interpolation needs {count}",
            "paint the mesh again, or correct the interpolation",
        )
    return values[index]

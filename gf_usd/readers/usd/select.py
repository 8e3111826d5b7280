"""Selection of the prims to make soft, and the reasons for leaving out the others.

Instances that a bake would free, and whether they can be.

Opinions on what is inside of an instance are ignored by USD as long as it is one.  In a bake an
instance with a baked mesh is an ordinary prim, on which such opinions would take effect: another
transform, say, under points that were written for the one before.
"""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Pcp, Sdf, Usd, UsdGeom

from gf_usd.core.errors import InputError
from gf_usd.readers.usd.mesh import has_surface
from gf_usd.readers.usd.solids.points import is_body
from gf_usd.readers.usd.stage import SPLAT_TYPE, is_running

# Prims of an instance are read in place, as if it were not one.
PROXIES = Usd.TraverseInstanceProxies()
BAKED_PURPOSES = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
# Why a prim is left out: the whole reason, how it begins, and how two end.
INVISIBLE, PURPOSE, REPEATED = "invisible", "purpose ", ": its instances are not made soft"
PROXY = f"{PURPOSE}proxy"
KINDS = ": only meshes, solid shapes, points and splats are made soft"


@dataclass(frozen=True, kw_only=True)
class Selection:
    """The prims under a set of roots, sorted by what happens to them."""

    roots: tuple[Usd.Prim, ...]
    geometry: tuple[Usd.Prim, ...]  # what has or gets a surface, and captured Gaussians, in order
    skipped: tuple[tuple[str, str], ...]  # (prim path, reason)
    types: Counter[str]  # how often each prim type occurs, for words about an empty stage


def select(stage: Usd.Stage, path: Path, prims: Sequence[str], time: Usd.TimeCode) -> Selection:
    """The visible geometry of purpose default or render under `prims`.

    No prims: under the default prim, or where there is none under every root prim.  Raises
    InputError for a prim path that does not exist.
    """
    if prims:
        roots = [
            named_prim(stage, path, name, among=lambda: bakeable(stage, time)) for name in prims
        ]
    elif default := stage.GetDefaultPrim():
        roots = [default]
    else:
        roots = list(stage.GetPseudoRoot().GetChildren())
    geometry: dict[Sdf.Path, Usd.Prim] = {}
    repeated = _prototypes(stage)
    skipped: dict[str, str] = {}
    types: Counter[str] = Counter()
    for root in roots:
        walk = iter(Usd.PrimRange(root, PROXIES))
        for prim in walk:
            types[str(prim.GetTypeName()) or "untyped prim"] += 1
            if _is_hidden(prim, time):
                skipped[str(prim.GetPath())] = INVISIBLE
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.PointInstancer):
                skipped[str(prim.GetPath())] = f"PointInstancer{REPEATED}"
                walk.PruneChildren()
            elif instancer := repeated.get(prim.GetPath()):
                why = f"prototype of <{instancer}>{REPEATED}"
                skipped[str(prim.GetPath())] = why
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.Gprim):
                reason = _why_not(prim, time)
                if reason:
                    skipped[str(prim.GetPath())] = reason
                else:
                    geometry[prim.GetPath()] = prim
    for where, why in not_to_be_freed(stage, geometry.values()).items():
        skipped[str(where)] = why
        del geometry[where]
    for where, prim in list(geometry.items()):
        if model := _model(prim, geometry):
            skipped[str(where)] = f"inherits from <{model}>, which is baked, and follows it"
            del geometry[where]
    return Selection(
        roots=tuple(roots),
        geometry=tuple(geometry.values()),
        skipped=tuple(skipped.items()),
        types=types,
    )


def _model(prim: Usd.Prim, geometry: Mapping[Sdf.Path, Usd.Prim]) -> Sdf.Path | None:
    """The baked prim that this one inherits from: its motion is this one's, whatever is said."""
    if len(geometry) == 1:
        return None
    for arc in Usd.PrimCompositionQuery(prim).GetCompositionArcs():
        target = arc.GetTargetNode().path
        if arc.GetArcType() == Pcp.ArcTypeInherit and target in geometry:
            return target
    return None


def bakeable(stage: Usd.Stage, time: Usd.TimeCode) -> set[Sdf.Path]:
    """Paths of the prims that can be asked for: what `select` finds everywhere, and those above."""
    everywhere = select(stage, Path(), ["/"], time).geometry
    return {path for prim in everywhere for path in prim.GetPath().GetPrefixes()}


def _prototypes(stage: Usd.Stage) -> dict[Sdf.Path, Sdf.Path]:
    """What PointInstancers repeat, and which one does: moved, it would move every copy."""
    found: dict[Sdf.Path, Sdf.Path] = {}
    for prim in Usd.PrimRange.Stage(stage, PROXIES):
        if prim.IsA(UsdGeom.PointInstancer):
            for path in UsdGeom.PointInstancer(prim).GetPrototypesRel().GetForwardedTargets():
                found.setdefault(path, prim.GetPath())
    return found


def _is_hidden(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    imageable = UsdGeom.Imageable(prim)
    return bool(imageable) and imageable.ComputeVisibility(time) == UsdGeom.Tokens.invisible


def _why_not(prim: Usd.Prim, time: Usd.TimeCode) -> str:
    """Words for a visible gprim that is not made soft; empty for one that is."""
    name = str(prim.GetTypeName())
    if is_running(prim):
        what = "Gaussians" if name == SPLAT_TYPE else "points"
        return f"these {what} are the particles of a bake"
    if prim.IsA(UsdGeom.Points):
        if not is_body(prim, time):
            return "Points without widths and without physics are not a body"
    elif not (has_surface(prim) or name == SPLAT_TYPE):
        return f"{name}{KINDS}"
    purpose = UsdGeom.Imageable(prim).ComputePurpose()
    return "" if purpose in BAKED_PURPOSES else f"{PURPOSE}{purpose}"


def named_prim(
    stage: Usd.Stage,
    path: Path,
    name: str,
    *,
    among: Callable[[], Collection[Sdf.Path]] | None = None,
) -> Usd.Prim:
    """The prim that a user named; InputError with the nearest names where there is none.

    among : the paths that make sense there; None: all do.
    """
    if Sdf.Path.IsValidPathString(name) and (wanted := Sdf.Path(name)).IsAbsolutePath():
        if wanted == Sdf.Path.absoluteRootPath:
            return stage.GetPseudoRoot()
        prim = stage.GetPrimAtPath(wanted) if wanted.IsPrimPath() else None
        if prim and prim.IsActive() and prim.IsDefined():
            return prim
        if prim:
            raise InputError(
                f"{path}: the prim {name} is {'not defined' if prim.IsActive() else 'inactive'}",
                "activate it in the file, or name another prim",
            )
    else:
        wanted = None
    known = None if among is None else among()

    def sensible(prims: Iterable[Usd.Prim]) -> list[str]:
        return [str(p.GetPath()) for p in prims if known is None or p.GetPath() in known]

    every = sensible(Usd.PrimRange.Stage(stage, PROXIES))
    leaf = name.rsplit("/", 1)[-1]
    close = [p for p in every if p.rsplit("/", 1)[-1] == leaf][:3]
    close += [p for p in difflib.get_close_matches(name, every, n=3) if p not in close]
    if close:
        hint = f"did you mean {' or '.join(close)}?"
    else:
        parent = _nearest(stage, wanted)
        while known is not None and parent.GetParent() and parent.GetPath() not in known:
            parent = parent.GetParent()
        names = ", ".join(sensible(parent.GetAllChildren())[:8])
        nothing = "nothing" if known is None else "nothing that can be baked"
        hint = f"{parent.GetPath()} exists and contains {names or nothing}"
    raise InputError(f"{path}: there is no prim {name}", hint)


def _nearest(stage: Usd.Stage, wanted: Sdf.Path | None) -> Usd.Prim:
    """The nearest existing ancestor."""
    while wanted and wanted != Sdf.Path.absoluteRootPath:
        wanted = wanted.GetParentPath()
        if prim := stage.GetPrimAtPath(wanted):
            return prim
    return stage.GetPseudoRoot()


EVERYTHING = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)


def instances_above(prim: Usd.Prim) -> list[Usd.Prim]:
    """The instances that make a prim a proxy, the innermost first."""
    found = []
    while prim.IsInstanceProxy():
        prim = prim.GetParent()
        if prim.IsInstance():
            found.append(prim)
    return found


def not_to_be_freed(stage: Usd.Stage, prims: Iterable[Usd.Prim]) -> dict[Sdf.Path, str]:
    """Paths of the prims whose instances hide opinions, with the reason in words."""
    above = {prim.GetPath(): instances_above(prim) for prim in prims if prim.IsInstanceProxy()}
    if not above:
        return {}
    session = Sdf.Layer.CreateAnonymous(".usda")
    for instances in above.values():
        for instance in instances:
            Sdf.CreatePrimInLayer(session, instance.GetPath()).SetInfo("instanceable", False)
    freed = Usd.Stage.Open(stage.GetRootLayer(), session, Usd.Stage.LoadAll)
    outermost = {instances[-1].GetPath() for instances in above.values()}
    hidden = {path: _first_hidden(stage, freed, path) for path in outermost}
    reasons = {}
    for path, instances in above.items():
        at = instances[-1].GetPath()
        if where := hidden[at]:
            reasons[path] = (
                f"the instance <{at}> hides opinions on <{where}>, which would take effect if "
                f"it were made an ordinary prim: delete them, or turn off instancing in the file"
            )
    return reasons


def _first_hidden(stage: Usd.Stage, freed: Usd.Stage, path: Sdf.Path) -> Sdf.Path | None:
    for prim in Usd.PrimRange(freed.GetPrimAtPath(path), EVERYTHING):
        theirs = stage.GetPrimAtPath(prim.GetPath())
        mine = list(_says(prim, freed.GetSessionLayer()))
        if not theirs or mine != list(_says(theirs, None)):
            return prim.GetPath()
    return None


def _says(prim: Usd.Prim, besides: Sdf.Layer | None) -> Iterator[Sdf.PrimSpec]:
    """The specs of a prim that say anything."""
    for spec in prim.GetPrimStack():
        empty = not spec.properties and spec.ListInfoKeys() == ["specifier"]
        if spec.layer != besides and not (empty and spec.specifier == Sdf.SpecifierOver):
            yield spec

"""Selection of the prims to simulate, with the reasons for skipping the others.

A bake overrides `instanceable` to false on instances that contain a baked mesh.  USD ignores
opinions on descendants of an instance; without instancing they take effect, and could for example
change a transform under baked points.  Such instances are skipped (`hidden_opinions`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Pcp, Sdf, Usd, UsdGeom

from gf_usd.core.errors import InputError, meant, similar
from gf_usd.readers.usd.mesh import has_surface
from gf_usd.readers.usd.solids.points import is_body
from gf_usd.readers.usd.stage import SPLAT_TYPE, is_bake_particles

# Prims of instances are read as instance proxies.
PROXIES = Usd.TraverseInstanceProxies()
BAKED_PURPOSES = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
# Reasons for skipping a prim: in full, by prefix, and by suffix.
INVISIBLE, PURPOSE, REPEATED = "invisible", "purpose ", ": its instances are not made soft"
OF_BAKE = " are the particles of a bake"
PROXY = f"{PURPOSE}proxy"
KINDS = ": only meshes, solid shapes, points and splats are made soft"


@dataclass(frozen=True, kw_only=True)
class Selection:
    """The selected and the skipped prims under a set of roots."""

    roots: tuple[Usd.Prim, ...]
    geometry: tuple[Usd.Prim, ...]  # prims with a surface, and captured Gaussians, in stage order
    skipped: tuple[tuple[str, str], ...]  # (prim path, reason)
    types: Counter[str]  # number of prims of each type, for messages


def select(stage: Usd.Stage, path: Path, prims: Sequence[str], time: Usd.TimeCode) -> Selection:
    """The visible geometry of purpose default or render under `prims`.

    prims : prim paths; (): the default prim, or all root prims where there is none.

    Raises InputError for a prim path that does not exist.
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
                skipped[str(prim.GetPath())] = _hidden_reason(prim, time)
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.PointInstancer):
                skipped[str(prim.GetPath())] = f"PointInstancer{REPEATED}"
                walk.PruneChildren()
            elif instancer := repeated.get(prim.GetPath()):
                why = f"prototype of <{instancer}>{REPEATED}"
                skipped[str(prim.GetPath())] = why
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.Gprim):
                reason = _skip_reason(prim, time)
                if reason:
                    skipped[str(prim.GetPath())] = reason
                else:
                    geometry[prim.GetPath()] = prim
    for where, why in hidden_opinions(stage, geometry.values()).items():
        skipped[str(where)] = why
        del geometry[where]
    for where, prim in list(geometry.items()):
        if len(geometry) > 1 and (base := inherited(prim, geometry)):
            skipped[str(where)] = f"inherits from <{base}>, which is baked, and follows it"
            del geometry[where]
    return Selection(
        roots=tuple(roots),
        geometry=tuple(geometry.values()),
        skipped=tuple(skipped.items()),
        types=types,
    )


def shapes_outside(
    stage: Usd.Stage, roots: Sequence[Usd.Prim], time: Usd.TimeCode
) -> list[Usd.Prim]:
    """The visible meshes and implicit shapes that are under none of the roots, in stage order."""
    inside = {root.GetPath() for root in roots}
    if Sdf.Path.absoluteRootPath in inside:
        return []
    found: list[Usd.Prim] = []
    repeated = _prototypes(stage)
    walk = iter(Usd.PrimRange.Stage(stage, PROXIES))
    for prim in walk:
        path = prim.GetPath()
        repeats = path in repeated or prim.IsA(UsdGeom.PointInstancer)
        if path in inside or repeats or _is_hidden(prim, time):
            walk.PruneChildren()
        elif prim.IsA(UsdGeom.Gprim) and has_surface(prim) and not _skip_reason(prim, time):
            found.append(prim)
    return found


def shapes_under(
    stage: Usd.Stage, roots: Iterable[Sdf.Path], time: Usd.TimeCode
) -> Iterator[Usd.Prim]:
    """The visible meshes and implicit shapes of purpose default or render under prim paths, of
    which there may be no prim.
    """
    repeated = _prototypes(stage)
    for root in filter(None, map(stage.GetPrimAtPath, roots)):
        walk = iter(Usd.PrimRange(root, PROXIES))
        for prim in walk:
            repeats = prim.GetPath() in repeated or prim.IsA(UsdGeom.PointInstancer)
            if repeats or _is_hidden(prim, time):
                walk.PruneChildren()
            elif prim.IsA(UsdGeom.Gprim) and has_surface(prim) and not _skip_reason(prim, time):
                yield prim


def inherited(prim: Usd.Prim, among: Container[Sdf.Path]) -> Sdf.Path | None:
    """The first prim of these paths from which this one inherits its values; None: from none."""
    for arc in Usd.PrimCompositionQuery(prim).GetCompositionArcs():
        target = arc.GetTargetNode().path
        if arc.GetArcType() == Pcp.ArcTypeInherit and target in among:
            return target
    return None


def bakeable(stage: Usd.Stage, time: Usd.TimeCode) -> set[Sdf.Path]:
    """Paths of all prims that `select` finds in the stage, and of their ancestors."""
    everywhere = select(stage, Path(), ["/"], time).geometry
    return {path for prim in everywhere for path in prim.GetPath().GetPrefixes()}


def _prototypes(stage: Usd.Stage) -> dict[Sdf.Path, Sdf.Path]:
    """The PointInstancer of each prototype: a moved prototype would move all its instances."""
    found: dict[Sdf.Path, Sdf.Path] = {}
    for prim in Usd.PrimRange.Stage(stage, PROXIES):
        if prim.IsA(UsdGeom.PointInstancer):
            for path in UsdGeom.PointInstancer(prim).GetPrototypesRel().GetForwardedTargets():
                found.setdefault(path, prim.GetPath())
    return found


def _is_hidden(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    imageable = UsdGeom.Imageable(prim)
    return bool(imageable) and imageable.ComputeVisibility(time) == UsdGeom.Tokens.invisible


def _hidden_reason(prim: Usd.Prim, time: Usd.TimeCode) -> str:
    """The reason for skipping an invisible prim, with the time code from which it is visible."""
    shown = visible_from(prim, time)
    now = 0.0 if time.IsDefault() else time.GetValue()
    return INVISIBLE if shown is None else f"{INVISIBLE} at {now:g}, visible from {shown:g}"


def visible_from(prim: Usd.Prim, time: Usd.TimeCode) -> float | None:
    """The first time code after `time` at which an invisible prim is visible; None: never."""
    if time.IsDefault():
        return None
    image = UsdGeom.Imageable(prim)
    for code in image.GetVisibilityAttr().GetTimeSamples():
        if code > time.GetValue() and not _is_hidden(prim, Usd.TimeCode(code)):
            return float(code)
    return None


def _skip_reason(prim: Usd.Prim, time: Usd.TimeCode) -> str:
    """The reason for skipping a visible gprim; "" for one that is selected."""
    name = str(prim.GetTypeName())
    if is_bake_particles(prim):
        what = "Gaussians" if name == SPLAT_TYPE else "points"
        return f"these {what}{OF_BAKE}"
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
    """The prim of a user's path; raises InputError, with similar paths, where there is none.

    among : gives the paths that are suggested; None: all.
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
    close += [p for p in similar(name, every, most=3) if p not in close]
    if close:
        hint = meant(close).strip()
    else:
        parent = _nearest(stage, wanted)
        while known is not None and parent.GetParent() and parent.GetPath() not in known:
            parent = parent.GetParent()
        names = ", ".join(sensible(parent.GetAllChildren())[:8])
        nothing = "nothing" if known is None else "nothing that can be baked"
        hint = f"{parent.GetPath()} exists and contains {names or nothing}"
    fault = f"there is no prim {name}" if name else "the path of a prim is empty"
    raise InputError(f"{path}: {fault}", hint)


def _nearest(stage: Usd.Stage, wanted: Sdf.Path | None) -> Usd.Prim:
    """The nearest existing ancestor."""
    while wanted and wanted != Sdf.Path.absoluteRootPath:
        wanted = wanted.GetParentPath()
        if prim := stage.GetPrimAtPath(wanted):
            return prim
    return stage.GetPseudoRoot()


EVERYTHING = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)


def instances_above(prim: Usd.Prim) -> list[Usd.Prim]:
    """The instances that an instance proxy is in, the innermost first."""
    found = []
    while prim.IsInstanceProxy():
        prim = prim.GetParent()
        if prim.IsInstance():
            found.append(prim)
    return found


def hidden_opinions(stage: Usd.Stage, prims: Iterable[Usd.Prim]) -> dict[Sdf.Path, str]:
    """By path, the reason for skipping prims of instances with ignored opinions on descendants."""
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
        mine = list(_authored_specs(prim, freed.GetSessionLayer()))
        if not theirs or mine != list(_authored_specs(theirs, None)):
            return prim.GetPath()
    return None


def _authored_specs(prim: Usd.Prim, besides: Sdf.Layer | None) -> Iterator[Sdf.PrimSpec]:
    """The specs of a prim with any opinions."""
    for spec in prim.GetPrimStack():
        empty = not spec.properties and spec.ListInfoKeys() == ["specifier"]
        if spec.layer != besides and not (empty and spec.specifier == Sdf.SpecifierOver):
            yield spec

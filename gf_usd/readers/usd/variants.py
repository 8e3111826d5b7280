"""Variants of a stage other than those selected: whether a bake fits their meshes, too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

from pxr import Sdf, Usd, UsdGeom

from gf_usd.core.errors import counted
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.select import Selection, instances_above, shapes_under
from gf_usd.readers.usd.stage import composition_errors
from gf_usd.readers.usd_physics.attributes import stands

MOST_VARIANTS = 16  # that are compared with those selected
FACES = ("faceVertexCounts", "faceVertexIndices")
# fields of a prim that can add other prims or take them away
COMPOSING = (
    "active", "references", "payload", "inheritPaths", "specializes", "variantSetNames",
    "variantSelection",
)  # fmt: skip


def note_other_variants(
    stage: Usd.Stage,
    found: Selection,
    baked: Sequence[Usd.Prim],
    time: Usd.TimeCode,
    notes: Notes,
    named: Sequence[str],
) -> None:
    """Add a note on each variant set with variants whose meshes the baked points do not fit.

    Levels of detail are such. At most MOST_VARIANTS variants are composed, and those of instances
    of one prototype once.
    """
    roots = [root.GetPath() for root in found.roots]
    above = dict.fromkeys(path for prim in baked for path in prim.GetPath().GetPrefixes())
    known: dict[tuple[Sdf.Path, str], _Variants] = {}
    left = MOST_VARIANTS
    before = cache(partial(composition_errors, stage))  # a walk over all prims
    for path in above:
        prim = stage.GetPrimAtPath(path)
        for name in prim.GetVariantSets().GetNames():
            key = (_shared_path(prim), name)
            if key not in known:
                others = _with_meshes(prim, name)
                within = [root for root in roots if root.HasPrefix(path)] or [path]
                below = [one for one in baked if one.GetPath().HasPrefix(path)]
                mine = _moving_meshes(stage, within, time, named) if others[:left] else set()
                unlike, broken = [], {}
                for variant in others[:left]:
                    other = _with_variant(stage, prim, name, variant, within)
                    errors = composition_errors(other)
                    fault = next((e for e in errors if e not in before()), "")
                    if fault:
                        broken[variant] = fault
                    elif (
                        _has_other_faces(below, other, time)
                        or _moving_meshes(other, within, time, named) - mine
                    ):
                        unlike.append(variant)
                known[key] = _Variants(unlike=unlike, broken=broken, uncompared=len(others[left:]))
                left -= len(others[:left])
            if known[key].any:
                notes.add(_variants_text(prim, name, known[key]), str(path))


@dataclass(frozen=True, kw_only=True)
class _Variants:
    """The other variants of a set that a note names."""

    unlike: Sequence[str]  # that the baked points do not fit
    broken: Mapping[str, str]  # the error of each that does not compose
    uncompared: int

    @property
    def any(self) -> bool:
        return bool(self.unlike or self.broken or self.uncompared)


def _shared_path(prim: Usd.Prim) -> Sdf.Path:
    """The path of a prim, or that in its prototype, which instances share."""
    if prim.IsInstance():
        return prim.GetPrototype().GetPath()
    return (prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath()


def _variants_text(prim: Usd.Prim, name: str, others: _Variants) -> str:
    """The note on variants that the baked points do not fit, and on those not compared."""
    unlike, uncompared = others.unlike, others.uncompared
    one = prim.GetVariantSets().GetVariantSet(name)
    chosen = one.GetVariantSelection()
    if chosen not in one.GetVariantNames():
        chosen = "no variant"
    text = f"of its variant set {name}, {chosen} is baked"
    if unlike:
        text += (
            f", and the motion does not fit {', '.join(unlike)}, with other meshes or faces: for"
            f" {'it' if len(unlike) == 1 else 'each'}, bake a layer that selects it"
        )
    for variant, error in others.broken.items():
        text += f"; {variant} does not compose and was not compared: {error}"
    if uncompared:
        text += (
            f"; {counted(uncompared, 'other variant')} {'was' if uncompared == 1 else 'were'} not"
            f" compared, and the motion may not fit {'it' if uncompared == 1 else 'them'}"
        )
    return text


def _with_meshes(prim: Usd.Prim, name: str) -> list[str]:
    """The variants of a set, besides that selected, which may have other meshes or faces."""
    chosen = prim.GetVariantSets().GetVariantSelection(name)
    sets = [spec.variantSets[name] for spec in prim.GetPrimStack() if name in spec.variantSets]
    return [
        variant
        for variant in prim.GetVariantSets().GetVariantSet(name).GetVariantNames()
        if variant != chosen
        and any(
            variant in one.variants and _may_change_meshes(one.variants[variant].primSpec)
            for one in sets
        )
    ]


def _may_change_meshes(spec: Sdf.PrimSpec) -> bool:
    """Whether the opinions of a spec, or one below it, can add, show or change a mesh."""
    return (
        spec.typeName == "Mesh"
        or (spec.specifier == Sdf.SpecifierDef and not spec.typeName)  # may define a mesh's over
        or any(spec.HasInfo(key) for key in COMPOSING)
        or any(name in spec.properties for name in (*FACES, "visibility", "purpose"))
        or any(_may_change_meshes(child) for child in spec.nameChildren)
    )


def _with_variant(
    stage: Usd.Stage, prim: Usd.Prim, name: str, variant: str, within: Sequence[Sdf.Path]
) -> Usd.Stage:
    """The prims `within` of the stage with a variant."""
    session = Sdf.Layer.CreateAnonymous(".usda")
    session.TransferContent(stage.GetSessionLayer())
    for instance in instances_above(prim):
        Sdf.CreatePrimInLayer(session, instance.GetPath()).SetInfo("instanceable", False)
    Sdf.CreatePrimInLayer(session, prim.GetPath()).variantSelections[name] = variant
    mask = Usd.StagePopulationMask(list(within))
    return Usd.Stage.OpenMasked(stage.GetRootLayer(), session, mask)


def _has_other_faces(baked: Sequence[Usd.Prim], other: Usd.Stage, time: Usd.TimeCode) -> bool:
    """Whether a baked mesh has other faces in another stage; one that is not there has not."""
    for prim in baked:
        twin = other.GetPrimAtPath(prim.GetPath())
        if not (twin and twin.IsA(UsdGeom.Mesh)):
            continue
        for name in FACES:
            if prim.GetAttribute(name).Get(time) != twin.GetAttribute(name).Get(time):
                return True
    return False


def _moving_meshes(
    stage: Usd.Stage, roots: Sequence[Sdf.Path], time: Usd.TimeCode, named: Sequence[str]
) -> set[Sdf.Path]:
    """Paths of the meshes under the roots that a bake of the stage would move."""
    return {
        prim.GetPath()
        for prim in shapes_under(stage, roots, time)
        if prim.IsA(UsdGeom.Mesh) and not stands(prim, time, named)
    }

"""Names and labels of prims that are to be soft: bound materials and UsdSemantics labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from pxr import Usd, UsdGeom, UsdSemantics, UsdShade

from gf_usd.advice import Subject
from gf_usd.assets.usd_select import named_prim
from gf_usd.assets.usd_stage import open_stage, reading
from gf_usd.model import StageFacts
from gf_usd.playback import first_time_code

PURPOSES = (UsdShade.Tokens.preview, UsdShade.Tokens.full, "physics")


def read_subjects(
    file: Path, facts: StageFacts, prims: Sequence[str], *, rest: float | None = None
) -> tuple[Subject, ...]:
    """What the stage calls each of the prims, in their order.

    file : the USD file; facts.path is what messages call it.  rest : time code of the rest pose.

    Raises InputError for a path that names no prim.
    """
    with reading(file):
        stage = open_stage(file)
        time = Usd.TimeCode(first_time_code(facts, rest))
        return tuple(_subject(named_prim(stage, facts.path, path), time) for path in prims)


def _subject(prim: Usd.Prim, time: Usd.TimeCode) -> Subject:
    above = [label for one in _above(prim) for label in _labels(one, time)]
    return Subject(
        path=str(prim.GetPath()),
        looks=_looks(prim, time),
        labels=_labels(prim, time),
        labels_above=tuple(dict.fromkeys(above)),
    )


def _looks(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[str, ...]:
    """Paths of the materials bound to the prim and its subsets, that of most faces first."""
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
    """Labels of all taxonomies that are applied to a prim, in the order of the taxonomies."""
    out: list[str] = []
    for taxonomy in UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
        labels = UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr()
        out += [str(label) for label in (labels.Get(time) if labels else None) or []]
    return tuple(dict.fromkeys(out))


def _above(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    prim = prim.GetParent()
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()

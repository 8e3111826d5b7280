"""GeomSubsets that have a physics material of their own inside one mesh."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom, UsdShade

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_physics_material import PhysicsMaterials
from gf_usd.errors import InputError
from gf_usd.model import Ints, StageFacts
from gf_usd.stage_physics import SubsetMaterial
from gf_usd.vocabulary import MaterialWords


def read_subsets(
    mesh: Usd.Prim,
    facts: StageFacts,
    time: Usd.TimeCode,
    materials: PhysicsMaterials,
    density: float | None,
    notes: Notes,
) -> tuple[SubsetMaterial, ...]:
    """The subsets of faces, family materialBind, whose physics material differs from the mesh's.

    density : [kg/m^3] of the mesh's PhysicsMassAPI.  A face in two of them belongs to the first.

    Raises InputError for indices that are no faces of the mesh.
    """
    if not mesh.IsA(UsdGeom.Mesh):
        return ()
    whole = materials.bound(mesh)
    n_faces = len(UsdGeom.Mesh(mesh).GetFaceVertexCountsAttr().Get(time) or [])
    taken = np.zeros(n_faces, dtype=bool)
    found = []
    for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets():
        prim = subset.GetPrim()
        words = materials.bound(prim)
        if words.path == whole.path or words == MaterialWords(path=words.path):
            continue  # the mesh's own, or a look without a word of physics
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            notes.add(
                "is no subset of faces: its physics material is not read", str(prim.GetPath())
            )
            continue
        faces = _faces(subset, facts, time, n_faces)
        if taken[faces].any():
            notes.add("shares faces with a subset before it, which keeps them", str(prim.GetPath()))
            faces = faces[~taken[faces]]
        taken[faces] = True
        if len(faces):
            material = materials.whole(words, density)
            found.append(
                SubsetMaterial(
                    path=str(prim.GetPath()), faces=faces, words=words, material=material
                )
            )
    return tuple(found)


def _faces(subset: UsdGeom.Subset, facts: StageFacts, time: Usd.TimeCode, n_faces: int) -> Ints:
    """(n,) faces in order, each once."""
    indices = np.asarray(subset.GetIndicesAttr().Get(time) or [], dtype=np.int64)
    outside = (indices < 0) | (indices >= n_faces)
    if outside.any():
        raise InputError(
            f"{facts.path}: <{subset.GetPrim().GetPath()}>: {int(outside.sum())} of its"
            f" {len(indices)} indices are no faces of the mesh, which has {n_faces};"
            f" the first is {indices[outside][0]}",
            "repair the subset in the program that made it",
        )
    return np.unique(indices)

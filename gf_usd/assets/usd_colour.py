"""The colours of a mesh: displayColor, bound materials, texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from gf_usd.assets.notes import Notes
from gf_usd.assets.usd_material import Look, Looks
from gf_usd.assets.usd_primvars import Corners, primvar_at_corners
from gf_usd.surface_material import SurfaceMaterial

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Colours:
    """Fields of a Surface that say its colour."""

    colours: Floats | None  # (T, 3, 3) linear
    uvs: Floats | None  # (T, 3, 2)
    indices: Ints | None  # (T,) into materials, -1 none
    materials: tuple[SurfaceMaterial, ...]


def colours(
    prim: Usd.Prim, corners: Corners, looks: Looks, time: Usd.TimeCode, notes: Notes
) -> Colours:
    """What colours each triangle of `prim`; None in each field where nothing is authored."""
    display = primvar_at_corners(prim, "displayColor", 3, corners, time, notes)
    bound, of_face = _bindings(prim, corners.n_faces, looks, time, notes)
    indices = of_face[corners.faces]
    uvs: Floats | None = None
    materials: list[SurfaceMaterial] = []
    slots = np.full(len(bound) + 1, -1)  # the last is for faces without a material
    for i, look in enumerate(bound):
        mine = indices == i
        if look.colour_primvar and mine.any():
            named = primvar_at_corners(prim, look.colour_primvar, 3, corners, time, notes)
            if named is not None:
                display = np.full(named.shape, 0.5) if display is None else display.copy()
                display[mine] = named[mine]
                continue
        if not look.understood and display is not None:
            continue
        if look.place is not None and mine.any():
            uvs = np.zeros((*corners.triangles.shape, 2)) if uvs is None else uvs
            uvs[mine] = _texture_coordinates(prim, look, corners, time, notes)[mine]
        slots[i] = len(materials)
        materials.append(look.material)
    return Colours(
        colours=display,
        uvs=uvs,
        indices=slots[indices] if materials else None,
        materials=tuple(materials),
    )


def _texture_coordinates(
    prim: Usd.Prim, look: Look, corners: Corners, time: Usd.TimeCode, notes: Notes
) -> Floats:
    """(T, 3, 2) where the look's texture is read."""
    place = look.place
    assert place is not None
    found = None
    if place.primvar:
        found = primvar_at_corners(prim, place.primvar, 2, corners, time, notes)
        if found is None:
            notes.add(
                f"has no usable primvar {place.primvar}, which the texture of "
                f"{look.material.path} reads: one place of the texture instead",
                str(prim.GetPath()),
            )
    if found is None:
        found = np.broadcast_to(place.fallback, (*corners.triangles.shape, 2))
    return place(found)


def _bindings(
    prim: Usd.Prim, n_faces: int, looks: Looks, time: Usd.TimeCode, notes: Notes
) -> tuple[list[Look], Ints]:
    """The looks bound to a mesh or its subsets, and the one of each face (P,); -1 none."""
    found: list[Look] = []
    of_face = np.full(n_faces, -1)

    def bind(look: Look | None, faces: Ints | slice) -> None:
        if look is not None:
            if look not in found:
                found.append(look)
            of_face[faces] = found.index(look)

    bind(looks.bound(prim), slice(None))
    if prim.IsA(UsdGeom.Mesh):
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
                continue
            values = subset.GetIndicesAttr().Get(time)
            faces = np.asarray([] if values is None else values, dtype=np.int64).reshape(-1)
            inside = (faces >= 0) & (faces < n_faces)
            if not inside.all():
                notes.add(
                    f"{int((~inside).sum())} of its {len(faces)} indices are outside the "
                    f"{n_faces} faces: ignored",
                    str(subset.GetPath()),
                )
            bind(looks.bound(subset.GetPrim()), faces[inside])
    return found, of_face

"""Obstacles of other files that a bake had: its result does not contain them, pictures show them.

They are meshes in the session layer of the stage, as the solver had them: static, and in the place
and pose that they had at the first frame of their file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import (
    BAKES,
    COLLIDER_HASHES,
    COLLIDERS,
    NO_COLOR,
    StageFacts,
    Surface,
    free_name,
)
from gf_usd.core.errors import InputError
from gf_usd.readers.inputs import digest
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd_physics.obstacle_files import ObstacleFile, read_obstacle_file

SCOPE = "ObstacleFiles"
Read = dict[Path, ObstacleFile]  # files that were read


def add_obstacle_files(
    stage: Usd.Stage, path: Path, facts: StageFacts, notes: Notes, read: Read
) -> frozenset[str]:
    """Define the meshes of the obstacle files of a bake in the session layer; returns their paths.

    read : files that were read before, such as for another variant; those that are read are added.
    A file that is not there, cannot be read or has changed is named in a note.
    """
    about = stage.GetRootLayer().customLayerData.get(BAKES)
    if not isinstance(about, dict) or COLLIDERS not in about:
        return frozenset()
    stage.SetEditTarget(stage.GetSessionLayer())
    scope = _free(stage, Sdf.Path.absoluteRootPath, SCOPE)
    found: set[str] = set()
    for name, known in zip(about[COLLIDERS], about[COLLIDER_HASHES], strict=True):
        file = path.parent / str(name)
        what = f"{file.name}, an obstacle of the bake,"
        if not file.is_file():
            notes.add(f"{what} is not drawn: {file} does not exist")
            continue
        try:
            if file not in read:
                read[file] = read_obstacle_file(file, facts.up_axis)
        except InputError as refused:
            notes.add(f"{what} is not drawn: {refused}")
            continue
        if digest(file) != known:
            notes.add(f"{what} has changed since, and is drawn as it is now")
        for surface in read[file].surfaces:
            words = f"{file.stem}_{Sdf.Path(surface.path).name}"
            place = _free(stage, scope, Tf.MakeValidIdentifier(words))
            _define(stage, place, surface, read[file].points(surface) / facts.units.length)
            found.add(str(place))
    return frozenset(found)


def _free(stage: Usd.Stage, above: Sdf.Path, name: str) -> Sdf.Path:
    """The path of a prim that does not exist: of this name, or with a number."""
    free = free_name(name, lambda one: bool(stage.GetPrimAtPath(above.AppendChild(one))))
    return above.AppendChild(free)


def _define(stage: Usd.Stage, path: Sdf.Path, surface: Surface, points: Floats) -> None:
    """Define a surface with points (V, 3) [stage units] and its colors, without textures."""
    mesh, count = UsdGeom.Mesh.Define(stage, path), len(surface.triangles)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(count, 3, np.int32)))
    indices = np.asarray(surface.triangles, np.int32).ravel()
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    colors = np.tile(np.asarray(NO_COLOR, np.float64), (count, 3, 1))
    if surface.triangle_colors is not None:
        colors[:] = surface.triangle_colors
    if surface.triangle_materials is not None:
        for k, material in enumerate(surface.materials):
            colors[np.asarray(surface.triangle_materials) == k] = material.color
    shown = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.faceVarying)
    shown.Set(Vt.Vec3fArray.FromNumpy(colors.reshape(-1, 3).astype(np.float32)))

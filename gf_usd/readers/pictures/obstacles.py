"""Obstacles of other files that a bake had: its result does not contain them, pictures show them.

They are meshes in the session layer of the stage, as the solver had them: static, and in the place
and pose that they had at the first frame of their file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import BAKES, COLLIDERS, NO_COLOR, StageFacts, Surface
from gf_usd.core.errors import InputError
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd_physics.obstacle_files import read_obstacle_file

SCOPE = "ObstacleFiles"


def add_obstacle_files(stage: Usd.Stage, path: Path, facts: StageFacts, notes: Notes) -> None:
    """Define the meshes of the obstacle files of a bake in the session layer.

    A file that is not there, or cannot be read, is named in a note.
    """
    about = stage.GetRootLayer().customLayerData.get(BAKES)
    named: Any = about.get(COLLIDERS, ()) if isinstance(about, dict) else ()
    if not named:
        return
    stage.SetEditTarget(stage.GetSessionLayer())
    scope = _free(stage, Sdf.Path(f"/{SCOPE}"))
    for name in named:
        file = path.parent / str(name)
        if not file.is_file():
            notes.add(f"{file.name}, an obstacle of the bake, is not drawn: {file} does not exist")
            continue
        try:
            read = read_obstacle_file(file, facts.up_axis)
        except InputError as refused:
            notes.add(f"{file.name}, an obstacle of the bake, is not drawn: {refused}")
            continue
        for surface in read.surfaces:
            words = f"{file.stem}_{Sdf.Path(surface.path).name}"
            place = _free(stage, scope.AppendChild(Tf.MakeValidIdentifier(words)))
            _define(stage, place, surface, read.points(surface) / facts.units.length)


def _free(stage: Usd.Stage, path: Sdf.Path) -> Sdf.Path:
    """A path without a prim: the given one, or one with a number."""
    taken, number = path, 1
    while stage.GetPrimAtPath(taken):
        taken = path.ReplaceName(f"{path.name}_{number}")
        number += 1
    return taken


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

"""What Blender's exporter leaves out of the stage: obstacles, their motion, and pinned faces.

Written by the OpenUSD that Blender includes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .objects import prim_path
from .program import ProgramError

PIN = "gf_usd_pin"  # name of the subset of pinned faces
WEIGHT = 0.5  # of a vertex in its group, above which it is pinned
MOVES = 1e-6  # of the size of a mesh, above which its vertices have moved


@dataclass
class Motion:
    """Of one object: matrices (4, 4) to the world and vertices (n, 3) of its mesh at each frame."""

    matrices: list[Any] = field(default_factory=list)
    points: list[Any] = field(default_factory=list)


def record(context: bpy.types.Context, originals: Sequence[Any], frames: range) -> list[Motion]:
    """How objects move and deform over the frames of the scene, modifiers applied.

    Raises ProgramError where the number of vertices changes.
    """
    scene, here = context.scene, context.scene.frame_current
    motions = [Motion() for _ in originals]
    try:
        for frame in frames if originals else ():
            scene.frame_set(frame)
            graph = context.evaluated_depsgraph_get()
            for original, motion in zip(originals, motions, strict=True):
                shape = original.evaluated_get(graph)
                points = np.empty(3 * len(shape.data.vertices), np.float32)
                shape.data.vertices.foreach_get("co", points)
                if motion.points and len(points) != len(motion.points[0]) * 3:
                    raise ProgramError(
                        f"{original.name} has {len(points) // 3} vertices in frame {frame}, and "
                        f"{len(motion.points[0])} in frame {frames.start}",
                        "turn off the modifier that changes how many there are",
                    )
                motion.matrices.append(np.array(shape.matrix_world, np.float64))
                motion.points.append(points.reshape(-1, 3))
    finally:
        scene.frame_set(here)
    return motions


def pinned_faces(original: Any, copy: Any, group: str) -> list[int]:
    """Indices of the faces of the copy whose vertices all weigh more than WEIGHT in the group."""
    if group not in original.vertex_groups:
        return []
    index = original.vertex_groups[group].index
    held = {
        vertex.index
        for vertex in copy.data.vertices
        if any(g.group == index and g.weight > WEIGHT for g in vertex.groups)
    }
    return [face.index for face in copy.data.polygons if held.issuperset(face.vertices)]


def complete(
    path: Path,
    frames: range,
    *,
    obstacles: dict[str, Motion],
    pinned: dict[str, tuple[Motion, list[int]]],
) -> list[str]:
    """Add obstacles, motions and pinned faces to an exported stage.

    Parameters
    ----------
    obstacles : motion of the copies that are obstacles, by name.
    pinned : motion and pinned faces of the copies that are baked, by name.

    Returns the paths of the subsets of pinned faces.

    Raises ProgramError where this Blender cannot write USD from Python.
    """
    if not obstacles and not pinned:
        return []
    try:
        from pxr import Usd, UsdGeom, UsdPhysics
    except ImportError as error:
        raise ProgramError(
            f"this Blender has no Python modules of OpenUSD ({error})",
            "leave Obstacles and Pin Group empty, or use a release of blender.org",
        ) from error
    stage = Usd.Stage.Open(str(path))
    for name, motion in obstacles.items():
        prim = stage.GetPrimAtPath(prim_path(name))
        UsdPhysics.CollisionAPI.Apply(prim)
        UsdPhysics.RigidBodyAPI.Apply(prim).CreateKinematicEnabledAttr(True)
        _animate(UsdGeom.Mesh(prim), motion, frames)
    subsets = []
    for name, (motion, faces) in pinned.items():
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(prim_path(name)))
        # the copy that takes the result stays where it is: its mesh alone moves
        _animate(mesh, _in_the_first_frame(motion), frames)
        subset = UsdGeom.Subset.CreateGeomSubset(mesh, PIN, UsdGeom.Tokens.face, faces)
        subsets.append(str(subset.GetPath()))
    stage.GetRootLayer().Save()
    return subsets


def _in_the_first_frame(motion: Motion) -> Motion:
    """The same motion by the vertices alone, in the object's space of the first frame."""
    first = motion.matrices[0]
    points = []
    for matrix, local in zip(motion.matrices, motion.points, strict=True):
        change = np.linalg.solve(first, matrix)
        points.append((local @ change[:3, :3].T + change[:3, 3]).astype(np.float32))
    return Motion(matrices=[first] * len(points), points=points)


def _animate(mesh: Any, motion: Motion, frames: range) -> None:
    """Samples of the transform and of the points, where they move."""
    from pxr import Gf, Usd, Vt

    if np.ptp(motion.matrices, axis=0).any():
        transform = mesh.MakeMatrixXform()
        for frame, rows in zip(frames, motion.matrices, strict=True):
            # Blender's vectors are columns, those of USD rows
            transform.Set(Gf.Matrix4d(rows.T.tolist()), Usd.TimeCode(frame))
    size = float(np.ptp(motion.points[0], axis=0).max())
    if np.abs(np.subtract(motion.points, motion.points[0])).max() > MOVES * size:
        for frame, points in zip(frames, motion.points, strict=True):
            mesh.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), Usd.TimeCode(frame))

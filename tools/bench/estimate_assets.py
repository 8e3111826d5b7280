"""Assets of `tools.bench.estimates` whose contact or strain takes most substeps, in meters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

TURNED = -0.5 * np.pi  # about x, from z up to y up


def _stage(
    path: Path,
    meshes: Mapping[str, Any],
    *,
    apart: bool = False,
    pinned: float = np.inf,
    moved: Mapping[str, tuple[tuple[int, tuple[float, float, float]], ...]] | None = None,
) -> None:
    """Meshes of trimesh below /Asset.

    apart : each is a body of its own; pinned : [m] height above which points are in the subset
    `Top` of their mesh; moved : obstacles, with time codes and translations.
    """
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Asset").GetPrim())
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    for name, made in meshes.items():
        mesh = UsdGeom.Mesh.Define(stage, f"/Asset/{name}")
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(made.vertices, np.float32)))
        mesh.CreateFaceVertexCountsAttr([3] * len(made.faces))
        mesh.CreateFaceVertexIndicesAttr(np.asarray(made.faces).ravel().tolist())
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        top = np.flatnonzero(np.asarray(made.vertices)[:, 1] > pinned)
        if len(top):
            subset = UsdGeom.Subset.Define(stage, f"/Asset/{name}/Top")
            subset.CreateElementTypeAttr(UsdGeom.Tokens.point)
            subset.CreateIndicesAttr(top.tolist())
        if moved and name in moved:
            UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
            move = mesh.AddTranslateOp()
            for code, place in moved[name]:
                move.Set(Gf.Vec3d(*place), code)
        elif apart:
            UsdPhysics.RigidBodyAPI.Apply(mesh.GetPrim())
    stage.Save()


def _turned(profile: Any) -> Any:
    """The surface of a profile (radius, height) turned about the vertical axis."""
    import trimesh

    made = trimesh.creation.revolve(np.array(profile, float), sections=32)
    made.apply_transform(trimesh.transformations.rotation_matrix(TURNED, [1.0, 0.0, 0.0]))
    if made.volume < 0.0:
        made.invert()
    return made


def lamp(path: Path) -> None:
    """A lamp of 11 kg of rubber on a cable 2.2 m long and 24 mm thick."""
    cable = [(0.012, y) for y in np.linspace(2.5, 0.3, 80)]
    made = _turned([(0.0, 2.5), *cable, (0.05, 0.28), (0.15, 0.0), (0.0, 0.0)])
    _stage(path, {"Lamp": made}, pinned=2.4)


def chain(path: Path) -> None:
    """Six links 0.25 m wide and 0.05 m thick, the next 4 mm below the touch of the one before."""
    import trimesh

    links = {}
    for k in range(6):
        link = trimesh.creation.torus(0.1, 0.025, major_sections=40, minor_sections=16)
        if k % 2:
            link.apply_transform(
                trimesh.transformations.rotation_matrix(0.5 * np.pi, [0.0, 1.0, 0.0])
            )
        link.apply_translation([0.0, 2.0 - 0.146 * k, 0.0])
        links[f"L{k}"] = link
    _stage(path, links, apart=True)


def _gear(x: float, phase: float) -> Any:
    """One with 12 teeth, 0.25 m wide and 0.05 m thick, with a bore of 0.06 m."""
    import trimesh

    pitch = 2.0 * np.pi / 12
    corners = ((0.0, 0.1), (0.12, 0.125), (0.33, 0.125), (0.45, 0.1))
    angle, radius = np.array(
        [(pitch * (k + phase + part), r) for k in range(12) for part, r in corners]
    ).T
    bore, m = np.full(len(angle), 0.03), len(angle)
    rings = ((radius, 0.0), (radius, 0.05), (bore, 0.05), (bore, 0.0))
    points = np.concatenate(
        [np.c_[r * np.cos(angle), np.full(m, y), r * np.sin(angle)] for r, y in rings]
    )
    i = np.arange(m)
    j, faces = (i + 1) % m, []
    for ring in range(4):
        a, b = ring * m, (ring + 1) % 4 * m
        faces += [np.c_[a + i, b + i, a + j], np.c_[a + j, b + i, b + j]]
    made = trimesh.Trimesh(points, np.concatenate(faces), process=False)
    if made.volume < 0.0:
        made.invert()
    made.apply_translation([x, 0.0, 0.0])
    return made


def gears(path: Path) -> None:
    """Three whose teeth mesh."""
    made = {"A": _gear(0.0, -0.225), "B": _gear(0.228, 0.275), "C": _gear(0.456, -0.225)}
    _stage(path, made, apart=True)


def pot(path: Path) -> None:
    """A pot 0.4 m wide, whose wall is about 0.03 m thick, with its lid on it."""
    outside = [(0.0, 0.0), (0.12, 0.0), (0.2, 0.1), (0.18, 0.22), (0.1, 0.26)]
    inside = [(0.08, 0.25), (0.16, 0.2), (0.17, 0.1), (0.1, 0.03), (0.0, 0.03)]
    lid = [(0.0, 0.265), (0.115, 0.265), (0.12, 0.278), (0.03, 0.303), (0.03, 0.343), (0.0, 0.343)]
    _stage(path, {"Pot": _turned(outside + inside), "Lid": _turned(lid)}, apart=True)


def hit(path: Path) -> None:
    """A ball that a box hits at 3.3 m/s."""
    import trimesh

    ball = trimesh.creation.icosphere(3, 0.2).apply_translation([0.0, 0.2, 0.0])
    way = ((0, (-0.8, 0.25, 0.0)), (8, (0.3, 0.25, 0.0)), (16, (-0.8, 0.25, 0.0)))
    box = trimesh.creation.box((0.3, 0.3, 0.3))
    _stage(path, {"Ball": ball, "Box": box}, moved={"Box": way})

"""A soft arm of two bones: a square prism along x with a skeleton that bends at its middle."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdSkel

RINGS, WIDTH = 9, 0.4  # [m] of a side; the prism is 2 m long, with the joints at x = 0 and 1
FIRST, LAST = 1, 13  # time codes of the animation
ALONG = np.linspace(0.0, 2.0, RINGS)
BOOT_CORNERS = np.array([[x, y, z] for x in (1.7, 2.1) for y in (-0.3, 0.3) for z in (-0.3, 0.3)])
BOOT_FACES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
BOOT = f"""
    def Mesh "Boot" ( prepend apiSchemas = ["SkelBindingAPI"] )
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points = [{", ".join(str(tuple(p)) for p in BOOT_CORNERS.tolist())}]
        int[] faceVertexCounts = {[4] * 6}
        int[] faceVertexIndices = {BOOT_FACES}
        rel skel:skeleton = </Arm/Skel>
        int[] primvars:skel:jointIndices = {[1] * 8} ( elementSize = 1; interpolation = "vertex" )
        float[] primvars:skel:jointWeights = {[1] * 8} ( elementSize = 1; interpolation = "vertex" )
    }}
}}
"""


def points() -> NDArray[np.float64]:
    """(4 RINGS, 3) [m] of the bind pose."""
    ring = 0.5 * WIDTH * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    return np.array([(x, *yz) for x in ALONG for yz in ring])


def faces() -> list[list[int]]:
    """Quads, seen from outside."""
    out = [[3, 2, 1, 0], [4 * RINGS - 4 + k for k in range(4)]]
    for r in range(RINGS - 1):
        for k in range(4):
            a, b = 4 * r + k, 4 * r + (k + 1) % 4
            out.append([a, b, b + 4, a + 4])
    return out


def arm(
    *,
    bend: tuple[float, float] = (20.0, 60.0),
    lift: tuple[float, float] = (0.0, 0.0),
    bind: str = "( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, 0, 0, 1) )",
    skin: str = "",
    joints: str = '["A", "A/B"]',
    skeleton: str = "rel skel:skeleton = </Arm/Skel>",
    rotation: str | None = None,
    more: str = "",
) -> str:
    """A usda file; bend : [degrees] of joint B about z, and lift : [m] of joint A along y, at the
    first and the last time code; more : of the mesh; the others : of a broken one.
    """
    weight = np.clip((ALONG - 0.8) / 0.4, 0.0, 1.0).repeat(4)
    weights = ", ".join(f"{1.0 - w:g}, {w:g}" for w in weight)
    quats = [
        f"(1, 0, 0, 0), ({math.cos(a)!r}, 0, 0, {math.sin(a)!r})"
        for a in (np.deg2rad(np.array(bend)) / 2.0).tolist()
    ]
    turn = rotation or f"[{quats[0]}], {LAST}: [{quats[1]}]"
    listed = ", ".join(str(tuple(p)) for p in points().tolist())
    corners = [c for face in faces() for c in face]
    return f"""#usda 1.0
( metersPerUnit = 1
  upAxis = "Y"
  defaultPrim = "Arm"
  startTimeCode = {FIRST}
  endTimeCode = {LAST}
  timeCodesPerSecond = 24 )
def SkelRoot "Arm" ( prepend apiSchemas = ["SkelBindingAPI"] )
{{
    def Skeleton "Skel" ( prepend apiSchemas = ["SkelBindingAPI"] )
    {{
        uniform token[] joints = {joints}
        uniform matrix4d[] bindTransforms = [
            ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) ), {bind}]
        uniform matrix4d[] restTransforms = [
            ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1) ),
            ( (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (1, 0, 0, 1) )]
        rel skel:animationSource = </Arm/Anim>
    }}
    def SkelAnimation "Anim"
    {{
        uniform token[] joints = ["A", "A/B"]
        float3[] translations.timeSamples = {{
            {FIRST}: [(0, {lift[0]!r}, 0), (1, 0, 0)], {LAST}: [(0, {lift[1]!r}, 0), (1, 0, 0)] }}
        quatf[] rotations.timeSamples = {{ {FIRST}: {turn} }}
        half3[] scales = [(1, 1, 1), (1, 1, 1)]
    }}
    def Mesh "Skin" ( prepend apiSchemas = ["SkelBindingAPI"] )
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points = [{listed}]
        int[] faceVertexCounts = {[4] * len(faces())}
        int[] faceVertexIndices = {corners}
        {skeleton}
        {more}
        int[] primvars:skel:jointIndices = {skin or [0, 1] * len(weight)} (
            elementSize = 2
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = [{weights}] (
            elementSize = 2
            interpolation = "vertex"
        )
    }}
}}
"""


def bound_mesh(
    name: str, points: Any, faces: Any, joints: list[int], weights: list[float] | None = None
) -> str:
    """A mesh whose points are each bound to as many joints, with weights of 1 by default."""
    size = len(joints) // len(points)
    return f"""
    def Mesh "{name}" ( prepend apiSchemas = ["SkelBindingAPI"] )
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points = [{", ".join(f"({x:.6f}, {y:.6f}, {z:.6f})" for x, y, z in points)}]
        int[] faceVertexCounts = {[len(face) for face in faces]}
        int[] faceVertexIndices = {[int(c) for face in faces for c in face]}
        rel skel:skeleton = </Arm/Skel>
        int[] primvars:skel:jointIndices = {joints} (
            elementSize = {size}
            interpolation = "vertex"
        )
        float[] primvars:skel:jointWeights = {weights or [1] * len(joints)} (
            elementSize = {size}
            interpolation = "vertex"
        )
    }}
"""


def swinging() -> str:
    """The arm in a cycle: B swings out and back, and stands where it began."""
    out_and_back = [
        f"[(1, 0, 0, 0), ({math.cos(half):.9f}, 0, 0, {math.sin(half):.9f})]"
        for half in np.deg2rad([10.0, 20.0, 10.0]).tolist()
    ]
    return arm(rotation=f"{out_and_back[0]}, 7: {out_and_back[1]}, {LAST}: {out_and_back[2]}")


def write(folder: Path, text: str) -> Path:
    """The file arm.usda in a folder."""
    path = folder / "arm.usda"
    path.write_text(text, encoding="utf-8")
    return path


def booted(folder: Path) -> Path:
    """The arm with a boot on its end, which joint B alone carries."""
    return write(folder, arm().rstrip().removesuffix("}") + BOOT)


def cached(path: Path, *, every: int = 1, with_range: bool = True, more: str = "") -> str:
    """The arm of a file as a usda file without its skeleton: its points at each frame.

    every : frames between the samples; more : of the prim above the mesh.
    """
    codes = range(FIRST, LAST + 1, every)
    samples = ", ".join(
        f"{code}: [{', '.join(str(tuple(p)) for p in skinned(path, code).tolist())}]"
        for code in codes
    )
    corners = [c for face in faces() for c in face]
    metadata = f"startTimeCode = {FIRST}\n  endTimeCode = {LAST}" if with_range else ""
    return f"""#usda 1.0
( metersPerUnit = 1
  upAxis = "Y"
  defaultPrim = "Arm"
  {metadata}
  timeCodesPerSecond = 24 )
def Xform "Arm"
{{
    {more}
    def Mesh "Skin"
    {{
        uniform token subdivisionScheme = "none"
        point3f[] points.timeSamples = {{ {samples} }}
        int[] faceVertexCounts = {[4] * len(faces())}
        int[] faceVertexIndices = {corners}
    }}
}}
"""


def skinned(path: Path, code: float) -> NDArray[np.float64]:
    """(V, 3) [m] world points as UsdSkel poses them."""
    stage = Usd.Stage.Open(str(path))
    cache, root = UsdSkel.Cache(), UsdSkel.Root(stage.GetPrimAtPath("/Arm"))
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    (skin,) = binding.GetSkinningTargets()
    posed = UsdGeom.Mesh(skin.GetPrim()).GetPointsAttr().Get(code)
    joints = cache.GetSkelQuery(binding.GetSkeleton()).ComputeSkinningTransforms(code)
    assert skin.ComputeSkinnedPoints(joints, posed, code)
    return np.array(posed, float)


def drawn(stage: Usd.Stage, code: float, path: str = "/Arm/Skin") -> NDArray[np.float64]:
    """(V, 3) [m] world points of the mesh as they are authored."""
    prim = stage.GetPrimAtPath(path)
    M = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code))
    return np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(code)) @ M[:3, :3] + M[3, :3]


def captured(folder: Path, count: int = 3000) -> Path:
    """The arm as about so many captured Gaussians without joint weights, next to its skeleton:
    person.usda.
    """
    import trimesh
    from captures import define, facing

    from gf_usd.core.asset import Splats

    box = trimesh.creation.box((2.0, WIDTH, WIDTH))
    at, face = trimesh.sample.sample_surface_even(box, count, seed=1)
    at = at + [1.0, 0.0, 0.0]
    normals = box.face_normals[face]
    wide = np.sqrt(box.area / len(at))
    rig = folder / "rig.usda"
    rig.write_text(arm(), encoding="utf-8")
    stage = Usd.Stage.CreateNew(str(folder / "person.usda"))
    source = Sdf.Layer.FindOrOpen(str(rig))
    stage.GetRootLayer().TransferContent(source)
    stage.RemovePrim("/Arm/Skin")
    splats = Splats(
        positions=at.astype(np.float32), orientations=facing(normals),
        scales=np.tile(np.float32([0.7, 0.6, 0.1]) * np.float32(wide), (len(at), 1)),
        opacities=np.ones(len(at), np.float32), harmonics=np.zeros((len(at), 1, 3), np.float32),
        path="/Arm/Person",
    )  # fmt: skip
    define(stage, "/Arm/Person", splats)
    stage.Save()
    return folder / "person.usda"


def shaped(first: float, last: float) -> str:
    """The arm with a blend shape, Bulge, which moves the ring at its middle by 0.2 m along z, at
    weights at the first and the last time code.
    """
    weights = f"""uniform token[] blendShapes = ["Bulge"]
        float[] blendShapeWeights.timeSamples = {{ {FIRST}: [{first!r}], {LAST}: [{last!r}] }}
        half3[] scales"""
    mesh = """uniform token[] skel:blendShapes = ["Bulge"]
        rel skel:blendShapeTargets = </Arm/Skin/Bulge>
        def BlendShape "Bulge"
        {
            uniform vector3f[] offsets = [(0, 0, 0.2), (0, 0, 0.2), (0, 0, 0.2), (0, 0, 0.2)]
            uniform int[] pointIndices = [16, 17, 18, 19]
        }
"""
    return arm(more=mesh).replace("half3[] scales", weights, 1)


def arm_with(folder: Path, *meshes: str, skin: str | None = None) -> Path:
    """The arm with meshes beside it; skin : one instead of its own."""
    text = arm().rstrip().removesuffix("}")
    if skin is not None:
        text = text[: text.index('    def Mesh "Skin"')] + skin
    return write(folder, text + "".join(meshes) + "}\n")

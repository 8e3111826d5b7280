"""Small assets, baked; and where their vertices are in the world, by our own OpenUSD."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from arm import LAST, arm, swinging
from arm import write as write_arm
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

import gf_usd
import gf_usd.system.usd_schema

FRAMES = 5
CENTIMETER = 0.01
# A turn about an oblique axis, uneven scales, and one mirror
PLACES = {
    "left": ((-9.0, 1.0, 8.0), (20.0, 35.0, -15.0), (2.0, 1.0, 1.5)),
    "right": ((9.0, -2.0, 12.0), (-50.0, 10.0, 80.0), (-1.0, 1.0, 1.25)),
}


@dataclass(frozen=True)
class Baked:
    """What a bake wrote."""

    source: Path  # the USD form of the asset
    root: Path
    caches: tuple[Path, ...]
    materials: tuple[object, ...]  # gf_usd.core.materials.material.Material, one for each preset

    def with_output_folder(self, folder: Path) -> Baked:
        """The same in another folder, to be damaged there."""
        shutil.copytree(self.root.parent, folder)
        return Baked(
            source=folder / self.source.name,
            root=folder / self.root.name,
            caches=tuple(folder / cache.name for cache in self.caches),
            materials=self.materials,
        )


def bake_duck(sample: Path, folder: Path) -> Baked:
    """A duck of three variants; the source is a crate, as validators require for large arrays."""
    asset = folder / "duck.usdc"
    Sdf.Layer.FindOrOpen(str(sample)).Export(str(asset))
    return _bake(asset, material="rubber,metal,jelly", drop="0.1r")


def bake_blocks(folder: Path, combine: bool = True, **more: object) -> Baked:
    """Two blocks of centimeters, Z up, under transforms that nothing may mix up.

    combine : as one body, and so of one material; jelly apart is two, softer for the smaller block.
    """
    asset = folder / "blocks.usdc"
    stage = Usd.Stage.CreateNew(str(asset))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, CENTIMETER)
    stage.SetTimeCodesPerSecond(30)
    stage.SetStartTimeCode(101)
    root = UsdGeom.Xform.Define(stage, "/Blocks")
    root.AddRotateZOp().Set(25.0)
    stage.SetDefaultPrim(root.GetPrim())
    for name, (place, turn, scale) in PLACES.items():
        above = UsdGeom.Xform.Define(stage, f"/Blocks/{name}")
        above.AddTranslateOp().Set(Gf.Vec3d(*place))
        above.AddRotateXYZOp().Set(Gf.Vec3f(*turn))
        above.AddScaleOp().Set(Gf.Vec3f(*scale))
        _block(stage, f"/Blocks/{name}/Mesh")
    stage.Save()
    return _bake(asset, material="jelly", drop="0.1r", combine=combine, **more)


def bake_arm(folder: Path) -> Baked:
    """The flesh of an arm whose skeleton bends it: the file binds it, the bake may not."""
    asset = write_arm(folder, arm())
    return _bake(asset, material="jelly", flesh=True, frames=LAST)


GOALS = "float primvars:gaussianFlesh:goal.timeSamples = { 1: 0.8, 7: 0.2 }"
GRAVITY = "# time code, gravity\n1, 9.81\n6, 0, 3, 0\n"
# each is what moves or bounds the flesh of a character besides its bones
DRIVEN = ("goals", "limits", "fields", "loop")


def bake_driven(folder: Path, what: str) -> Baked:
    """The arm with one of DRIVEN."""
    (folder / "gravity.csv").write_text(GRAVITY, encoding="utf-8")
    options: dict[str, dict[str, object]] = {
        "goals": {"goal_frequency": 4.0},
        "limits": {"bone_radius": 0.3, "squish": 0.6, "stretch": 0.3},
        "fields": {
            "fields": ("wind:0,0,4", "noise:3:length=0.5:rate=1"),
            "gravity": str(folder / "gravity.csv"),
        },
        "loop": {"loop": 2},
    }
    text = {"goals": arm(more=GOALS), "loop": swinging()}.get(what, arm())
    frames = None if what == "loop" else LAST  # a loop has the length of its cycle
    return _bake(
        write_arm(folder, text), material="jelly", flesh=True, frames=frames, **options[what]
    )


def bake_obj(folder: Path) -> Baked:
    """A block of meters out of an OBJ file."""
    asset = folder / "block.obj"
    points, quads = cube_grid(4)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in 0.1 * points]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines += ["f " + " ".join(f"{v + 1}/{c + 1}" for c, v in enumerate(quad)) for quad in quads]
    asset.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return _bake(asset, material="rubber", drop="0.1r")


def shot(baked: Baked, path: Path, display: str) -> Path:
    """A layer that references a bake and selects what shows, as a shot would."""
    stage = Usd.Stage.CreateNew(str(path))
    made = Usd.Stage.Open(str(baked.root))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(made))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(made))
    stage.SetTimeCodesPerSecond(made.GetTimeCodesPerSecond())
    stage.SetStartTimeCode(made.GetStartTimeCode())
    stage.SetEndTimeCode(made.GetEndTimeCode())
    name = made.GetDefaultPrim().GetName()
    prim = stage.DefinePrim(f"/{name}")
    prim.GetReferences().AddReference(str(baked.root))
    prim.GetVariantSets().SetSelection("display", display)
    stage.SetDefaultPrim(prim)
    stage.Save()
    return path


def time_codes(root: Path) -> list[int]:
    """Of every baked frame."""
    stage = Usd.Stage.Open(str(root))
    return list(range(round(stage.GetStartTimeCode()), round(stage.GetEndTimeCode()) + 1))


def world_points(root: Path, kind: str = "Mesh") -> dict[str, np.ndarray]:
    """(frames, vertices, 3) [m] in a Z-up world, for each prim of a type that is shown."""
    stage = Usd.Stage.Open(str(root))
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    turn = np.eye(3)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    shown = [
        prim for prim in stage.Traverse()
        if prim.GetTypeName() == kind
        and UsdGeom.Imageable(prim).ComputeVisibility() != UsdGeom.Tokens.invisible
    ]  # fmt: skip
    world = {}
    for prim in shown:
        frames = []
        for time in time_codes(root):
            matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time))
            local = np.array(UsdGeom.PointBased(prim).GetPointsAttr().Get(time), np.float64)
            frames.append((local @ matrix[:3, :3] + matrix[3, :3]) @ turn * unit)
        world[str(prim.GetPath())] = np.array(frames)
    return world


def cube_grid(n: int) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Points (V, 3) and outward quads of the cube from -1 to 1, n x n to a face, watertight."""
    index: dict[tuple[int, int, int], int] = {}
    quads = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, n):
            for i in range(n):
                for j in range(n):
                    corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    if side == 0:
                        corners.reverse()
                    quad = []
                    for u, v in corners:
                        key = [0, 0, 0]
                        key[axis], key[a], key[b] = side, u, v
                        quad.append(index.setdefault(tuple(key), len(index)))
                    quads.append(tuple(quad))
    return np.array(list(index)) * (2.0 / n) - 1.0, quads


def _block(stage: Usd.Stage, path: str) -> None:
    points, quads = cube_grid(4)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy((3.0 * points).astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([4] * len(quads))
    mesh.CreateFaceVertexIndicesAttr([v for quad in quads for v in quad])
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr([(-3.0, -3.0, -3.0), (3.0, 3.0, 3.0)])
    normals = np.repeat([_normal(points, quad) for quad in quads], 4, axis=0)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.faceVarying)
    uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    uv.Set([(0, 0), (1, 0), (1, 1), (0, 1)])
    uv.SetIndices(Vt.IntArray(list(range(4)) * len(quads)))
    half = len(quads) // 2
    looks = (
        ("red", (0.8, 0.1, 0.1), range(half)),
        ("blue", (0.1, 0.1, 0.8), range(half, 2 * half)),
    )
    for name, color, faces in looks:
        subset = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).CreateMaterialBindSubset(
            name, Vt.IntArray(list(faces))
        )
        material = _material(stage, f"/Blocks/Materials/{name}", color)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)


def _normal(points: np.ndarray, quad: Sequence[int]) -> np.ndarray:
    across = np.cross(points[quad[1]] - points[quad[0]], points[quad[2]] - points[quad[0]])
    return across / np.linalg.norm(across)


def _material(stage: Usd.Stage, path: str, color: tuple[float, ...]) -> UsdShade.Material:
    UsdGeom.Scope.Define(stage, Sdf.Path(path).GetParentPath())
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{path}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color))
    shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material


def _bake(asset: Path, **options: object) -> Baked:
    out = asset.parent / f"{asset.stem}.baked.usda"
    done = gf_usd.bake(asset, output=out, **{"particles": 300, "frames": FRAMES, **options})
    assert not done.findings, done.findings
    (source,) = (
        asset.parent.glob(f"{asset.stem}.source.usdc") if asset.suffix == ".obj" else [asset]
    )
    return Baked(
        source=source,
        root=done.root,
        caches=tuple(bake.cache for bake in done.bakes),
        materials=tuple(bake.material for bake in done.bakes),
    )

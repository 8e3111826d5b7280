"""One sample as a USD layer: a component with one mesh, its materials, units and axis."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from tools.samples.quads import Quads
from tools.samples.uv import Atlas

# decimals, not digits: rounding noise about zero must not reach the file
POINT_DECIMALS, NORMAL_DECIMALS, UV_DECIMALS = 5, 4, 5
VERSION = "1.0"
LICENCE = "Apache-2.0"


@dataclass(frozen=True, kw_only=True)
class Look:
    """A UsdPreviewSurface without textures."""

    color: tuple[float, float, float]  # diffuse, linear Rec. 709
    roughness: float
    clearcoat: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Everything a sample file says."""

    name: str  # of the root prim; the file is its snake case
    doc: str
    meters_per_unit: float
    mesh: Quads  # points in stage units, Y up; its parts are keys of ``looks``
    normals: NDArray[np.float64]  # (V, 3) unit
    atlas: Atlas
    looks: Mapping[str, Look]


def rounded(values: NDArray[np.float64], decimals: int) -> NDArray[np.float32]:
    """Float32 of the values rounded to ``decimals``, without negative zeros."""
    return (np.round(values, decimals) + 0.0).astype(np.float32)


def write_sample(path: Path, sample: Sample) -> None:
    """Write ``sample`` as text to ``path``; the same sample gives the same bytes."""
    stage = Usd.Stage.CreateInMemory(f"{sample.name}.usda")
    layer = stage.GetRootLayer()
    layer.documentation = sample.doc
    layer.customLayerData = {"license": LICENCE, "madeBy": "gf-usd tools/make_samples.py"}
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, sample.meters_per_unit)

    root = UsdGeom.Xform.Define(stage, f"/{sample.name}")
    stage.SetDefaultPrim(root.GetPrim())
    model = Usd.ModelAPI(root)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(sample.name)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{path.name}"))
    model.SetAssetVersion(VERSION)

    UsdGeom.Scope.Define(stage, root.GetPath().AppendChild("Geom"))
    mesh = define_mesh(stage, root.GetPath().AppendPath("Geom/Body"), sample)
    scope = UsdGeom.Scope.Define(stage, root.GetPath().AppendChild("Materials"))
    materials = {
        part: define_material(stage, scope.GetPath().AppendChild(part.capitalize()), look)
        for part, look in sample.looks.items()
    }
    if len(materials) == 1:
        [material] = materials.values()
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    else:
        bind_by_part(mesh, sample.mesh.parts, materials)
    layer.Export(str(path))


def define_mesh(stage: Usd.Stage, path: Sdf.Path, sample: Sample) -> UsdGeom.Mesh:
    """Topology, points, normals, texture coordinates, display color and extent."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    faces = sample.mesh.faces
    points = Vt.Vec3fArray.FromNumpy(rounded(sample.mesh.points, POINT_DECIMALS))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([4] * len(faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(rounded(sample.normals, NORMAL_DECIMALS)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)

    primvars = UsdGeom.PrimvarsAPI(mesh)
    st = primvars.CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    st.Set(Vt.Vec2fArray.FromNumpy(rounded(sample.atlas.values, UV_DECIMALS)))
    st.SetIndices(Vt.IntArray.FromNumpy(sample.atlas.indices.astype(np.int32).ravel()))

    # what clients that draw no materials show
    names = list(sample.looks)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*look.color) for look in sample.looks.values()])
    color = mesh.GetDisplayColorPrimvar()
    if len(names) == 1:
        color.SetInterpolation(UsdGeom.Tokens.constant)
    else:
        color.SetInterpolation(UsdGeom.Tokens.uniform)
        color.SetIndices(Vt.IntArray([names.index(part) for part in sample.mesh.parts]))
    return mesh


def define_plain(
    stage: Usd.Stage,
    path: Sdf.Path | str,
    points: NDArray[np.float64],
    counts: NDArray[np.int64],
    indices: NDArray[np.int64],
    normals: NDArray[np.float64],
    color: Sequence[float],
) -> UsdGeom.Mesh:
    """A mesh without textures; normals are of its points, or of the corners of its faces."""
    mesh, tokens = UsdGeom.Mesh.Define(stage, path), UsdGeom.Tokens
    mesh.CreateSubdivisionSchemeAttr(tokens.none)
    values = Vt.Vec3fArray.FromNumpy(rounded(points, 4))
    mesh.CreatePointsAttr(values)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts.astype(np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices.astype(np.int32)))
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(values))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(rounded(normals, NORMAL_DECIMALS)))
    smooth = len(normals) == len(points)
    mesh.SetNormalsInterpolation(tokens.vertex if smooth else tokens.faceVarying)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*color)])
    return mesh


def collide(prim: Usd.Prim, *, kinematic: bool = False) -> None:
    """Make a prim a collider, a mesh by its own triangles."""
    UsdPhysics.CollisionAPI.Apply(prim)
    if kinematic:
        UsdPhysics.RigidBodyAPI.Apply(prim).CreateKinematicEnabledAttr(True)
    if prim.IsA(UsdGeom.Mesh):
        UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.none)


def define_material(stage: Usd.Stage, path: Sdf.Path, look: Look) -> UsdShade.Material:
    """A material whose surface is one UsdPreviewSurface."""
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    values = Sdf.ValueTypeNames
    shader.CreateInput("diffuseColor", values.Color3f).Set(Gf.Vec3f(*look.color))
    shader.CreateInput("roughness", values.Float).Set(look.roughness)
    shader.CreateInput("clearcoat", values.Float).Set(look.clearcoat)
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", values.Token))
    return material


def bind_by_part(
    mesh: UsdGeom.Mesh, parts: NDArray[np.str_], materials: Mapping[str, UsdShade.Material]
) -> None:
    """A GeomSubset for each part; together they are a partition of the faces."""
    family = UsdShade.Tokens.materialBind
    for part, material in materials.items():
        faces = Vt.IntArray.FromNumpy(np.flatnonzero(parts == part).astype(np.int32))
        subset = UsdGeom.Subset.CreateGeomSubset(mesh, part, UsdGeom.Tokens.face, faces, family)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    UsdGeom.Subset.SetFamilyType(mesh, family, UsdGeom.Tokens.partition)


def file_name(sample: Sample) -> str:
    """``DeformedSphere`` is kept in ``deformed_sphere.usda``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", sample.name).lower() + ".usda"

"""A Surface as a picture shows it: colours, textures, roughness and metal at each triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from gf_usd.model import Floats, Surface, Texture
from gf_usd.scene import RenderMesh

GREY = 0.5  # linear, where nothing says a colour
FINISH = (0.5, 0.0)  # fallbacks of UsdPreviewSurface's roughness and metallic
CREASE = 50.0  # [deg] of computed normals: between a fine tessellation and a box
CREASE_SUBDIVIDED = 80.0  # [deg] for the cage of a subdivision surface, which is coarser


def to_render_mesh(surface: Surface, stage: Usd.Stage, time: Usd.TimeCode) -> RenderMesh:
    """The triangles of a surface with what is bound to them."""
    count = len(surface.triangles)
    colours = np.full((count, 3, 3), GREY)
    if surface.triangle_colours is not None:
        colours = np.array(surface.triangle_colours, dtype=np.float64)
    skin = np.full(count, -1)
    finish = np.tile(FINISH, (count, 1))
    textures: list[Texture] = []
    if surface.triangle_materials is not None:
        for i, material in enumerate(surface.materials):
            mine = np.asarray(surface.triangle_materials) == i
            finish[mine] = _finish(stage, material.path, time)
            if material.texture is not None:
                skin[mine] = len(textures)
                textures.append(material.texture)
            else:
                colours[mine] = material.colour
    return RenderMesh(
        name=surface.path,
        points=surface.points,
        triangles=surface.triangles,
        normals=_corner_normals(surface),
        crease_angle=_crease(stage.GetPrimAtPath(surface.path)),
        colours=colours,
        uvs=surface.triangle_uvs,
        textures=tuple(textures),
        triangle_textures=skin,
        roughness=finish[:, 0],
        metallic=finish[:, 1],
    )


def _corner_normals(surface: Surface) -> Floats | None:
    """(T, 3, 3) of authored normals; None where there are none."""
    if surface.normals is None:
        return None
    values, corners = np.asarray(surface.normals), np.asarray(surface.triangle_corners)
    if surface.normals_interpolation == "faceVarying":
        return values[corners]
    if surface.normals_interpolation == "uniform":
        ends = np.cumsum(surface.face_counts)
        faces: NDArray[np.int64] = np.searchsorted(ends, corners[:, 0], side="right")
        return np.repeat(values[faces][:, None, :], 3, axis=1)
    return values[np.asarray(surface.triangles)]


def _crease(prim: Usd.Prim) -> float:
    mesh = UsdGeom.Mesh(prim)
    if not mesh or mesh.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.none:
        return CREASE
    return CREASE_SUBDIVIDED


def _finish(stage: Usd.Stage, path: str, time: Usd.TimeCode) -> tuple[float, float]:
    """Roughness and metallic of a UsdPreviewSurface, where they are constants."""
    material = UsdShade.Material(stage.GetPrimAtPath(path))
    shader = material.ComputeSurfaceSource()[0] if material else None
    if not shader or shader.GetShaderId() != "UsdPreviewSurface":
        return FINISH
    found = [
        _constant(shader.GetInput(name), time, fallback)
        for name, fallback in zip(("roughness", "metallic"), FINISH)
    ]
    return found[0], found[1]


def _constant(shader_input: UsdShade.Input, time: Usd.TimeCode, fallback: float) -> float:
    """The input's number in 0..1; the fallback where a texture feeds it."""
    if not shader_input:
        return fallback
    for attribute in shader_input.GetValueProducingAttributes():
        if not UsdShade.Output.IsOutput(attribute):
            value = attribute.Get(time)
            number = fallback if value is None else float(value)
            return min(1.0, max(0.0, number)) if np.isfinite(number) else fallback
    return fallback

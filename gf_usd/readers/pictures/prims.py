"""Prims of a stage for rendering at one time: Gaussians, points, and surfaces with shading."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import NO_COLOR, Surface, Texture
from gf_usd.core.matrices import gaussian_axes
from gf_usd.core.radiance import srgb_to_linear
from gf_usd.core.scene import Harmonics, RenderEllipsoids, RenderMesh, RenderSplats
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.stage import Placement, SkippedPrim, is_bake_particles

LEFT_OUT = "not drawn: "  # a note, with a type
Y_0 = 0.28209479177387814  # the value of the spherical harmonic of degree 0


def stands_for_meshes(prim: Usd.Prim) -> bool:
    """True for points of flowing bodies, which a bake shows in addition to meshes."""
    named = prim.HasRelationship("gaussianFlesh:sourceMeshes")
    return prim.IsA(UsdGeom.Points) and named and not is_bake_particles(prim)


def placed_prims(stage: Usd.Stage, notes: Notes) -> Iterator[Usd.Prim]:
    """Every prim of a stage, instances seen as prims, but none below a PointInstancer.

    Prototypes there stand nowhere by themselves.  Each instancer gets a note, and so does geometry
    that is not drawn.
    """
    walk = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in walk:
        instancer = prim.IsA(UsdGeom.PointInstancer)
        if instancer or (_is_undrawn(prim) and _is_rendered(prim)):
            notes.add(f"{LEFT_OUT}{prim.GetTypeName()}", str(prim.GetPath()))
        if instancer:
            walk.PruneChildren()
        yield prim


def _is_undrawn(prim: Usd.Prim) -> bool:
    """Geometry of which nothing here makes triangles, such as hair."""
    return prim.IsA(UsdGeom.Curves) or prim.IsA(UsdGeom.NurbsPatch)


def _is_rendered(prim: Usd.Prim) -> bool:
    """Whether a prim is meant for pictures: no guide, such as the controls of a rig, nor hidden."""
    image = UsdGeom.Imageable(prim)
    shown = image.ComputeVisibility(Usd.TimeCode.EarliestTime()) != UsdGeom.Tokens.invisible
    purposes = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
    return shown and image.ComputePurpose() in purposes


def read_splats(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    place: Placement,
    unit: float,
    notes: Notes,
    measured: Floats | None = None,
) -> RenderSplats:
    """The Gaussians of a ParticleField3DGaussianSplat, world, in meters; `measured` (N,) as well.

    Raises SkippedPrim where there are none, or where an array has another length than positions.
    """
    where = str(prim.GetPath())
    positions = _either(prim, "positions", time, 3)
    if positions is None or len(positions) == 0:
        raise SkippedPrim("has no positions")
    count = len(positions)
    orientations = _either(prim, "orientations", time, 4)
    scales = _either(prim, "scales", time, 3)
    opacities = _either(prim, "opacities", time, 1)
    for name, values in (("orientations", orientations), ("scales", scales)):
        if values is None or len(values) != count:
            have = 0 if values is None else len(values)
            raise SkippedPrim(f"has {count} positions but {have} {name}")
    if opacities is None or len(opacities) != count:
        opacities = np.ones((count, 1))
    assert orientations is not None
    assert scales is not None
    # numpy sees a quaternion as (x, y, z, w)
    local = gaussian_axes(orientations[:, [3, 0, 1, 2]], scales)
    linear = place.matrix[:3, :3].T * unit
    harmonics = _harmonics(prim, time, count, place, notes)
    base = 0.5 + Y_0 * harmonics.coefficients[:, 0]
    colors = srgb_to_linear(base) if harmonics.srgb else base
    finite = np.isfinite(positions).all(axis=1) & np.isfinite(local).all(axis=(1, 2))
    finite &= np.isfinite(harmonics.coefficients).all(axis=(1, 2)) & np.isfinite(opacities[:, 0])
    if not finite.all():
        notes.add(
            f"{int((~finite).sum())} of {count} Gaussians are not finite and are left out", where
        )
    coefficients = harmonics.coefficients[finite]
    return RenderSplats(
        name=where,
        positions=place.points(positions[finite]) * unit,
        axes=linear @ local[finite],
        colors=np.maximum(colors[finite], 0.0),
        opacities=np.clip(opacities[finite, 0], 0.0, 1.0),
        lit=is_bake_particles(prim),
        harmonics=None
        if coefficients.shape[1] == 1
        else Harmonics(coefficients=coefficients, frame=harmonics.frame, srgb=harmonics.srgb),
        values=None if measured is None else measured[finite],
    )


def as_ellipsoids(splats: RenderSplats) -> RenderEllipsoids:
    """One ellipsoid at one standard deviation for each Gaussian."""
    # a disc that is thinner than this has no inverse in single precision
    size = np.linalg.norm(splats.axes, axis=1)
    longest = size.max(axis=1, keepdims=True)
    grown = np.maximum(size, 1e-3 * longest) / np.where(size > 0.0, size, 1.0)
    keep = (size > 0.0).all(axis=1)
    return RenderEllipsoids(
        name=splats.name,
        positions=splats.positions[keep],
        axes=(splats.axes * grown[:, None, :])[keep],
        colors=splats.colors[keep],
        values=None if splats.values is None else splats.values[keep],
    )


def read_points(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    place: Placement,
    unit: float,
    notes: Notes,
    measured: Floats | None = None,
) -> RenderEllipsoids:
    """The Points of a prim as balls of their widths, world, in meters; `measured` (N,) as well.

    Raises SkippedPrim where there are none.
    """
    where, points = str(prim.GetPath()), UsdGeom.Points(prim)
    values = points.GetPointsAttr().Get(time)
    positions = np.asarray([] if values is None else values, dtype=np.float64).reshape(-1, 3)
    if len(positions) == 0:
        raise SkippedPrim("has no points")
    count = len(positions)
    widths = points.GetWidthsAttr().Get(time)
    width = np.asarray([] if widths is None else widths, dtype=np.float64)
    if len(width) not in (1, count):
        size = float(np.ptp(positions, axis=0).max())
        notes.add("has no usable widths: 1/100 of its size is used", where)
        width = np.array([0.01 * size])
    colors = _display_colors(prim, time, count)
    radius = 0.5 * np.broadcast_to(width, (count,))
    keep = np.isfinite(positions).all(axis=1) & (radius > 0.0)
    if not keep.all():
        notes.add(f"{int((~keep).sum())} of {count} points are not finite or have no width", where)
    linear = place.matrix[:3, :3].T * unit
    return RenderEllipsoids(
        name=where,
        positions=place.points(positions[keep]) * unit,
        axes=linear * radius[keep, None, None],
        colors=colors[keep],
        values=None if measured is None else measured[keep],
    )


def _either(prim: Usd.Prim, name: str, time: Usd.TimeCode, width: int) -> Floats | None:
    """(n, width) of an attribute, or of its half-precision twin; None where neither has values."""
    for attribute in (prim.GetAttribute(name), prim.GetAttribute(f"{name}h")):
        values = attribute.Get(time) if attribute else None
        if values is not None and len(values):
            return np.asarray(values, dtype=np.float64).reshape(-1, width)
    return None


def _harmonics(
    prim: Usd.Prim, time: Usd.TimeCode, count: int, place: Placement, notes: Notes
) -> Harmonics:
    """Coefficients (N, K, 3); too few for the stated degree are ignored, as UsdVol says."""
    name = "radiance:sphericalHarmonicsCoefficients"
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get(time)
    each = (1 + int(degree or 0)) ** 2
    values = _either(prim, name, time, 3)
    srgb = False
    if values is None or len(values) < count * each:
        if values is not None:
            notes.add(
                f"{len(values)} spherical harmonics coefficients are fewer than {each} for each "
                f"of {count} Gaussians: gray is used",
                str(prim.GetPath()),
            )
        coefficients = np.zeros((count, 1, 3))
    else:
        coefficients = values[: count * each].reshape(count, each, 3)
        srgb = _is_srgb(prim, notes)
    turn = place.matrix[:3, :3].T
    rotation = turn / np.cbrt(abs(np.linalg.det(turn)))
    return Harmonics(coefficients=coefficients, frame=np.linalg.inv(rotation), srgb=srgb)


def _is_srgb(prim: Usd.Prim, notes: Notes) -> bool:
    """How radiance is encoded: as the color space says; bakes of ours are linear."""
    attribute = prim.GetAttribute("radiance:sphericalHarmonicsCoefficients")
    space = str(Usd.ColorSpaceAPI.ComputeColorSpaceName(attribute, None) or "")
    if not space and not is_bake_particles(prim):
        notes.add(
            "no color space is authored: sRGB is assumed, as in captured Gaussians",
            str(prim.GetPath()),
        )
        return True
    return space.startswith("srgb")


def _display_colors(prim: Usd.Prim, time: Usd.TimeCode, count: int) -> Floats:
    """(N, 3) of displayColor, constant or one a point; gray where it is missing."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    flat = primvar.ComputeFlattened(time) if primvar and primvar.HasValue() else None
    values = np.asarray([] if flat is None else flat, dtype=np.float64).reshape(-1, 3)
    if len(values) not in (1, count) or not np.isfinite(values).all():
        values = np.array([NO_COLOR])
    return np.broadcast_to(values, (count, 3))


FINISH = (0.5, 0.0)  # fallbacks of UsdPreviewSurface's roughness and metallic
CREASE = 50.0  # [deg] of computed normals: between a fine tessellation and a box
CREASE_SUBDIVIDED = 80.0  # [deg] for the cage of a subdivision surface, which is coarser


def to_render_mesh(surface: Surface, stage: Usd.Stage, time: Usd.TimeCode) -> RenderMesh:
    """The triangles of a surface with what is bound to them."""
    count = len(surface.triangles)
    colors = np.tile(NO_COLOR, (count, 3, 1))
    if surface.triangle_colors is not None:
        colors = np.array(surface.triangle_colors, dtype=np.float64)
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
                colors[mine] = material.color
    return RenderMesh(
        name=surface.path,
        points=surface.points,
        triangles=surface.triangles,
        normals=_corner_normals(surface),
        crease_angle=_crease(stage.GetPrimAtPath(surface.path)),
        colors=colors,
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

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

NOT_DRAWN = "not drawn: "  # a note, with a type
Y_0 = 0.28209479177387814  # the value of the spherical harmonic of degree 0


def replaces_meshes(prim: Usd.Prim) -> bool:
    """Whether a prim is Points of a flowing body, which a bake writes in addition to meshes."""
    named = prim.HasRelationship("gaussianFlesh:sourceMeshes")
    return prim.IsA(UsdGeom.Points) and named and not is_bake_particles(prim)


def baked_bodies(stage: Usd.Stage) -> set[str]:
    """Paths of all that a bake moves: its meshes, and the particles that show them."""
    found: set[str] = set()
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if relation := prim.GetRelationship("gaussianFlesh:sourceMeshes"):
            found.update(str(path) for path in relation.GetForwardedTargets())
            found.add(str(prim.GetPath()))
    return found


def placed_prims(stage: Usd.Stage, notes: Notes) -> Iterator[Usd.Prim]:
    """All prims of a stage including instance proxies, without descendants of PointInstancers.

    These are prototypes, which have no position of their own.  Instancers and geometry of types
    that are not drawn are noted.
    """
    walk = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in walk:
        instancer = prim.IsA(UsdGeom.PointInstancer)
        if instancer or (_is_undrawn(prim) and _is_rendered(prim)):
            notes.add(f"{NOT_DRAWN}{prim.GetTypeName()}", str(prim.GetPath()))
        if instancer:
            walk.PruneChildren()
        yield prim


def _is_undrawn(prim: Usd.Prim) -> bool:
    """Whether a prim is geometry of a type without a renderer: curves and patches."""
    return prim.IsA(UsdGeom.Curves) or prim.IsA(UsdGeom.NurbsPatch)


def _is_rendered(prim: Usd.Prim) -> bool:
    """Whether a prim is visible and its purpose is default or render."""
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
    """The Gaussians of a ParticleField3DGaussianSplat in world space, meters.

    measured : (N,) values of a quantity.

    Raises SkippedPrim where there are none, or the lengths of arrays differ.
    """
    path = str(prim.GetPath())
    positions = read_float_or_half(prim, "positions", time, 3)
    if positions is None or len(positions) == 0:
        raise SkippedPrim("has no positions")
    count = len(positions)
    orientations = read_float_or_half(prim, "orientations", time, 4)
    scales = read_float_or_half(prim, "scales", time, 3)
    opacities = read_float_or_half(prim, "opacities", time, 1)
    for name, values in (("orientations", orientations), ("scales", scales)):
        if values is None or len(values) != count:
            found = 0 if values is None else len(values)
            raise SkippedPrim(f"has {count} positions but {found} {name}")
    if opacities is None or len(opacities) != count:
        opacities = np.ones((count, 1))
    assert orientations is not None
    assert scales is not None
    # NumPy views a Gf quaternion as (x, y, z, w)
    local = gaussian_axes(orientations[:, [3, 0, 1, 2]], scales)
    linear = place.matrix[:3, :3].T * unit
    harmonics = _harmonics(prim, time, count, place, notes)
    degree_0 = 0.5 + Y_0 * harmonics.coefficients[:, 0]
    colors = srgb_to_linear(degree_0) if harmonics.srgb else degree_0
    finite = np.isfinite(positions).all(axis=1) & np.isfinite(local).all(axis=(1, 2))
    finite &= np.isfinite(harmonics.coefficients).all(axis=(1, 2)) & np.isfinite(opacities[:, 0])
    if not finite.all():
        notes.add(
            f"{int((~finite).sum())} of {count} Gaussians are not finite and are left out", path
        )
    coefficients = harmonics.coefficients[finite]
    return RenderSplats(
        name=path,
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
    """Gaussians as ellipsoids of one standard deviation."""
    # the axes of thinner discs are singular in single precision
    lengths = np.linalg.norm(splats.axes, axis=1)
    longest = lengths.max(axis=1, keepdims=True)
    scale = np.maximum(lengths, 1e-3 * longest) / np.where(lengths > 0.0, lengths, 1.0)
    keep = (lengths > 0.0).all(axis=1)
    return RenderEllipsoids(
        name=splats.name,
        positions=splats.positions[keep],
        axes=(splats.axes * scale[:, None, :])[keep],
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
    """A Points prim as balls of its widths in world space, meters.

    measured : (N,) values of a quantity.

    Raises SkippedPrim where there are no points.
    """
    path, points = str(prim.GetPath()), UsdGeom.Points(prim)
    values = points.GetPointsAttr().Get(time)
    positions = np.asarray([] if values is None else values, dtype=np.float64).reshape(-1, 3)
    if len(positions) == 0:
        raise SkippedPrim("has no points")
    count = len(positions)
    widths = points.GetWidthsAttr().Get(time)
    width = np.asarray([] if widths is None else widths, dtype=np.float64)
    if len(width) not in (1, count):
        size = float(np.ptp(positions, axis=0).max())
        notes.add("has no usable widths: 1/100 of its size is used", path)
        width = np.array([0.01 * size])
    colors = _display_colors(prim, time, count)
    radius = 0.5 * np.broadcast_to(width, (count,))
    keep = np.isfinite(positions).all(axis=1) & (radius > 0.0)
    if not keep.all():
        notes.add(f"{int((~keep).sum())} of {count} points are not finite or have no width", path)
    linear = place.matrix[:3, :3].T * unit
    return RenderEllipsoids(
        name=path,
        positions=place.points(positions[keep]) * unit,
        axes=linear * radius[keep, None, None],
        colors=colors[keep],
        values=None if measured is None else measured[keep],
    )


def read_float_or_half(prim: Usd.Prim, name: str, time: Usd.TimeCode, width: int) -> Floats | None:
    """Values (n, width) of an attribute or its half-precision variant; None without values."""
    for attribute in (prim.GetAttribute(name), prim.GetAttribute(f"{name}h")):
        values = attribute.Get(time) if attribute else None
        if values is not None and len(values):
            return np.asarray(values, dtype=np.float64).reshape(-1, width)
    return None


def _harmonics(
    prim: Usd.Prim, time: Usd.TimeCode, count: int, place: Placement, notes: Notes
) -> Harmonics:
    """Coefficients (N, K, 3); ignored where too few for the authored degree, as in UsdVol."""
    name = "radiance:sphericalHarmonicsCoefficients"
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get(time)
    per_gaussian = (1 + int(degree or 0)) ** 2
    values = read_float_or_half(prim, name, time, 3)
    srgb = False
    if values is None or len(values) < count * per_gaussian:
        if values is not None:
            notes.add(
                f"{len(values)} spherical harmonics coefficients are fewer than {per_gaussian} for "
                f"each of {count} Gaussians: gray is used",
                str(prim.GetPath()),
            )
        coefficients = np.zeros((count, 1, 3))
    else:
        coefficients = values[: count * per_gaussian].reshape(count, per_gaussian, 3)
        srgb = _is_srgb(prim, notes)
    linear = place.matrix[:3, :3].T
    rotation = linear / np.cbrt(abs(np.linalg.det(linear)))
    return Harmonics(coefficients=coefficients, frame=np.linalg.inv(rotation), srgb=srgb)


def _is_srgb(prim: Usd.Prim, notes: Notes) -> bool:
    """Whether radiance is sRGB-encoded, by its color space; that of our bakes is linear."""
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
    """displayColor (N, 3), constant or per point; gray where it is missing."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    flat = primvar.ComputeFlattened(time) if primvar and primvar.HasValue() else None
    values = np.asarray([] if flat is None else flat, dtype=np.float64).reshape(-1, 3)
    if len(values) not in (1, count) or not np.isfinite(values).all():
        values = np.array([NO_COLOR])
    return np.broadcast_to(values, (count, 3))


DEFAULT_ROUGHNESS_METALLIC = (0.5, 0.0)  # fallbacks of UsdPreviewSurface's roughness and metallic
CREASE = 50.0  # [deg] of computed normals: between a fine tessellation and a box
CREASE_SUBDIVIDED = 80.0  # [deg] for the cage of a subdivision surface, which is coarser


def to_render_mesh(surface: Surface, stage: Usd.Stage, time: Usd.TimeCode) -> RenderMesh:
    """The triangles of a surface with the materials bound to them, at a time."""
    count = len(surface.triangles)
    colors = np.tile(NO_COLOR, (count, 3, 1))
    if surface.triangle_colors is not None:
        colors = np.array(surface.triangle_colors, dtype=np.float64)
    texture_indices = np.full(count, -1)
    roughness_metallic = np.tile(DEFAULT_ROUGHNESS_METALLIC, (count, 1))
    textures: list[Texture] = []
    if surface.triangle_materials is not None:
        for i, material in enumerate(surface.materials):
            bound = np.asarray(surface.triangle_materials) == i
            roughness_metallic[bound] = _roughness_metallic(stage, material.path, time)
            if material.texture is not None:
                texture_indices[bound] = len(textures)
                textures.append(material.texture)
            else:
                colors[bound] = material.color
    return RenderMesh(
        name=surface.path,
        points=surface.points,
        triangles=surface.triangles,
        normals=_corner_normals(surface),
        crease_angle=_crease_angle(stage.GetPrimAtPath(surface.path)),
        colors=colors,
        uvs=surface.triangle_uvs,
        textures=tuple(textures),
        triangle_textures=texture_indices,
        roughness=roughness_metallic[:, 0],
        metallic=roughness_metallic[:, 1],
    )


def _corner_normals(surface: Surface) -> Floats | None:
    """Authored normals (T, 3, 3) at triangle corners; None without any."""
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


def _crease_angle(prim: Usd.Prim) -> float:
    mesh = UsdGeom.Mesh(prim)
    if not mesh or mesh.GetSubdivisionSchemeAttr().Get() == UsdGeom.Tokens.none:
        return CREASE
    return CREASE_SUBDIVIDED


def _roughness_metallic(stage: Usd.Stage, path: str, time: Usd.TimeCode) -> tuple[float, float]:
    """Roughness and metallic of a UsdPreviewSurface, where they are constants."""
    material = UsdShade.Material(stage.GetPrimAtPath(path))
    shader = material.ComputeSurfaceSource()[0] if material else None
    if not shader or shader.GetShaderId() != "UsdPreviewSurface":
        return DEFAULT_ROUGHNESS_METALLIC
    found = [
        _constant(shader.GetInput(name), time, fallback)
        for name, fallback in zip(("roughness", "metallic"), DEFAULT_ROUGHNESS_METALLIC)
    ]
    return found[0], found[1]


def _constant(shader_input: UsdShade.Input, time: Usd.TimeCode, fallback: float) -> float:
    """The constant value of an input, clamped to 0..1; the fallback for a connected texture."""
    if not shader_input:
        return fallback
    for attribute in shader_input.GetValueProducingAttributes():
        if not UsdShade.Output.IsOutput(attribute):
            value = attribute.Get(time)
            number = fallback if value is None else float(value)
            return min(1.0, max(0.0, number)) if np.isfinite(number) else fallback
    return fallback

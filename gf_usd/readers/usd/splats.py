"""Captured Gaussians: reading and writing of ParticleField3DGaussianSplat prims.

Attributes may be authored in float or in half precision; float is preferred, as in UsdVol.
Missing attributes have UsdVol's fallbacks: no rotation, unit scale, opaque, gray.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdVol, Vt

from gf_usd.core.arrays import Ints
from gf_usd.core.asset import Splats, free_name, prim_name, valid_gaussians
from gf_usd.core.errors import InputError
from gf_usd.readers.notes import ANIMATED, Notes
from gf_usd.readers.usd.stage import SPLAT_TYPE, Placement, SkippedPrim, is_bake_particles

Types = Sdf.ValueTypeNames
HARMONICS = "radiance:sphericalHarmonicsCoefficients"
WHOLE = (Types.IntArray, Types.UIntArray, Types.Int64Array, Types.UInt64Array, Types.UCharArray)
DEGREE = "radiance:sphericalHarmonicsDegree"
WIDTHS = {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1, HARMONICS: 3}


def is_captured(prim: Usd.Prim) -> bool:
    """True for Gaussians that were not written by a bake."""
    return str(prim.GetTypeName()) == SPLAT_TYPE and not is_bake_particles(prim)


def read_captured(
    prim: Usd.Prim, time: Usd.TimeCode, matrix: Gf.Matrix4d, unit: float, notes: Notes
) -> Splats:
    """The Gaussians of a prim, in its local space.

    matrix : local-to-world transform; unit : [m] per stage length.

    Raises SkippedPrim where there are none, and InputError where all have invalid values.
    """
    where = str(prim.GetPath())
    positions = _values(prim, "positions", time)
    if positions is None:
        raise SkippedPrim("has no positions")
    count = len(positions)
    found = {"positions": positions}
    for name, fallback in (
        ("orientations", (0.0, 0.0, 0.0, 1.0)),  # (x, y, z, w) in NumPy
        ("scales", (1.0, 1.0, 1.0)),
        ("opacities", (1.0,)),
    ):
        found[name] = _fitting(prim, name, time, count, fallback, notes)
    place = Placement.of(matrix)
    to_world = place.matrix @ np.diag([unit, unit, unit, 1.0])
    harmonics, half = _harmonics(prim, time, count, notes)
    if prim.GetAttribute("positions").ValueMightBeTimeVarying():
        notes.add(ANIMATED, where)
    splats = Splats(
        positions=positions,
        orientations=found["orientations"][:, [3, 0, 1, 2]],
        scales=found["scales"],
        opacities=found["opacities"][:, 0],
        harmonics=harmonics,
        path=where,
        to_world=to_world,
        half=half,
        labels=_labels(prim, time, count),
    )
    whole = valid_gaussians(splats, where, lambda text: notes.add(text, where))
    if len(whole) != count:
        # The cache layer overrides this prim, so that its arrays must keep their length.
        raise InputError(
            f"<{where}>: {count - len(whole)} of its {count} Gaussians are not finite or have a "
            "scale of 0 or less",
            "remove them in the program that made the file",
        )
    return whole


def _values(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> NDArray[np.floating] | None:
    """(n, k) values of an attribute or its half-precision variant; None where neither has any."""
    for attribute in (prim.GetAttribute(name), prim.GetAttribute(f"{name}h")):
        values = attribute.Get(time) if attribute else None
        if values is not None and len(values):
            return np.asarray(values).reshape(-1, WIDTHS[name])
    return None


def _fitting(
    prim: Usd.Prim, name: str, time: Usd.TimeCode, count: int, fallback: tuple, notes: Notes
) -> NDArray[np.floating]:
    """(count, k) values of an attribute, truncated if too long; `fallback` if too short."""
    values = _values(prim, name, time)
    if values is not None and len(values) >= count:
        return values[:count]
    if values is not None:
        notes.add(f"{len(values)} {name} for {count} positions are ignored", str(prim.GetPath()))
    return np.tile(np.asarray(fallback, np.float32), (count, 1))


def _harmonics(
    prim: Usd.Prim, time: Usd.TimeCode, count: int, notes: Notes
) -> tuple[NDArray[np.floating], bool]:
    """Spherical harmonics coefficients (count, K, 3), and whether they are in half precision."""
    degree = int(prim.GetAttribute(DEGREE).Get(time) or 0)
    each = (1 + degree) ** 2
    values = _values(prim, HARMONICS, time)
    half = values is not None and values.dtype == np.float16
    if values is not None and len(values) >= count * each:
        return values[: count * each].reshape(count, each, 3), half
    if values is not None:
        notes.add(
            f"{len(values)} spherical harmonics coefficients are fewer than {each} for each of "
            f"{count} Gaussians: gray is used",
            str(prim.GetPath()),
        )
    return np.zeros((count, 1, 3), np.float32), half


def _labels(prim: Usd.Prim, time: Usd.TimeCode, count: int) -> dict[str, Ints]:
    """The integer primvars of a prim with one value for each Gaussian."""
    found = {}
    for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues():
        flat = primvar.ComputeFlattened(time)
        if flat is None or primvar.GetTypeName() not in WHOLE or len(flat) != count:
            continue
        found[str(primvar.GetPrimvarName())] = np.asarray(flat).astype(np.int64)
    return found


def write_splat_layer(
    splats: Splats, path: Path, name: str, *, meters_per_unit: float, up_axis: str, turn: float = 0
) -> None:
    """Write the USD layer of a splat file: a component with one ParticleField3DGaussianSplat.

    turn : [degrees] rotation about x, authored as a transform of its parent.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    UsdGeom.SetStageUpAxis(stage, up_axis)
    root = UsdGeom.Xform.Define(stage, f"/{prim_name(name or 'splats')}")
    Usd.ModelAPI(root.GetPrim()).SetKind(Kind.Tokens.component)
    if root.GetPrim().GetName() != name:
        root.GetPrim().SetDisplayName(name)
    stage.SetDefaultPrim(root.GetPrim())
    if turn:
        root.AddRotateXOp().Set(turn)
    where = root.GetPath().AppendChild("Splats")
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, where).GetPrim()
    at = np.asarray(splats.positions, np.float32)
    values = (
        ("positions", Types.Point3fArray, Vt.Vec3fArray.FromNumpy(_f32(at))),
        ("orientations", Types.QuatfArray, quaternions(splats.orientations)),
        ("scales", Types.Float3Array, Vt.Vec3fArray.FromNumpy(_f32(splats.scales))),
        ("opacities", Types.FloatArray, Vt.FloatArray.FromNumpy(_f32(splats.opacities))),
        (HARMONICS, Types.Float3Array,
         Vt.Vec3fArray.FromNumpy(_f32(splats.harmonics.reshape(-1, 3)))),
    )  # fmt: skip
    for attribute, kind, value in values:
        prim.CreateAttribute(attribute, kind, False).Set(value)
    api = UsdGeom.PrimvarsAPI(prim)
    for label, whole in splats.labels.items():
        name = free_name(prim_name(label), api.HasPrimvar)
        api.CreatePrimvar(name, Types.IntArray, UsdGeom.Tokens.vertex).Set(
            Vt.IntArray.FromNumpy(np.ascontiguousarray(whole, np.int32))
        )
    degree = prim.CreateAttribute(DEGREE, Types.Int, False, Sdf.VariabilityUniform)
    degree.Set(splats.degree)
    reach = 3.0 * np.linalg.norm(splats.axes, axis=2)
    box = np.stack([(splats.points - reach).min(0), (splats.points + reach).max(0)])
    UsdGeom.Boundable(prim).CreateExtentAttr(Vt.Vec3fArray.FromNumpy(_f32(box)))
    stage.GetRootLayer().Save()


def quaternions(wxyz: NDArray[np.floating]) -> Vt.QuatfArray:
    """USD quaternions from (n, 4) w, x, y, z; `FromNumpy` expects x, y, z, w."""
    return Vt.QuatfArray.FromNumpy(_f32(np.asarray(wxyz)[:, [1, 2, 3, 0]]))


def _f32(values: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)

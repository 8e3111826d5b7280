"""The surface of a flowing body: a Mesh with a different topology at every time sample.

USD interpolates arrays of equal length between samples and holds others.  Two frames may have the
same number of points although their faces differ; interpolated points would then be torn, so
the later frame has its last point twice, the second not used by any face.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade, Vt

from gf_usd.core.arrays import Floats, corners
from gf_usd.core.asset import Asset
from gf_usd.core.frames.frame import SurfacePose
from gf_usd.layers.stage import box, f32
from gf_usd.layers.tracks.meshes import check
from gf_usd.layers.tracks.sparse import Saved


def flow_name(body: int) -> str:
    """Name of the prim of a body's surface, in the scope of the particles."""
    return f"Surface{body}" if body else "Surface"


def flow_shading(asset: Asset, replaced: Sequence[str], root: Sdf.Path) -> Sdf.Path | None:
    """The material of the meshes that a surface replaces, where they share one.

    None where they have several, where it reads a texture, for which a surface has no coordinates,
    and where it is outside the root prim, to which a payload cannot refer.
    """
    found = {
        material.path if material.texture is None else ""
        for surface in asset.surfaces
        if surface.path in replaced
        for material in surface.materials
    }
    path = Sdf.Path(found.pop()) if len(found) == 1 and "" not in found else None
    return path if path is not None and path.HasPrefix(root) else None


class FlowTrack:
    """Writes one surface.

    Parameters
    ----------
    cache, path : stage and prim path of the Mesh.
    meters_per_unit : [m] per stage length.
    origin : (3,) [stage units] origin of the points.
    shading : a material of the source that is bound; None: displayColor only.
    velocities : whether they are written.
    """

    def __init__(
        self,
        cache: Usd.Stage,
        path: Sdf.Path,
        meters_per_unit: float,
        origin: Floats,
        *,
        shading: Sdf.Path | None = None,
        velocities: bool = True,
    ) -> None:
        mesh = UsdGeom.Mesh.Define(cache, path)
        self.path, self.prim = path, mesh.GetPrim()
        self.low = self.high = np.zeros(3)
        self.empty = False
        self.saved = Saved()
        self._unit, self._origin = meters_per_unit, np.asarray(origin, np.float64)
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        self._points = mesh.CreatePointsAttr()
        self._counts = mesh.CreateFaceVertexCountsAttr()
        self._indices = mesh.CreateFaceVertexIndicesAttr()
        self._normals = mesh.CreateNormalsAttr()
        self._extent = mesh.CreateExtentAttr()
        self._velocities = mesh.CreateVelocitiesAttr() if velocities else None
        self._color = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        self._last, self._faces, self._padded = 0, "", 0  # points and faces of the last sample
        if shading is not None:
            # by path only: the source is not in the cache
            UsdShade.MaterialBindingAPI.Apply(self.prim)
            self.prim.CreateRelationship("material:binding", False).SetTargets([shading])

    def write(self, pose: SurfacePose, time_code: float) -> None:
        """Author a surface at a time code.

        Raises BakeError where an array has another length than the points or is not finite.
        """
        count = len(pose.points)
        for name in ("points", "velocities", "normals", "colors"):
            what = f"{name} of <{self.path}>"
            check(getattr(pose, name), (count, 3), what, time_code)
        indices = np.ascontiguousarray(pose.triangles, np.int32)
        faces = hashlib.blake2b(indices.data, digest_size=8).hexdigest()
        if faces != self._faces:
            self._padded = int(count == self._last)
        self._last, self._faces = count + self._padded, faces
        points = f32(np.asarray(pose.points, np.float64) / self._unit - self._origin)
        self.empty = count == 0
        if not self.empty:
            self.low, self.high = corners(points)
        self._points.Set(self._vectors(points), time_code)
        self._counts.Set(Vt.IntArray(len(indices), 3), time_code)
        self._indices.Set(Vt.IntArray.FromNumpy(indices.reshape(-1)), time_code)
        self._normals.Set(self._vectors(pose.normals), time_code)
        self._color.Set(self._vectors(pose.colors), time_code)
        self._extent.Set(box(self.low, self.high), time_code)
        velocities = self._vectors(np.asarray(pose.velocities) / self._unit)
        if self._velocities is not None:
            self._velocities.Set(velocities, time_code)
        else:
            single = np.asarray(velocities)
            self.saved.count(single, single.nbytes)

    def state(self) -> dict[str, Any]:
        """The state from which another track of the same bake continues."""
        return {
            "last": [self._last, self._faces, self._padded],
            "saved": asdict(self.saved),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the state of the track that wrote the existing samples."""
        self._last, self._faces, self._padded = state["last"]
        self.saved = Saved(**state["saved"])

    def _vectors(self, rows: Floats) -> Vt.Vec3fArray:
        rows = f32(rows)
        return Vt.Vec3fArray.FromNumpy(np.concatenate([rows, rows[len(rows) - self._padded :]]))

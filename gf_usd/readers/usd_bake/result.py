"""Reading of bake results: particles, meshes and health as arrays, at single time codes.

All values are in SI and in the world frame of the stage; quaternions are (w, x, y, z).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.matrices import gaussian_axes
from gf_usd.core.units import StageUnits
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.extent import frame_times
from gf_usd.readers.pictures.recording import VARIANTS, select_variant, variants_of, world_points
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.solids.tets import boundary
from gf_usd.readers.usd.stage import (
    SPLAT_TYPE,
    Placement,
    is_bake_particles,
    open_stage,
    reading,
    stage_facts,
)

Array = NDArray[np.float64]
NAMESPACE = "gaussianFlesh:"
HEALTH = "gaussianFlesh:health:"
# attribute -> (key, unit of `_size`), of constant values
REST = {
    "restVolumes": ("volumes", "volume"),
    "masses": ("masses", "mass"),
    "youngsModulus": ("youngs_modulus", "pressure"),
    "poissonsRatio": ("poissons_ratio", ""),
    "densities": ("densities", "density"),
}
STRESS, GRADIENTS, VELOCITIES = "vonMisesStress", "deformationGradients", "velocities"


def _is_drawn(prim: Usd.Prim) -> bool:
    """Whether a prim is a mesh of the asset, or a TetMesh, not of purpose guide."""
    made_of_faces = prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.TetMesh)
    guide = UsdGeom.Tokens.guide
    return made_of_faces and UsdGeom.Imageable(prim).ComputePurpose() != guide


class BakedArrays:
    """One variant of a bake, opened for reading.

    Parameters
    ----------
    path : root layer of the bake, or a flattened bake.
    variant : None: the one selected in the file.

    Raises
    ------
    InputError : no such file, not USD, damaged, or not a bake.
    UsageError : the file has no such variant.
    """

    def __init__(self, path: Path, variant: str | None = None) -> None:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            raise InputError(f"{path} {what}", "give the root layer that gf_usd.bake returned")
        self.path: Path = path
        with reading(path):
            self._stage = open_stage(path)
            facts = stage_facts(self._stage, path, Notes(), meters_per_unit=None, up_axis=None)
            self.units: StageUnits = facts.units
            self.up: Array = facts.up
            self.variants: tuple[str, ...] = variants_of(self._stage)
            self.variant: str = select_variant(self._stage, path, variant)
            self._find()
        self.time_codes_per_second: float = float(self._stage.GetTimeCodesPerSecond())

    def _find(self) -> None:
        prims = list(Usd.PrimRange.Stage(self._stage, Usd.TraverseInstanceProxies()))
        clouds = sorted(
            (prim for prim in prims if is_bake_particles(prim)),
            key=lambda prim: str(prim.GetTypeName()) != SPLAT_TYPE,
        )
        self._cloud = clouds[0] if clouds else Usd.Prim()
        self._meshes = {str(p.GetPath()): p for p in prims if _is_drawn(p)}
        self._health = [
            attribute
            for prim in prims
            if prim.HasAttribute(f"{HEALTH}kineticEnergy")
            for attribute in prim.GetPropertiesInNamespace(HEALTH.rstrip(":"))
            if attribute.GetTimeSamples()
        ]
        if not clouds and not self._health:
            raise InputError(
                f"{self.path}: the file contains no bake by gf-usd",
                "give the root layer that gf_usd.bake returned",
            )
        if self._cloud:
            relation = self._cloud.GetRelationship(f"{NAMESPACE}sourceMeshes")
            named = {str(target) for target in relation.GetForwardedTargets()}
            self._meshes = {p: prim for p, prim in self._meshes.items() if not named or p in named}
        moving = [self._cloud] if self._cloud else list(self._meshes.values())
        self.time_codes: tuple[float, ...] = tuple(frame_times(moving))

    @property
    def about(self) -> Mapping[str, Any]:
        """Metadata of this variant in the root layer: settings, materials, command."""
        data = self._stage.GetRootLayer().customLayerData.get(VARIANTS)
        looks = data.get("looks") if isinstance(data, dict) else None
        mine = looks.get(self.variant) if isinstance(looks, dict) else None
        return mine if isinstance(mine, dict) else {}

    @property
    def mesh_paths(self) -> tuple[str, ...]:
        """Paths of the meshes animated by the bake."""
        return tuple(self._meshes)

    def mesh_faces(self, path: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(P,) face vertex counts and (C,) face vertex indices of a mesh.

        Raises UsageError for a path that is not in `mesh_paths`.
        """
        if path not in self._meshes:
            raise UsageError(
                f"{self.path}: no mesh {path!r} is baked",
                f"its meshes are {', '.join(self._meshes) or 'none'}",
            )
        prim = self._meshes[path]
        if prim.IsA(UsdGeom.TetMesh):
            tets = UsdGeom.TetMesh(prim)
            authored = np.array(tets.GetSurfaceFaceVertexIndicesAttr().Get() or [], np.int64)
            indices = np.array(tets.GetTetVertexIndicesAttr().Get(), np.int64)
            triangles = authored if len(authored) else boundary(indices)
            return np.full(len(triangles), 3, np.int64), triangles.reshape(-1)
        mesh = UsdGeom.Mesh(prim)
        counts, indices = (
            mesh.GetFaceVertexCountsAttr().Get(),
            mesh.GetFaceVertexIndicesAttr().Get(),
        )
        return np.array(counts, np.int64), np.array(indices, np.int64)

    def rest(self) -> dict[str, Array]:
        """Constant values of the particles: rest positions (N, 3) [m], volumes (N,) and others."""
        cloud = self._particles()
        with reading(self.path):
            place = self._place(Usd.TimeCode(self.time_codes[0]))
            points = self._vectors(f"{NAMESPACE}restPositions", Usd.TimeCode.Default())
            out = {"positions": place.points(points) * self.units.length}
            indices = cloud.GetAttribute(f"{NAMESPACE}materialIndices").Get()
            out["materials"] = np.zeros(len(points)) if indices is None else np.array(indices)
            for name, (key, unit) in REST.items():
                values = cloud.GetAttribute(f"{NAMESPACE}{name}").Get()
                if values is not None:
                    out[key] = np.array(values, float) * self._size(unit)
        return out

    def positions(self, code: float) -> Array:
        """(N, 3) [m] positions of the particles."""
        name = "positions" if self._splats else "points"
        time = Usd.TimeCode(code)
        return self._place(time).points(self._vectors(name, time)) * self.units.length

    def velocities(self, code: float) -> Array:
        """(N, 3) [m/s of playback] velocities of the particles."""
        name = f"{NAMESPACE}{VELOCITIES}" if self._splats else "velocities"
        time = Usd.TimeCode(code)
        turn = self._place(time).matrix[:3, :3]
        return self._vectors(name, time) @ turn * self.units.length

    def covariances(self, code: float) -> Array | None:
        """(N, 3, 3) [m^2] Sigma = A A^T of the Gaussians; None where the bake wrote none."""
        if not self._splats:
            return None
        time = Usd.TimeCode(code)
        quaternions = self._vectors("orientations", time, 4)[
            :, [3, 0, 1, 2]
        ]  # from x, y, z, w, USD's order in NumPy
        local = gaussian_axes(quaternions, self._vectors("scales", time))
        axes = self._place(time).matrix[:3, :3].T * self.units.length @ local
        return axes @ axes.transpose(0, 2, 1)

    def gradients(self, code: float) -> Array | None:
        """(N, 3, 3) deformation gradients dx_i / dX_j; None where the bake wrote none."""
        return self._values(GRADIENTS, code)

    def stress(self, code: float) -> Array | None:
        """(N,) [Pa] von Mises stress; None where the bake wrote none."""
        values = self._values(STRESS, code)
        return None if values is None else values * self.units.pressure

    def internal(self, code: float) -> dict[str, Array]:
        """(N,) values of each internal variable of the constitutive laws, by name, if written."""
        if not self._splats:
            return {}
        found = {}
        for attribute in self._cloud.GetPropertiesInNamespace(NAMESPACE.rstrip(":")):
            name = attribute.GetName().removeprefix(NAMESPACE)
            if name in (STRESS, GRADIENTS, VELOCITIES) or not isinstance(attribute, Usd.Attribute):
                continue
            if attribute.GetNumTimeSamples():
                values = self._values(name, code)
                if values is not None:
                    found[snake_case(name)] = values
        return found

    def mesh_points(self, path: str, code: float) -> Array:
        """(V, 3) [m] points of a mesh."""
        time = Usd.TimeCode(code)
        with reading(self.path):
            xforms = UsdGeom.XformCache(time)
            skins = Skins(time, xforms, Notes())
            return world_points(self._meshes[path], time, xforms, skins) * self.units.length

    def health(self) -> dict[str, list[Any]]:
        """Time samples of each health attribute, in stage units."""
        codes = [Usd.TimeCode(code) for code in self.time_codes]
        return {
            attribute.GetName().removeprefix(HEALTH): [attribute.Get(code) for code in codes]
            for attribute in self._health
        }

    @property
    def _splats(self) -> bool:
        return bool(self._cloud) and str(self._cloud.GetTypeName()) == SPLAT_TYPE

    def _particles(self) -> Usd.Prim:
        if not self._cloud:
            raise InputError(
                f"{self.path}: the bake did not write its particles",
                "bake again with gaussians or points among what is written, or with all (only)",
            )
        return self._cloud

    def _place(self, time: Usd.TimeCode) -> Placement:
        matrix = UsdGeom.XformCache(time).GetLocalToWorldTransform(self._particles())
        return Placement.of(matrix)

    def _size(self, unit: str) -> float:
        return getattr(self.units, unit) if unit else 1.0

    def _vectors(self, name: str, time: Usd.TimeCode, width: int = 3) -> Array:
        """(N, width) values of an attribute, or of its half-precision variant."""
        for spelled in (name, f"{name}h"):
            attribute = self._particles().GetAttribute(spelled)
            values = attribute.Get(time) if attribute else None
            if values is not None and len(values):
                return np.asarray(values, np.float64).reshape(-1, width)
        raise InputError(
            f"{self.path}: <{self._cloud.GetPath()}> has no {name} at {time}",
            "run gf-usd check for details, then bake the asset again",
        )

    def _values(self, name: str, code: float) -> Array | None:
        attribute = self._particles().GetAttribute(f"{NAMESPACE}{name}")
        values = attribute.Get(Usd.TimeCode(code)) if attribute else None
        return None if values is None or not len(values) else np.array(values, np.float64)


def snake_case(name: str) -> str:
    """plasticStrain -> plastic_strain."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
